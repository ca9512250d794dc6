# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A control task from random starts: separate processes of simulator and controller, over DDS.

Each start has a bag, which is simulated again without the controller and compared bit by bit. A
start is a success where both angles stay upright through the last two seconds. The latency is
simulated time, at the pace of the clock, from the state that a command answers to when it acts.
With --lockstep, simulated time waits for commands, and a digest shows whether two machines had the
same run: of all messages and their log times, except diagnostics, which hold wall times, and the
scene, which names its folder.

    PYTHONPATH=docs .venv/bin/python -m benchmarks.controller_starts acrobot --starts 20
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from benchmarks.processes import given, own_node, running
from hnn_vi_ros.control import momentum
from hnn_vi_ros.control.task import load_task
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.scene import load_scene
import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import JointState

# Upright [rad], through the end of a run [s].
_CLOSE, _END = 0.1, 2.0


@contextmanager
def logged(name: str, folder: Path, **parameters: object) -> Iterator[Path]:
    """Run an executable of the package; return its log once it is active."""
    code = f'from hnn_vi_ros.cli import {name}; {name}()'
    path = folder / f'{name}.log'
    with path.open('w') as log, running(
            [sys.executable, '-c', code, *given(**parameters)], folder, log):
        while '-> active' not in path.read_text():
            time.sleep(0.1)
        yield path


def evaluate(bag: Path, names: list[str]) -> dict[str, object]:
    """Return success, latencies [ms] and verification of a recorded run."""
    run = RecordedRun(bag)
    states = [(message.time, state.q) for message, state in run.in_order([*run.states])
              if state is not None]
    last = np.array([q for stamp, q in states if stamp > states[-1][0] - _END * 1e9])
    wanted = np.array([np.pi, *[0.0] * (len(names) - 1)])
    away = np.abs((last - wanted + np.pi) % (2.0 * np.pi) - np.pi).max()
    channels = [number for number, name in run.names.items() if name == 'joint_commands']
    latencies = []
    for message in run.reader.messages(channels):
        stamp = run.decoded(message, JointState).header.stamp
        latencies.append((message.time - stamp.sec * 10**9 - stamp.nanosec) / 1e6)
    return {'success': bool(away < _CLOSE), 'commands': len(latencies),
            'latencies': latencies, 'verified': check_replay(bag).good}


def starts(task: str, count: int, duration: float, seed: int, folder: Path
           ) -> tuple[list[dict[str, object]], list[str]]:
    """Return the result of each start, and the warnings of the controller."""
    read, _, _ = load_task(task)
    names = ['angle'] if read.scene == 'motor_pendulum' else ['shoulder', 'elbow']
    rng = np.random.default_rng(seed)
    with own_node('starts') as (node, _), logged('controller', folder, task=task) as log, \
            logged('simulator', folder, scene=read.scene, record_path='bag', rerun_sink='none',
                   reset_on_initial_state='true'):
        publisher = node.create_publisher(JointState, '/hnn_simulator/initial_state', 10)
        while not publisher.get_subscription_count():
            time.sleep(0.1)
        for _ in range(count):
            publisher.publish(JointState(
                name=names, position=rng.uniform(-np.pi, np.pi, len(names)),
                velocity=rng.uniform(-1.0, 1.0, len(names))))
            time.sleep(duration)
    return ([evaluate(folder / f'bag-{k}', names) for k in range(2, count + 2)],
            [line for line in log.read_text().splitlines() if 'WARN' in line or 'ERROR' in line])


def in_lockstep(task: str, count: int, duration: float, seed: int, folder: Path
                ) -> tuple[list[dict[str, object]], list[str]]:
    """Return the result of each start in lockstep, as fast as both processes can."""
    read, _, _ = load_task(task)
    scene = load_scene(read.scene)
    names = [one.name for one in scene.create_hamiltonian().coordinates]
    rng, found = np.random.default_rng(seed), []
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    for k in range(count):
        q, v = rng.uniform(-np.pi, np.pi, len(names)), rng.uniform(-1.0, 1.0, len(names))
        (folder / 'start.yaml').write_text(scene.with_overrides(initial_state={
            'q': q.tolist(), 'p': momentum(scene, q, v).tolist()}).to_yaml())
        with logged('controller', folder, task=task, lockstep='true'):
            code = 'from hnn_vi_ros.cli import simulator; simulator()'
            subprocess.run([sys.executable, '-c', code, *given(
                scene='start.yaml', record_path=f'bag-{k}', rerun_sink='none', lockstep='true',
                real_time_factor=0.0, duration=duration)],
                cwd=folder, check=True, capture_output=True)
        reader, content = BagReader(folder / f'bag-{k}'), sha256()
        for message in reader.messages():
            topic = reader.channels[message.channel].topic
            if topic.rpartition('/')[2] not in ('diagnostics', 'scene'):
                content.update(f'{topic} {message.time} '.encode() + message.data)
        found.append(evaluate(folder / f'bag-{k}', names) | {'digest': content.hexdigest()[:12]})
    return found, []


def main(argv: list[str] | None = None) -> None:
    """Print a line of JSON for each start, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('task', choices=['swing_up', 'acrobot', 'pendubot'])
    parser.add_argument('--starts', type=int, default=20)
    parser.add_argument('--duration', type=float, default=10.0)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--lockstep', action='store_true')
    chosen = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        way = in_lockstep if chosen.lockstep else starts
        found, late = way(chosen.task, chosen.starts, chosen.duration, chosen.seed, Path(folder))
    latencies = [one.pop('latencies') for one in found]
    for one, its in zip(found, latencies, strict=True):
        print(json.dumps(one | _percentiles(its)))
    print(json.dumps({
        'successes': sum(one['success'] for one in found), 'of': len(found),
        'verified': sum(one['verified'] for one in found),
        **_percentiles(np.concatenate(latencies)), 'complaints': late[:5]}))


def _percentiles(latencies: npt.ArrayLike) -> dict[str, list[float]]:
    return {'latency ms, 50 99 %': np.percentile(latencies, [50, 99]).round(1).tolist()}


if __name__ == '__main__':
    main()
