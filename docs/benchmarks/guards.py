# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 8: what the guards of the node cost."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from benchmarks.measurement import compare, interleave, Row, Settings
from hnn_vi_ros.guards import make_guards
from hnn_vi_ros.guards.watch import SampledScale
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.ros.recording import Recording
from hnn_vi_ros.ros.topics.outputs import Material
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.run.look_ahead import look_ahead
from hnn_vi_ros.run.monitor import Monitor
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.run.scene_report import scene_report
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation.build import build
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node

_SCENE = 'pendulum'
# Many short turns: what else the machine does changes slowly against them.
_TICKS, _TURNS = 200, 20
_LIMITS = 0.05, 0.02


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row, the tick of a node that publishes and records every step."""
    settings.say(_SCENE)
    context = Context()
    rclpy.init(context=context)
    node = Node('bench', context=context)
    try:
        with TemporaryDirectory() as folder:
            yield _row(node, Path(folder), settings)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def _row(node: Node, folder: Path, settings: Settings) -> Row:
    tick, watching, recording = _make_tick(node, folder)
    turns = _TURNS * settings.repetitions
    watched = np.empty(turns)
    times = np.empty(turns)
    try:
        for turn in range(turns):
            watching.clear()
            (times[turn],), = interleave([lambda: _ticks(tick)], 1, one_thread=False)
            # The last of them: interleave begins with turns that it does not count.
            watched[turn] = sum(watching[-_TICKS:])
    finally:
        recording.close()
    return compare(
        f'{_SCENE}, guards: time of a tick of one step', times, times - watched, target=1.02,
        scale=1e6 / _TICKS, peer_name='without',
        note='what the node does for each sample, at one sample a step: the step, the sample, '
             'its figures, five messages published and recorded in the bag; no picture, no '
             'subscriber, and without the executor; the guards are timed inside of the tick',
        miss='guards take two to three microseconds a sample, whatever a step costs: half for a '
             'copy of it, half for a share of a look at 256 of them.')


def _ticks(tick: Callable[[], None]) -> Callable[[], None]:
    def run() -> None:
        for _ in range(_TICKS):
            tick()
    return run


def _make_tick(node: Node, folder: Path
               ) -> tuple[Callable[[], None], list[float], Recording]:
    """Return what the node does for a sample, the times of its guards [s], and the files."""
    scene = load_scene(_SCENE)
    simulation = build(scene)
    box = look_ahead(simulation, 1.0)
    sampler = Sampler(simulation, 1.0 / simulation.step_size)
    topics = Topics(node, parameters.Settings())
    scale = SampledScale(simulation.hamiltonian)
    monitor = Monitor(simulation, sampler.every, sampler.tick, None, lambda text, first: None,
                      make_guards(simulation, scale, *_LIMITS, simulation.hamiltonian.barrier),
                      scale)
    topics.open(Material(simulation, monitor, box), lambda: 0, lambda topic, stamp, payload: None)
    recording = Recording(
        node.get_logger(), scene, simulation,
        parameters.Settings(record_path=str(folder / 'bag'), rerun_sink='none'),
        topics.descriptions, box, scene_report(scene, simulation), sampler)
    monitor.watch(sampler.sample())
    watching: list[float] = []

    def tick() -> None:
        monitor.advance(sampler.every)
        sample = sampler.sample()
        monitor.add(sample)
        recording.write(sample, topics.publish(sample))
        evaluated = monitor.evaluate()
        before = time.perf_counter()
        begin = time.perf_counter()
        alarms = monitor.watch(sample, evaluated)
        end = time.perf_counter()
        # Less what looking at the clock takes.
        watching.append(end - begin - (begin - before))
        if alarms:
            raise RuntimeError(
                f'an alarm, which was not to be measured: {alarms[0][0].message}')
    return tick, watching, recording
