# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 10: what a long run and many resets leave in memory; nothing to compare with but zero."""

from collections.abc import Iterator
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace
from unittest.mock import patch

from benchmarks.cold_start import simulator
from benchmarks.measurement import Row, Settings
from hnn_vi_ros.bags import mcap_sink
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
from hnn_vi_ros.viewer import rerun_sink
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

_SCENE, _STEP = 'harmonic_oscillator', 0.001
_HOUR = 3_600_000
# Allocators, buffers and pieces that are still short settle in the first ones.
_WARM_SHARE, _WARM, _RESETS, _QUICK = 0.1, 20, 500, 40
_TARGET = 5.0
_KEPT = ('what the two files keep in memory until they are closed is their indexes: 20 kB for '
         'each piece of the picture, 0.2 kB for each chunk of the bag')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure the growth over an hour of samples at 1 kHz, and over resets."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    settings.say('an hour at 1 kHz, with bag and picture')
    ticks = _HOUR // 10 if settings.quick else _HOUR
    # In a process of its own: what others have left there could be used again.
    told = subprocess.run([sys.executable, '-m', 'benchmarks.memory', str(ticks)], check=True,
                          capture_output=True, text=True)
    yield _row('an hour at 1 kHz, bag and picture: memory', float(told.stdout),
               'the clock of the files is that of the samples, so that they are cut into the '
               f'pieces of a run at pace 1; {_KEPT}; the first tenth is not counted')
    resets = _QUICK if settings.quick else _RESETS
    settings.say(f'{resets} resets')
    threads, growth = _reset(resets)
    yield _row(f'{resets} resets, bag and picture: memory', growth,
               f'{threads} threads more than before them')


def _row(name: str, growth: float, note: str) -> Row:
    return Row(name, f'{growth:.2f} MB', 'none', growth, (growth, growth), _TARGET, 1, unit='MB',
               note=note)


def _reset(count: int) -> tuple[int, float]:
    """Return by how much threads and memory [MB] of a simulator grow over resets."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('bench_client', context=context)
    client = node.create_client(Trigger, '/hnn_simulator/reset')
    executor = SingleThreadedExecutor(context=context)
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [simulator(), '--ros-args', '-p', f'scene:={_SCENE}'], cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while not client.wait_for_service(1.0):
                if process.poll() is not None:
                    raise RuntimeError('the simulator has ended')
            seen = []
            for repetitions in (_WARM, count):
                done = 0
                while done < repetitions:
                    future = client.call_async(Trigger.Request())
                    rclpy.spin_until_future_complete(node, future, executor)
                    # Refused until the node has loaded and opened everything.
                    done += future.result().success
                seen.append((len(os.listdir(f'/proc/{process.pid}/task')),
                             resident(process.pid)))
        finally:
            process.terminate()
            process.wait()
            node.destroy_node()
            rclpy.shutdown(context=context)
    (threads, memory), (threads_after, memory_after) = seen
    return threads_after - threads, memory_after - memory


def resident(pid: int | str) -> float:
    """Return the memory that a process holds [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def _grow(node: Node, folder: Path, ticks: int) -> float:
    """Return by how much the memory of this process grows while it hands samples out [MB]."""
    scene = load_scene(_SCENE).with_overrides(_STEP, None)
    simulation = build(scene)
    box = look_ahead(simulation, 1.0)
    sampler, topics = Sampler(simulation, 1.0 / _STEP), Topics(node, parameters.Settings())
    monitor = Monitor(simulation, 1, _STEP, None, lambda text, first: None)
    topics.open(Material(simulation, monitor, box, scene.mechanism), lambda: 0,
                lambda topic, stamp, payload: None)
    # To the files, the samples come at the pace of the clock.
    clock = SimpleNamespace(monotonic=lambda: sampler.time, time_ns=time.time_ns)
    with patch.object(mcap_sink, 'time', clock), patch.object(rerun_sink, 'time', clock):
        recording = Recording(
            node.get_logger(), scene, simulation,
            parameters.Settings(record_path=str(folder / 'bag'),
                                rerun_path=str(folder / 'picture.rrd')),
            topics.descriptions, box, scene_report(scene, simulation), sampler)
        for tick in range(ticks):
            if tick == round(_WARM_SHARE * ticks):
                before = resident('self')
            monitor.advance(1)
            sample = sampler.sample()
            monitor.add(sample)
            recording.write(sample, topics.publish(sample))
            if monitor.evaluate():
                recording.timing(monitor.timing.figures)
        growth = resident('self') - before
        recording.close()
    return growth


def main(ticks: int) -> None:
    """Print the growth over so many samples [MB]."""
    context = Context()
    rclpy.init(context=context)
    node = Node('bench', context=context)
    with tempfile.TemporaryDirectory() as folder:
        print(_grow(node, Path(folder), ticks))
    node.destroy_node()
    rclpy.shutdown(context=context)


if __name__ == '__main__':
    main(int(sys.argv[1]))
