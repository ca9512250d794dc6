# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 4: 10,000 trajectories at once compared with one, and with a matrix product."""

from collections.abc import Callable, Collection, Iterator
from itertools import pairwise
from pathlib import Path
import tempfile

from benchmarks.measurement import compare, interleave, Row, Settings
from benchmarks.systems import FAMILIES, random_checkpoint, random_family
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import BLOCK, simulate_many, Simulation, usable_processors
import numpy as np

SEED = 2
_TRAJECTORIES = 10_000
# Trajectories that run one by one, each as long as the many.
_ALONE = 50
_MISS = ('a matrix product with the same operations alone takes {:.2f} of the time of one '
         'trajectory. Blocks need one more gradient and energy at each end.')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure a random 2-200-200-1, the shipped pendulum, and random models of families."""
    with tempfile.TemporaryDirectory() as folder:
        for name, model, steps in (
                ('2-200-200-1', random_checkpoint([2, 200, 200, 1], SEED), 20),
                *((name, random_family(name, SEED), 100) for name in FAMILIES)):
            path = Path(folder) / f'{name}.safetensors'
            save_checkpoint(path, model)
            d = len(model.card.coordinates)
            scene = Scene.build(
                hamiltonian={'kind': 'hnn', 'model': str(path)}, step_size=0.01,
                integrator='variational_euler', initial_state=(d * [0.3], d * [0.2]))
            yield from _rows_of(name, scene, steps, settings)
    yield from _rows_of('the pendulum', load_scene('pendulum'), 100, settings)


def _rows_of(name: str, scene: Scene, steps: int, settings: Settings) -> Iterator[Row]:
    settings.say(f'{_TRAJECTORIES} trajectories of {name}')
    m = _TRAJECTORIES // 20 if settings.quick else _TRAJECTORIES
    q, p = np.random.default_rng(SEED).uniform(-1.0, 1.0, (2, m, len(scene.initial_state.q)))
    cores, duration = usable_processors(), steps * scene.step_size
    hamiltonian, integrator = scene.create_hamiltonian(), scene.create_integrator()

    def start(first: int, count: int) -> Simulation:
        simulation = Simulation(hamiltonian, integrator, scene.step_size,
                                q[first:first + count], p[first:first + count])
        simulation.compile()
        return simulation

    def alone() -> Callable[[], list[None]]:
        ready = [start(first, 1) for first in range(_ALONE)]
        return lambda: [simulation.advance(steps) for simulation in ready]

    # Each of the block's gradients is one of every trajectory in it.
    gradients = 0
    for first in range(0, m, BLOCK):
        block = start(first, BLOCK)
        block.advance(steps)
        gradients += block.gradients * len(block.q)
    many = simulate_many(scene, q, p, duration, threads=1, path_error='off')
    _check(scene, many.q[-1], q, p, steps)
    product = _product(hamiltonian.checkpoint.card.layout.values(), gradients)
    times = interleave([
        lambda: lambda: simulate_many(scene, q, p, duration, threads=1, path_error='off'),
        lambda: lambda: simulate_many(scene, q, p, duration, threads=cores, path_error='off'),
        alone,
        lambda: product,
        lambda: lambda: simulate_many(scene, q, p, duration, threads=1)],
        settings.repetitions, one_thread=False)
    single = times[:, 2] / (_ALONE * steps)
    note = (f'{gradients / (m * steps):.2f} gradients per step; {steps} steps; "one" is the mean '
            f'of the first {_ALONE}, one after another, without their set-up')
    peer, miss = 'one trajectory', _MISS.format(np.median(times[:, 3] / (m * steps) / single))
    yield compare(f'{m} trajectories of {name}, one thread', times[:, 0] / (m * steps), single,
                  target=0.6, scale=1e6, unit='us per step', peer_name=peer, note=note,
                  miss=miss)
    yield compare(f'{m} trajectories of {name}, {cores} threads',
                  times[:, 1] * cores / (m * steps), single, target=0.6, scale=1e6,
                  unit='us per step and core', peer_name=peer, miss=miss)
    yield compare(
        f'{m} trajectories of {name}, with their path errors', times[:, 4], times[:, 0],
        target=None, scale=1.0, unit='s', peer_name='without them',
        note='all of them up to a million steps together, else a sample of at most 38')
    yield compare(
        f'{m} trajectories of {name}: share of a matrix product', times[:, 3], times[:, 0],
        target=None, scale=1.0, unit='s', peer_name='simulate_many, one thread',
        note='"ours" is the time of the matrix product alone: one of the operations of all '
        'gradients evaluated, by numpy')


def _product(networks: Collection[list[int]], gradients: int) -> Callable[[], None]:
    """Return a matrix product with the operation count of `gradients` gradients of networks."""
    # Each passes every weight forward and back: 4 operations a weight.
    operations = 4 * gradients * sum(
        n_in * n_out for widths in networks for n_in, n_out in pairwise(widths))
    n, rng = max(map(max, networks)), np.random.default_rng(SEED)
    weight, batch = rng.normal(size=(n, n)), rng.normal(size=(n, 2000))
    result = np.empty_like(batch)

    def run() -> None:
        for _ in range(max(1, round(operations / (2 * n * n * batch.shape[1])))):
            np.matmul(weight, batch, out=result)
    return run


def _check(scene: Scene, q_many: np.ndarray, q: np.ndarray, p: np.ndarray, steps: int) -> None:
    """Check some trajectories against those that run alone; some eps a step is allowed."""
    for i in range(0, len(q), len(q) // 7):
        alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(),
                           scene.step_size, q[i], p[i])
        alone.advance(steps)
        if not np.allclose(q_many[i], alone.q, rtol=0.0, atol=1e-13 * steps):
            raise RuntimeError(f'trajectory {i} is another one when it runs alone')
