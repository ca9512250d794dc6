# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A long sweep that is killed, a worker first and then the driver, beside one that is not.

    python -m benchmarks.killed_sweep [TRAJECTORIES]

Of 100 steps of the exact harmonic oscillator, 10^6 trajectories if no number is given.
"""

from collections.abc import Callable
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.plan import make_plan

SCENE, STEPS, TRAJECTORIES = 'exact_harmonic_oscillator', 100, 1_000_000
_COMMAND = 'from hnn_vi_ros.cli import sweep; sweep()'
# Shares of the shards that are there when a worker is killed, and when the driver is.
_WORKER, _DRIVER = 0.25, 0.5


def write_definition(path: Path, trajectories: int, shard_size: int) -> None:
    """Write the YAML of the sweep."""
    h = load_scene(SCENE).known_step_size
    path.write_text(dump_yaml({
        'scene': SCENE, 'duration': STEPS * h, 'seed': 7, 'shard_size': shard_size,
        'vary': [{'kind': 'box', 'keys': ['initial_state.q.0', 'initial_state.p.0'],
                  'low': [-1.0, -1.0], 'high': [1.0, 1.0], 'count': trajectories}]}))


def start(path: Path, out: Path, jobs: int) -> subprocess.Popen[bytes]:
    """Begin the command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, '-P', '-c', _COMMAND, str(path), '--jobs', str(jobs), '--out', str(out)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def parts(out: Path) -> dict[str, bytes]:
    """Return the shards that are there, by name."""
    return {path.name: path.read_bytes() for path in sorted(out.glob('part-*'))}


def workers(pid: int) -> list[int]:
    """Return the processes that a driver has spawned to make shards."""
    children = [int(child) for path in Path(f'/proc/{pid}/task').glob('*/children')
                for child in path.read_text().split()]
    return [child for child in children
            if b'spawn_main' in Path(f'/proc/{child}/cmdline').read_bytes()]


def kill_on_the_way(path: Path, out: Path, jobs: int) -> tuple[int, int]:
    """Kill a worker, then the driver; return how many shards were there at each."""
    shards, seen = make_plan(path).shards, []
    with start(path, out, jobs) as driver:
        for share, victims in ((_WORKER, lambda: workers(driver.pid)[:1]),
                               (_DRIVER, lambda: [driver.pid])):
            _wait(lambda share=share: len(list(out.glob('part-*'))) >= share * shards, driver)
            seen.append(len(list(out.glob('part-*'))))
            others = workers(driver.pid)
            for victim in victims():
                os.kill(victim, signal.SIGKILL)
    # Those that are left end with the driver; what they still write is whole.
    while any(map(_runs, others)):
        time.sleep(0.05)
    return seen[0], seen[1]


def _runs(pid: int) -> bool:
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    # What has ended, and is waited for by nobody, stays as Z.
    return state not in 'ZX'


def _wait(reached: Callable[[], bool], driver: subprocess.Popen[bytes]) -> None:
    while not reached():
        if driver.poll() is not None:
            raise RuntimeError('the sweep ended before it was killed; take more trajectories')
        time.sleep(0.02)


def main(trajectories: int, shard_size: int = 8192, jobs: int = 2) -> None:
    """Run both, compare them byte by byte, and print what was seen."""
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), Path(name) / 'sweep.yaml'
        write_definition(path, trajectories, shard_size)
        at_worker, at_driver = kill_on_the_way(path, folder / 'killed', jobs)
        left = len(SweepFolder(folder / 'killed').survey(make_plan(path)).missing)
        times = []
        for out in ('killed', 'whole'):
            begin = time.perf_counter()
            with start(path, folder / out, jobs) as run:
                pass
            if run.returncode:
                raise RuntimeError(f'the sweep ended with {run.returncode}')
            times.append(time.perf_counter() - begin)
        killed, whole = parts(folder / 'killed'), parts(folder / 'whole')
        size = sum(map(len, whole.values()))
        same = killed == whole
    print(f'{trajectories} trajectories of {STEPS} steps, {len(whole)} shards, {jobs} processes: '
          f'a worker was killed at {at_worker} shards, the driver at {at_driver}, {left} were '
          f'missing; gone on with in {times[0]:.0f} s; in one go {times[1]:.0f} s; '
          f'{size / 1e6:.1f} MB; the same bytes: {same}')
    if not same:
        raise SystemExit(1)


if __name__ == '__main__':
    main(int(sys.argv[1]) if len(sys.argv) > 1 else TRAJECTORIES)
