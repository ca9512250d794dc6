# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Step sizes that an alarm names: each of them works, on all shipped scenes."""

import re
import warnings

from helpers import mostly_long
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.files import shipped_names
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, simulate
from hnn_vi_ros.simulation.guards.bands import ResolutionGuard
import pytest

# Of the scenes whose energy is conserved, those in which it is by these steps too: most of bodies
# that turn, an arm that hangs, and with a method that conserves it or takes steps of its own.
RESOLVED = ['charged_particle', 'double_pendulum_velocity', 'free_rigid_body', 'heavy_top',
            'kepler_close', 'seven_joint_arm', 'spherical_pendulum']
NAMED = re.compile(r'; step_size (\S+) resolves this run$')


def unresolved(scene: Scene, h: float, duration: float, **how) -> list[str]:
    """Return what a run warns of as under-resolved."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        simulate(scene, duration, step_size=h, **how)
    return [text for text in (str(warning.message) for warning in caught)
            if text.startswith(ResolutionGuard.kind)]


# The model of the air track is not shipped.
@pytest.mark.parametrize('name', mostly_long(
    sorted({*shipped_names('scene')} - {'air_track'}), 'pendulum'))
def test_step_size_that_the_alarm_of_a_scene_names_resolves_the_run(name):
    scene, named = load_scene(name), 0
    if not build(scene).conservative:
        pytest.skip('the guard watches scenes whose energy is conserved')
    for factor in (4, 16, 64):
        h = factor * scene.known_step_size
        try:
            told = unresolved(scene, h, 20.0 * h)
        except StepFailure:
            continue
        for text in told:
            if found := NAMED.search(text):
                named += 1
                assert float(found[1]) <= 0.5 * h
                assert not unresolved(scene, float(found[1]), 20.0 * h)
    assert named > 0 or name in RESOLVED


@pytest.mark.parametrize('how', [
    {'every': 3}, {'times': [0.11 * k for k in range(1, 90)]}, {'events': 'angle = 0'}])
def test_step_size_that_an_alarm_names_resolves_a_run_however_it_is_sampled(how):
    scene = load_scene('exact_pendulum')
    if 'events' in how:
        scene = scene.changed({'events': [{'when': how['events']}]})
        how = {}
    (text,) = unresolved(scene, 0.3, 10.0, **how)
    named = float(NAMED.search(text)[1])
    assert not unresolved(scene, named, 10.0, **how)


def test_no_step_size_is_named_where_to_find_it_takes_long():
    """A million steps take three million gradients; trials of a tenth of that are affordable."""
    (text,) = unresolved(load_scene('exact_harmonic_oscillator'), 1.0, 1e6, every=1000)
    assert text.endswith('use a smaller step_size, or a method of higher order')
