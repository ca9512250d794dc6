# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 1: one gradient of small tanh networks in a compiled loop, compared with JAX."""

from collections.abc import Callable, Iterator, Sequence

from benchmarks.measurement import assert_close, race, Row, Settings
from benchmarks.systems import random_checkpoint, random_family
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models import Checkpoint, Layers, load_member
import jax
import jax.numpy as jnp
import numba
import numpy as np
# In single precision JAX would do half of the work.
jax.config.update('jax_enable_x64', True)
SEED = 1
# Width of the two hidden layers, target, gradients in a run.
_WIDTHS = ((32, 0.9, 20000), (64, 0.9, 10000), (200, 1.0, 4000))
# Gradients in a run of other families, of networks of width 32.
_COUNT = 5000
RATE = 1e-3
# Gradients in one turn of JAX's loop; the faster is the peer.
UNROLL = (1, 8)
_START = (0.3, 0.2)


def _network(x: jax.Array, layers: Layers) -> jax.Array:
    *hidden, last = [tuple(map(jnp.asarray, parts)) for parts in zip(*layers, strict=True)]
    for weight, bias in hidden:
        x = jnp.tanh(weight @ x + bias)
    return last[0] @ x + last[1]


def _lower(entries: jax.Array, d: int) -> jax.Array:
    return jnp.zeros((d, d)).at[jnp.tril_indices(d)].set(entries)


def _energy(checkpoint: Checkpoint) -> Callable[[jax.Array], jax.Array]:
    """Return H of a random model as a JAX function of (q, p), shape (2 d,)."""
    networks, card = checkpoint.networks, checkpoint.card

    def separable(z: jax.Array) -> jax.Array:
        return (_network(z[1:], networks['kinetic']) + _network(z[:1], networks['potential']))[0]

    def control_affine(z: jax.Array) -> jax.Array:
        w = _lower(_network(z[:2], networks['mass_inverse']), 2).T @ z[2:]
        return 0.5 * w @ w + _network(z[:2], networks['potential'])[0]

    def mechanical(z: jax.Array) -> jax.Array:
        entries = card.mechanical
        angles = jnp.array(entries.features) @ z[:2], jnp.array(entries.mass_features) @ z[:2]
        potential, mass = (_network(
            jnp.stack([jnp.sin(angle), jnp.cos(angle)], -1).ravel(), networks[name])
            for name, angle in zip(('potential', 'mass'), angles, strict=True))
        root = _lower(jnp.where(jnp.array([True, False, True]), jax.nn.softplus(mass), mass), 2)
        u = z[2:] / jnp.array(entries.mass_scale)
        return potential[0] + 0.5 * u @ jax.scipy.linalg.solve(
            root @ root.T + entries.floor * jnp.eye(2), u, assume_a='pos')

    def hnn(z: jax.Array) -> jax.Array:
        return _network(z, networks['energy'])[0]
    return {'hnn': hnn, 'separable_hnn': separable, 'control_affine': control_affine,
            'mechanical': mechanical}[card.family]


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a network, and one each of other families."""
    for width, target, n in _WIDTHS:
        checkpoint = random_checkpoint([2, width, width, 1], SEED)
        yield _row(f'2-{width}-{width}-1', checkpoint, _START, target, n, settings)
    for name in ('separable_hnn', 'control_affine', 'mechanical'):
        checkpoint = random_family(name, SEED)
        d = len(checkpoint.card.coordinates)
        yield _row(name, checkpoint, [x for x in _START for _ in range(d)], 0.9, _COUNT, settings)


def _row(name: str, checkpoint: Checkpoint, start: Sequence[float], target: float, n: int,
         settings: Settings) -> Row:
    settings.say(name)
    n = n // 10 if settings.quick else n
    hamiltonian = load_member(checkpoint, None)
    ours = our_loop(hamiltonian.kernel, start, n)
    gradient = jax.grad(_energy(checkpoint))
    theirs = {f'jax.lax.scan of jax.grad, unroll={unroll}':
              jax_loop(gradient, start, n, unroll) for unroll in UNROLL}
    # Descent does not amplify the rounding errors: 1e-12 a gradient, and n small steps.
    assert_close('gradient', np.concatenate(hamiltonian.gradient(*np.split(np.array(start), 2))),
                 gradient(jnp.array(start)), 1e-12)
    for run in theirs.values():
        assert_close('descent', ours(), run(), 1e-12 * max(1.0, n * RATE))
    return race(f'gradient of {name}', {'ours': lambda run=ours: run},
                {peer: lambda run=run: run for peer, run in theirs.items()}, settings,
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
