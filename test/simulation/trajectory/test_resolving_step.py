# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Step sizes that the alarm of a path recommends: each of them resolves the path."""

import re
from typing import Any
import warnings

from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import simulate
from hnn_vi_ros.simulation.second_run import PathGuard
import pytest

RECOMMENDED = re.compile(r'; use step_size (\S+), or a method of higher order$')


def lost(scene: Scene, h: float, duration: float, **how: Any) -> list[str]:
    """Return the warnings of a path that is not resolved."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        simulate(scene, duration, step_size=h, **how)
    return [text for text in (str(warning.message) for warning in caught)
            if text.startswith(PathGuard.kind)]


@pytest.mark.parametrize('name', ['exact_pendulum', 'pendulum'])
def test_step_size_that_the_alarm_of_a_scene_recommends_resolves_the_path(name):
    scene, recommended = load_scene(name), 0
    for factor in (2, 4, 8):
        h = factor * scene.known_step_size
        for text in lost(scene, h, 10.0):
            if found := RECOMMENDED.search(text):
                recommended += 1
                assert float(found[1]) < h
                assert not lost(scene, float(found[1]), 10.0), (factor, text)
    assert recommended


@pytest.mark.parametrize('how', [
    {}, {'every': 3}, {'times': [0.11 * k for k in range(1, 272)]}, {'events': 'angle = 0'}])
def test_alarm_recommends_the_same_step_size_however_a_run_is_sampled(how):
    scene = load_scene('exact_pendulum').with_overrides(integrator='implicit_midpoint')
    if 'events' in how:
        scene = scene.changed({'events': [{'when': how['events']}]})
        how = {}
    (text,) = lost(scene, 0.08, 30.0, **how)
    recommended = float(RECOMMENDED.search(text)[1])
    # The path is 12 % off; its error is of order 2.
    assert 0.06 < recommended < 0.08 and not lost(scene, recommended, 30.0, **how)
