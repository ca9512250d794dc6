# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 8: what the guards of the node cost."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measurement import compare, interleave, Row, Settings
from hnn_vi_ros.guards import Guard
from hnn_vi_ros.ros.health import make_guards
from hnn_vi_ros.ros.look_ahead import look_ahead
from hnn_vi_ros.ros.monitor import Monitor
from hnn_vi_ros.ros.recording import Recording
from hnn_vi_ros.ros.sampling import Sampler
from hnn_vi_ros.ros.topics import Topics
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
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
    tick, monitor, recording = _make_tick(node, folder)
    guards = list(monitor.guards)

    def contestant(watching: list[Guard]) -> Callable:
        def run() -> None:
            for _ in range(_TICKS):
                tick()

        def prepare() -> Callable:
            monitor.guards = watching
            return run
        return prepare

    try:
        times = interleave([contestant(guards), contestant([])],
                           _TURNS * settings.repetitions, one_thread=False)
    finally:
        recording.close()
    return compare(
        f'{_SCENE}, guards: time of a tick of one step', times[:, 0], times[:, 1], target=1.02,
        scale=1e6 / _TICKS, peer_name='without',
        note='what the node does for each sample, at one sample a step: the step, the sample, '
             'its figures, four messages published and recorded in the bag; no picture, no '
             'subscriber, and without the executor',
        miss='Three guards in Python take two to three microseconds a sample, whatever a step '
             'costs: with ten steps a sample that is a tenth a step, and at 1 kHz of real time '
             'less than 1 % of a tick.')


def _make_tick(node: Node, folder: Path) -> tuple[Callable[[], None], Monitor, Recording]:
    """Return what the node does for a sample, and two of its parts."""
    scene = load_scene(_SCENE)
    simulation = Simulation.from_scene(scene)
    box = look_ahead(simulation, 1.0).box
    sampler, topics = Sampler(simulation, 1.0 / simulation.step_size), Topics(node, False)
    monitor = Monitor(simulation, sampler.every, sampler.tick, None, lambda text, first: None,
                      make_guards(simulation, box, *_LIMITS))
    topics.open(simulation, monitor, None, box, 'world')
    recording = Recording(
        node.get_logger(), scene, simulation,
        {'record': True, 'record_path': str(folder / 'bag'), 'rerun_sink': 'none',
         'rerun_path': ''}, topics.descriptions, box)
    monitor.watch(sampler.sample())

    def tick() -> None:
        monitor.advance(sampler.every)
        sample = sampler.sample()
        monitor.add(sample)
        recording.write(sample, topics.publish(sample))
        if alarms := monitor.watch(sample):
            raise RuntimeError(f'an alarm, which was not to be measured: {alarms[0].message}')
    return tick, monitor, recording
