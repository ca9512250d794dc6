# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 10: memory growth in long runs, sweeps and resets; the target is zero."""

from collections.abc import Iterator
import os
from pathlib import Path
import sys
import tempfile
import time
from types import SimpleNamespace
from unittest.mock import patch

from benchmarks.measurement import Row, Settings, summarise
from benchmarks.processes import heard, own_node, resident, run_apart, simulator
from benchmarks.scale import definition
from benchmarks.ticks import Ticks
from hnn_vi_ros.recording.bags import mcap_sink
from hnn_vi_ros.recording.viewer import rerun_sink
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation.construction import build
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.parquet import write_shard
from hnn_vi_ros.sweeps.plan import make_plan
from hnn_vi_ros.sweeps.trajectories import Runner
import rclpy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

_SCENE, _STEP = 'harmonic_oscillator', 0.001
_HOUR = 3_600_000
# Allocators, buffers and pieces that are still short settle in the first ones.
_WARM_SHARE, _WARM, _RESETS, _QUICK = 0.1, 20, 500, 40
_WARM_SHARDS, _SHARDS = 8, 40
_TARGET = 5.0
_KEPT = ('what the two files keep in memory until they are closed is their indexes: 20 kB for '
         'each piece of the picture, 0.2 kB for each chunk of the bag')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure the growth over an hour of samples at 1 kHz, over resets, and over shards."""
    settings.say('an hour at 1 kHz, with bag and picture')
    ticks = _HOUR // 10 if settings.quick else _HOUR
    # In a separate process, like the shards: memory of other rows could be reused.
    yield _row('an hour at 1 kHz, bag and picture: memory', float(run_apart(
        'memory', 'samples', ticks)),
               'the clock of the files is that of the samples, so that they are cut into the '
               f'pieces of a run at pace 1; {_KEPT}; the first tenth is not counted')
    resets = _QUICK if settings.quick else _RESETS
    settings.say(f'{resets} resets')
    threads, growth = _reset(resets)
    yield _row(f'{resets} resets, bag and picture: memory', growth,
               f'{threads} threads more than before them')
    settings.say('memory of a sweep')
    last = _WARM_SHARDS + 4 if settings.quick else _SHARDS
    yield _row(f'sweep of {last} shards: memory', float(run_apart('memory', 'shards', last)),
               f'in one process, from the end of shard {_WARM_SHARDS} on')


def _row(name: str, growth: float, note: str) -> Row:
    return summarise(name, f'{growth:.2f} MB', 'none', growth, _TARGET, unit='MB', note=note)


def _reset(count: int) -> tuple[int, float]:
    """Return by how much threads and memory [MB] of a simulator grow over resets."""
    with heard(simulator(scene=_SCENE), Float64, '/hnn_simulator/energy', raw=True) as process:
        client = process.node.create_client(Trigger, '/hnn_simulator/reset')
        seen = []
        for repetitions in (_WARM, count):
            done = 0
            while done < repetitions:
                future = client.call_async(Trigger.Request())
                rclpy.spin_until_future_complete(process.node, future, process.executor)
                # Refused until the node has loaded and opened everything.
                done += future.result().success
            pid = process.process.pid
            seen.append((len(os.listdir(f'/proc/{pid}/task')), resident(pid)))
    (threads, memory), (threads_after, memory_after) = seen
    return threads_after - threads, memory_after - memory


def samples(ticks: int) -> float:
    """Return by how much the memory of this process grows while it hands samples out [MB]."""
    scene = load_scene(_SCENE).with_overrides(_STEP, None)
    simulation = build(scene)
    sampler = Sampler(simulation, 1.0 / _STEP)
    # The files receive the samples at the pace of the clock.
    clock = SimpleNamespace(monotonic=lambda: sampler.time, time_ns=time.time_ns)
    with own_node('bench') as (node, _), tempfile.TemporaryDirectory() as folder, \
            patch.object(mcap_sink, 'time', clock), patch.object(rerun_sink, 'time', clock):
        run = Ticks(node, scene, simulation, sampler, {
            'record_path': f'{folder}/bag', 'rerun_path': f'{folder}/picture.rrd'}, watched=False)
        for tick in range(ticks):
            if tick == round(_WARM_SHARE * ticks):
                before = resident('self')
            if run.tick()[1]:
                run.recording.timing(run.monitor.timing.figures)
        growth = resident('self') - before
        run.recording.close()
    return growth


def shards(last: int) -> float:
    """Return the memory growth until the shard `last` of a sweep is written [MB]."""
    plan = make_plan(definition('pendulum', 1024 * last))
    runner = Runner(plan)
    with tempfile.TemporaryDirectory() as folder:
        out = SweepFolder(Path(folder) / 'out')
        out.begin(plan)
        for shard in range(last):
            if shard == _WARM_SHARDS:
                before = resident('self')
            out.put(shard, write_shard(plan, shard, runner.shard(shard)))
        return resident('self') - before


if __name__ == '__main__':
    print({'samples': samples, 'shards': shards}[sys.argv[1]](int(sys.argv[2])))
