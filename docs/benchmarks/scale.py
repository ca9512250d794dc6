# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 11: sweeps on two cores, their writing, and comparison with diffrax's vmap."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks.choosing import first_good
from benchmarks.measurement import compare, Contestant, interleave, race, Row, Settings, summarise
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation.trajectory.many import simulate_many
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.parquet import write_shard
from hnn_vi_ros.sweeps.plan import make_plan, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Runner
import numpy as np
from studies.peers import diffrax_run, jax_rates, load_jax

SEED = 3
_TRAJECTORIES, _QUICK = 100_000, 4_000
# Simulated time of the shipped scenes [s], so that each sweep takes some minutes of one core; and
# how often each is run.
_DURATIONS, _TURNS = {'pendulum': 2.0, 'double_pendulum': 0.25}, 1
# Parallel efficiency of two cores, and share of time for writing.
_EFFICIENCY, _WRITING = 0.9, 0.1
# Shards whose writing is timed.
_TIMED = 4
# Scenes, times [s] and errors at the end that are compared with diffrax; number of trajectories,
# and of those with which tolerances are chosen; spread of their starts, in widths of the box; and
# the tolerance of the reference.
_COMPARED = ('pendulum', 'double_pendulum', 'learned_kepler')
_HORIZONS, _WANTED = (10.0, 100.0), (1e-4, 1e-7)
_BATCH, _SEARCHED, _SPREAD, _EXACT = 1000, 50, 0.01, 1e-13
_ADAPTIVE = ('Tsit5', 'Dopri8')
_COMMAND = 'from hnn_vi_ros.cli import sweep; sweep()'


def rows(settings: Settings) -> Iterator[Row]:
    """Measure sweeps of two shipped networks, and their kernels against diffrax."""
    for scene in _DURATIONS:
        sweep = definition(scene, _QUICK if settings.quick else _TRAJECTORIES)
        plan = make_plan(sweep)
        with tempfile.TemporaryDirectory() as folder:
            yield from _efficiency(sweep, Path(folder), settings)
            yield _writing(plan, Path(folder))
    for scene in _COMPARED:
        for horizon in _HORIZONS:
            yield from _against_diffrax(scene, horizon, settings)


def definition(scene: str, trajectories: int) -> dict[str, Any]:
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
        np.array(busy[1]), target=1.0 / _EFFICIENCY, unit='us per trajectory',
        scale=1e6 / trajectories, peer_name='one process',
        note='of the same commands: what two processes do twice, whatever else the machine does')


def _processor_time() -> float:
    """Return the processor time of all finished child processes [s]."""
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
    return summarise(f'sweep of {plan.scene.name}: share of writing',
                     f'{100.0 * np.median(shares):.2g} %', 'all', shares, _WRITING,
                     note='to Parquet, compressed, and to the disk')


def _against_diffrax(name: str, horizon: float, settings: Settings) -> Iterator[Row]:
    """Yield the rows of a learned scene over diffrax's fastest, to the same errors at its end."""
    scene = load_scene(name)
    hamiltonian = scene.create_hamiltonian()
    assert isinstance(hamiltonian, NeuralHamiltonian)
    m = _BATCH // 10 if settings.quick else _BATCH
    settings.say(f'{m} trajectories of {name} over {horizon:g} s beside diffrax')
    low, high = np.concatenate(hamiltonian.box).T
    start = np.hstack([scene.initial_state.q, scene.initial_state.p])
    z = start + _SPREAD * (high - low) * np.random.default_rng(SEED).uniform(-1, 1, (m, len(low)))

    def ours(tolerance: float, z: np.ndarray) -> np.ndarray:
        chosen = scene.changed({'step_size': horizon, 'integrator': {
            'kind': 'dop853', 'relative_tolerance': tolerance, 'absolute_tolerance': tolerance}})
        return _ends(simulate_many(chosen, *np.hsplit(z, 2), horizon, threads=1,
                                   path_error='off'))

    ways = {'dop853': ours}
    for method in _ADAPTIVE:
        solve = _diffrax(hamiltonian, method, horizon)
        for batch in (_SEARCHED, m):
            ways[f"diffrax's vmap of {method}, {batch} at a time"] = partial(
                _in_batches, solve, batch)
    reference = ours(_EXACT, z)

    def error(end: np.ndarray) -> float:
        # The median trajectory: the largest error comes from the closest encounter.
        return float(np.median(np.abs(end - reference[:len(end)]).max(axis=1)))

    def contestant(way: Callable[..., np.ndarray], tolerance: float) -> Contestant:
        return lambda: partial(way, tolerance, z)

    for wanted in _WANTED:
        mine, peers = dict[str, Contestant](), dict[str, Contestant]()
        for label, way in ways.items():
            tolerance = first_good(10.0 ** (-0.25 * np.arange(8, 50)), lambda one, way=way: error(
                way(one, z[:_SEARCHED])), wanted)
            if tolerance is not None:
                told = f'{label}, tolerance {tolerance:.2g}, error {error(way(tolerance, z)):.1g}'
                (mine if way is ours else peers)[told] = contestant(way, tolerance)
        yield race(f'{m} trajectories of {name} to an error of {wanted:g} at T = {horizon:g}',
                   mine, peers, settings, target=1.0, scale=1e6 / m, unit='us per trajectory',
                   of_processor=True)


def _ends(trajectory: Any) -> np.ndarray:
    return np.hstack([trajectory.q[-1], trajectory.p[-1]])


def _diffrax(hamiltonian: NeuralHamiltonian, method: str, horizon: float) -> Callable[..., Any]:
    """Return an adaptive method of diffrax over many states, shape (m, 2 d), jitted."""
    jax, _ = load_jax()
    run = diffrax_run(jax_rates(hamiltonian), method)
    return jax.jit(jax.vmap(lambda z, tolerance: run(z, horizon, tolerance)[0], in_axes=(0, None)))


def _in_batches(solve: Callable[..., Any], batch: int, tolerance: float, z: np.ndarray
                ) -> np.ndarray:
    """Return the ends of one batch of states after another."""
    return np.vstack([np.asarray(solve(z[first:first + batch], tolerance))
                      for first in range(0, len(z), batch)])
