# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 1: one gradient of a small tanh network in a compiled loop, compared with JAX."""

from collections.abc import Callable, Iterator, Sequence

from benchmarks.measurement import assert_close, race, Row, Settings
from benchmarks.systems import random_checkpoint
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models import NeuralHamiltonian
import jax
import jax.numpy as jnp
import numba
import numpy as np
from studies.peers import jax_energy

# In single precision JAX would do half of the work.
jax.config.update('jax_enable_x64', True)
SEED = 1
# Width of the two hidden layers, target, gradients in a run.
_CASES = ((32, 0.9, 20000), (64, 0.9, 10000), (200, 1.0, 4000))
RATE = 1e-3
# Gradients in one turn of JAX's loop; the faster is the peer.
UNROLL = (1, 8)
_START = (0.3, 0.2)


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a network."""
    for width, target, n in _CASES:
        settings.say(f'2-{width}-{width}-1')
        n = n // 10 if settings.quick else n
        checkpoint = random_checkpoint([2, width, width, 1], SEED)
        hamiltonian = NeuralHamiltonian(checkpoint)
        ours = our_loop(hamiltonian.kernel, _START, n)
        gradient = jax.grad(jax_energy(hamiltonian))
        theirs = {f'jax.lax.scan of jax.grad, unroll={unroll}':
                  jax_loop(gradient, _START, n, unroll) for unroll in UNROLL}
        # Descent does not amplify the rounding errors: 1e-12 a gradient, and n small steps.
        assert_close('gradient', np.concatenate(hamiltonian.gradient(*np.array(_START)[:, None])),
                     gradient(jnp.array(_START)), 1e-12)
        for run in theirs.values():
            assert_close('descent', ours(), run(), 1e-12 * max(1.0, n * RATE))
        yield race(
            f'gradient of 2-{width}-{width}-1', {'ours': lambda run=ours: run},
            {name: lambda run=run: run for name, run in theirs.items()}, settings,
            target=target, scale=1e6 / n)


def our_loop(kernel: Kernel, start: Sequence[float], n: int) -> Callable[[], np.ndarray]:
    """Return n steps of a descent as a compiled loop."""
    gradient = kernel.gradient

    @numba.njit
    def loop(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
             dH_dp: np.ndarray) -> None:
        for _ in range(n):
            gradient(parameters, q, p, dH_dq, dH_dp)
            for i in range(q.size):
                q[i] -= RATE * dH_dq[i]
                p[i] -= RATE * dH_dp[i]

    def run() -> np.ndarray:
        q, p = np.array(start).reshape(2, -1)
        loop(kernel.parameters, q, p, np.zeros_like(q), np.zeros_like(p))
        return np.concatenate([q, p])
    return run


def jax_loop(gradient: Callable, start: Sequence[float], n: int, unroll: int) -> Callable:
    """Return n steps of a descent by jax.lax.scan."""
    @jax.jit
    def loop(z: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda z, _: (z - RATE * gradient(z), None), z, None, length=n,
                            unroll=unroll)[0]

    return lambda: loop(jnp.array(start)).block_until_ready()
