# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 8: cost of the guards of the node."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from benchmarks.measurement import compare, interleave, Row, Settings
from benchmarks.processes import own_node
from benchmarks.ticks import Ticks
from hnn_vi_ros.run import Sampler
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build
import numpy as np
from rclpy.node import Node

_SCENE = 'pendulum'
# Many short turns, because other load on the machine changes slowly.
_TICKS, _TURNS = 200, 20


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row, the tick of a node that publishes and records every step."""
    settings.say(_SCENE)
    with own_node('bench') as (node, _), TemporaryDirectory() as folder:
        yield _row(node, Path(folder), settings)


def _row(node: Node, folder: Path, settings: Settings) -> Row:
    # Without the markers of its drawing.
    scene = load_scene(_SCENE).model_copy(update={'mechanism': None})
    simulation = build(scene)
    ticks = Ticks(node, scene, simulation, Sampler(simulation, 1.0 / simulation.step_size),
                  {'record_path': str(folder / 'bag'), 'rerun_sink': 'none'}, watched=True)
    ticks.monitor.watch(ticks.sampler.sample())
    watching: list[float] = []
    turns = _TURNS * settings.repetitions
    times, watched = np.empty((2, turns))
    try:
        for turn in range(turns):
            watching.clear()
            (times[turn],), = interleave([lambda: _watched(ticks, watching)], 1, one_thread=False)
            # The last of them: interleave begins with turns that it does not count.
            watched[turn] = sum(watching[-_TICKS:])
    finally:
        ticks.recording.close()
    return compare(
        f'{_SCENE}, guards: time of a tick of one step', times, times - watched, target=1.02,
        scale=1e6 / _TICKS, peer_name='without',
        note='what the node does for each sample, at one sample a step: the step, the sample, '
             'its figures, five messages published and recorded in the bag; no picture, no '
             'subscriber, and without the executor; the guards are timed inside of the tick',
        miss='guards take two to three microseconds per sample, independent of the cost of a '
             'step: half for the copy of the sample, half for its share of a check of 256.')


def _watched(ticks: Ticks, watching: list[float]) -> Callable[[], None]:
    """Return a run of some ticks that notes the times of their guards [s]."""
    def run() -> None:
        for _ in range(_TICKS):
            sample, evaluated = ticks.tick()
            before = time.perf_counter()
            begin = time.perf_counter()
            alarms = ticks.monitor.watch(sample, evaluated)
            end = time.perf_counter()
            # Minus the time of reading the clock.
            watching.append(end - begin - (begin - before))
            if alarms:
                raise RuntimeError(
                    f'an alarm, which was not to be measured: {alarms[0][0].message}')
    return run
