# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 11: sweeps on two cores, what they write, and diffrax's vmap over the same network."""

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks.measurement import compare, interleave, Row, Settings
from benchmarks.memory import resident
from benchmarks.networks import jax_gradient
import diffrax
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.parquet import write_shard
from hnn_vi_ros.sweeps.plan import make_plan, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Runner
from hnn_vi_ros.trajectory.simulate import simulate_many
import jax
import numpy as np

SEED = 3
_TRAJECTORIES, _QUICK = 100_000, 4_000
# Simulated time of the shipped scenes [s], so that each sweep takes some minutes of one core; and
# how often each is run.
_DURATIONS, _TURNS = {'pendulum': 2.0, 'double_pendulum': 0.25}, 1
# Of two cores over one, of writing, of memory [MB].
_EFFICIENCY, _WRITING, _GROWTH = 0.9, 0.1, 5.0
# Shards whose writing is timed; before memory is looked at, and when it is looked at again.
_TIMED, _WARM, _LAST = 4, 8, 40
# Trajectories beside diffrax, their time [s], and the largest error at its end.
_BATCH, _TIME, _WANTED = 1000, 10.0, 1e-6
_METHODS = ('gauss6', 'gauss8', 'gauss10', 'gauss12', 'gauss14')
_ADAPTIVE = ('Tsit5', 'Dopri8')
_COMMAND = 'from hnn_vi_ros.cli import sweep; sweep()'
_MISS = ('our methods of order 4 and more are implicit for a network that is not separable: each '
         'step iterates for its stages, where an explicit method takes one gradient of each. '
         'What that is good for shows over longer times: see the rows of the path error.')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure sweeps of two shipped networks, and their kernels against diffrax."""
    for scene in _DURATIONS:
        definition = _definition(scene, _QUICK if settings.quick else _TRAJECTORIES)
        plan = make_plan(definition)
        with tempfile.TemporaryDirectory() as folder:
            yield from _efficiency(definition, Path(folder), settings)
            yield _writing(plan, Path(folder))
    settings.say('memory of a sweep')
    last = _WARM + 4 if settings.quick else _LAST
    told = subprocess.run([sys.executable, '-m', 'benchmarks.scale', str(last)], check=True,
                          capture_output=True, text=True)
    growth = float(told.stdout)
    yield Row(f'sweep of {last} shards: memory', f'{growth:.2f} MB', 'none', growth,
              (growth, growth), _GROWTH, 1, unit='MB',
              note=f'in one process, from the end of shard {_WARM} on')
    yield _against_diffrax(settings)


def _definition(scene: str, trajectories: int) -> dict[str, Any]:
    """Return a sweep of a shipped scene, from states in the box that its model was trained in."""
    hamiltonian = load_scene(scene).create_hamiltonian()
    assert hamiltonian.box is not None, 'it is learned'
    keys = [f'initial_state.{half}.{c.name}' for half in 'qp' for c in hamiltonian.coordinates]
    ends = 0.5 * np.concatenate(hamiltonian.box)
    return {'scene': scene, 'duration': _DURATIONS[scene], 'seed': SEED, 'shard_size': 1024,
            'vary': [{'kind': 'box', 'keys': keys, 'low': ends[:, 0].tolist(),
                      'high': ends[:, 1].tolist(), 'count': trajectories}]}


def _efficiency(definition: dict[str, Any], folder: Path, settings: Settings) -> Iterator[Row]:
    trajectories = definition['vary'][0]['count']
    settings.say(f'{trajectories} trajectories of {definition["scene"]} on two cores')
    numbers, path = count(), folder / 'sweep.yaml'
    path.write_text(dump_yaml(definition))

    busy: dict[int, list[float]] = {1: [], 2: []}

    def run(jobs: int) -> Callable[[], object]:
        command = [sys.executable, '-P', '-c', _COMMAND, str(path), '--jobs', str(jobs), '--out',
                   str(folder / f'{next(numbers)}')]

        def made() -> None:
            before = _processor_time()
            subprocess.run(command, check=True, capture_output=True)
            busy[jobs].append(_processor_time() - before)
        return made

    times = interleave([lambda: run(2), lambda: run(1)], _TURNS, warm_up=False, one_thread=False)
    name = f'sweep of {trajectories} trajectories of {definition["scene"]}'
    yield compare(
        f'{name}: two cores over one', 2.0 * times[:, 0], times[:, 1], target=1.0 / _EFFICIENCY,
        unit='s of cores', scale=1.0, peer_name='one core',
        note='the whole command: with --jobs 2 it starts two processes more; the ratio is the '
        'inverse of the efficiency')
    yield compare(
        f'{name}: processor time of two processes over one', np.array(busy[2]),
        np.array(busy[1]), target=1.0 / _EFFICIENCY, unit='us a trajectory',
        scale=1e6 / trajectories, peer_name='one process',
        note='of the same commands: what two processes do twice, whatever else the machine does')


def _processor_time() -> float:
    """Return what processes that were waited for have taken [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _writing(plan: SweepPlan, folder: Path) -> Row:
    runner, out, shares = Runner(plan), SweepFolder(folder / 'written'), []
    out.begin(plan)
    for shard in range(min(_TIMED, plan.shards)):
        start = time.perf_counter()
        blocks = list(runner.shard(shard))
        made = time.perf_counter()
        out.put(shard, write_shard(plan, shard, blocks))
        end = time.perf_counter()
        shares.append((end - made) / (end - start))
    low, median, high = np.quantile(shares, [0.25, 0.5, 0.75])
    return Row(f'sweep of {plan.scene.name}: share of writing', f'{100.0 * median:.2g} %', 'all',
               float(median), (float(low), float(high)), _WRITING, len(shares),
               note='to Parquet, compressed, and to the disk')


def _against_diffrax(settings: Settings) -> Row:
    """Return the row of our best method over diffrax's, to the same error."""
    scene = load_scene('pendulum')
    hamiltonian = scene.create_hamiltonian()
    assert isinstance(hamiltonian, NeuralHamiltonian)
    m = _BATCH // 10 if settings.quick else _BATCH
    settings.say(f'{m} trajectories of the pendulum beside diffrax')
    q, p = np.random.default_rng(SEED).uniform(-1.5, 1.5, (2, m, 1))

    def ours(method: str, h: float) -> Callable[[], np.ndarray]:
        chosen = scene.with_overrides(h, method)
        return lambda: _ends(simulate_many(chosen, q, p, _TIME, threads=1))

    reference = ours('gauss16', 0.05)()
    agreed = np.abs(ours('gauss16', 0.1)() - reference).max()
    if agreed > 0.01 * _WANTED:
        raise RuntimeError(f'the references differ by {agreed:.3g}')

    def good(run: Callable[[], np.ndarray]) -> bool:
        try:
            return bool(np.abs(run() - reference).max() <= _WANTED)
        except StepFailure:
            return False

    found = {}
    for method in _METHODS:
        # The largest step that will do, in ratios of 2^(1/4).
        for h in _TIME / np.round(_TIME / (0.8 * 2.0 ** (-0.25 * np.arange(20)))):
            if good(run := ours(method, float(h))):
                found[f'{method}, h = {h:.3g} s'] = run
                break
    peers = {}
    for method in _ADAPTIVE:
        solve = _diffrax(hamiltonian, method)
        for tolerance in 10.0 ** (-0.25 * np.arange(16, 48)):
            for batch in (m // 10, m):
                if good(run := _in_batches(solve, np.hstack([q, p]), tolerance, batch)):
                    peers[f'{method}, tolerance {tolerance:.2g}, {batch} at a time'] = run
            if any(name.startswith(method) for name in peers):
                break
    times = interleave([lambda run=run: run for run in (*found.values(), *peers.values())],
                       settings.repetitions)
    medians = np.median(times, axis=0)
    best = int(np.argmin(medians[:len(found)]))
    other = len(found) + int(np.argmin(medians[len(found):]))
    names = [*found, *peers]
    return compare(
        f'{m} trajectories of the pendulum to an error of {_WANTED:g} at T = {_TIME:g}',
        times[:, best], times[:, other], target=0.6, scale=1e6 / m, unit='us a trajectory',
        peer_name="diffrax's vmap", note='; '.join(
            f'{name}: {1e6 * seconds / m:.3g} us' for name, seconds in zip(
                names, medians, strict=True)), miss=_MISS)


def _ends(trajectory: Any) -> np.ndarray:
    return np.hstack([trajectory.q[-1], trajectory.p[-1]])


def _diffrax(hamiltonian: NeuralHamiltonian, method: str) -> Callable[..., Any]:
    """Return an adaptive method of diffrax over many states, shape (m, 2 d), jitted."""
    gradient, d = jax_gradient(hamiltonian.checkpoint), hamiltonian.dimension
    solver = getattr(diffrax, method)()

    def field(t: Any, z: Any, _: None) -> Any:
        g = gradient(z)
        return jax.numpy.concatenate([g[d:], -g[:d]])

    def solve(z: Any, tolerance: float) -> Any:
        return diffrax.diffeqsolve(
            diffrax.ODETerm(field), solver, 0.0, _TIME, None, z,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True), max_steps=100_000,
            adjoint=diffrax.ForwardMode()).ys[0]

    return jax.jit(jax.vmap(solve, in_axes=(0, None)))


def _in_batches(solve: Callable[..., Any], z: np.ndarray, tolerance: float, batch: int
                ) -> Callable[[], np.ndarray]:
    """Return a run that takes so many states at a time, and waits for each."""
    return lambda: np.vstack([np.asarray(solve(z[first:first + batch], tolerance))
                              for first in range(0, len(z), batch)])


def main(last: int) -> None:
    """Print by how much memory grows until so many shards are made [MB]."""
    plan = make_plan(_definition('pendulum', 1024 * last))
    runner = Runner(plan)
    with tempfile.TemporaryDirectory() as folder:
        out = SweepFolder(Path(folder) / 'out')
        out.begin(plan)
        for shard in range(last):
            if shard == _WARM:
                before = resident('self')
            out.put(shard, write_shard(plan, shard, runner.shard(shard)))
        print(resident('self') - before)


if __name__ == '__main__':
    main(int(sys.argv[1]))
