# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 2: one step of variational_euler, solved to round-off, compared with the same in JAX."""

from collections.abc import Callable, Iterator

from benchmarks.choosing import path_run, problem_of
from benchmarks.measurement import assert_close, race, Row, Settings, summarise
from hnn_vi_ros.models import NeuralHamiltonian
import jax
import jax.numpy as jnp
import numpy as np
from studies.peers import jax_energy

_H = 0.01
_STEPS = 1000
_EPS = float(np.finfo(np.float64).eps)
_SCENES = ('harmonic_oscillator', 'pendulum', 'double_pendulum')
# Residuals of up to 8 eps, of momenta of about 10, in 1000 steps, amplified where it is chaotic by
# exp(10 s / 6 s).
_AGREEMENT = 1e-10


def rows(settings: Settings) -> Iterator[Row]:
    """Measure two rows a shipped model: gradients per step, and time."""
    for name in _SCENES:
        settings.say(name)
        yield from _rows_of(name, settings)


def _rows_of(name: str, settings: Settings) -> Iterator[Row]:
    problem = problem_of(name)
    hamiltonian, start = problem.hamiltonian, (problem.q, problem.p)
    simulation = problem.simulation('variational_euler', _H)
    prepare = path_run(problem, simulation, 1, _STEPS)
    (end,) = prepare()()
    peers = {label: jax_euler(hamiltonian, *start, extrapolate) for label, extrapolate in (
        ("JAX from the paper's start", False), ('JAX from an extrapolated start', True))}
    counts = {}
    for label, peer in peers.items():
        z, count = peer()
        assert_close(f'{name}: trajectory', end, z, _AGREEMENT)
        counts[label] = int(count) / _STEPS
    gradients = simulation.gradients / _STEPS
    yield summarise(f'variational_euler on {name}: gradients per step', f'{gradients:.2f}',
                    f'JAX {min(counts.values()):.2f}', gradients, 5.0, unit='gradients')
    yield race(
        f'variational_euler on {name}: time per step', {'ours': prepare},
        {label: lambda peer=peer: peer for label, peer in peers.items()}, settings, target=0.7,
        scale=1e6 / _STEPS, note='; '.join(
            f'{label}: {count:.2f} gradients per step' for label, count in counts.items()))


def jax_euler(hamiltonian: NeuralHamiltonian, q: np.ndarray, p: np.ndarray,
              extrapolate: bool) -> Callable[[], tuple[jax.Array, jax.Array]]:
    """
    Return a run of the scheme in JAX, from (q, p); it returns the last (q, p) and a count.

    The fixed-point iteration of p1 = p - h H_q(q1, p1) stops as ours does, and the gradient of
    its last iterate is the first of the next step. It starts from p - h H_q(q, p), or from
    three earlier increments.
    """
    gradient, d = jax.grad(jax_energy(hamiltonian)), q.size
    rounding = hamiltonian.kernel.gradient_scale[0]

    def step(carry: tuple, _: None) -> tuple[tuple, None]:
        z, g, increments, count = carry
        q1, p0 = z[:d] + _H * g[d:], z[d:]
        start = p0 - _H * g[:d]
        if extrapolate:
            start = p0 + 3.0 * (increments[0] - increments[1]) + increments[2]
        scale = jnp.maximum(jnp.maximum(
            jnp.max(jnp.abs(p0)), _H * jnp.max(jnp.abs(g[:d]))), _H * rounding)

        def goes_on(loop: tuple) -> jax.Array:
            _, _, _, residual, previous, k = loop
            accepted = (residual <= _EPS) | (
                (residual <= max(8, d) * _EPS) & (residual >= previous))
            return ~accepted & (k < 100)

        def iterate(loop: tuple) -> tuple:
            _, x, _, previous, _, k = loop
            g = gradient(jnp.concatenate([q1, x]))
            value = p0 - _H * g[:d]
            return x, value, g, jnp.max(jnp.abs(value - x)) / scale, previous, k + 1

        p1, _, g, _, _, k = jax.lax.while_loop(
            goes_on, iterate, (start, start, g, jnp.inf, jnp.inf, 0))
        increments = jnp.stack([p1 - p0, increments[0], increments[1]])
        return (jnp.concatenate([q1, p1]), g, increments, count + k), None

    @jax.jit
    def run(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        g = gradient(z)
        # Three equal increments extrapolate to themselves: the paper's start of the first step.
        increments = jnp.tile(-_H * g[:d], (3, 1))
        z, _, _, count = jax.lax.scan(step, (z, g, increments, 0), None, length=_STEPS)[0]
        return z, count

    z0 = jnp.concatenate([jnp.asarray(q), jnp.asarray(p)])
    return lambda: jax.block_until_ready(run(z0))
