# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""RATTLE: impulses around a step that keep a system of rods in shape."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hnn_vi_ros.compilation import called, inlined
from hnn_vi_ros.effects.points import add_along, distance, separation
from hnn_vi_ros.effects.wrapped import scratch
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.arithmetic import copy_point, largest, plus
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE, OK, Point
from hnn_vi_ros.linear_algebra import solve_linear
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
_ITERATIONS = 50
# Rounding of a step's coordinates and of a distance, in units of eps and of their size.
_ROUNDING = 64


class Rods(NamedTuple):
    """
    K rods between points of n coordinates at most, and the space to solve for their impulses.

    Parameters
    ----------
    first, second, anchor : np.ndarray, shape (K, n)
        See points.resolve_pair.
    sizes : np.ndarray, shape (K,)
        The number of coordinates of each.
    lengths : np.ndarray, shape (K,)
        Their lengths [m].
    old, new, inverse_mass : np.ndarray, shape (K, D)
        The gradient G of g at the start and at the end, and H_pp G^T.
    matrix : np.ndarray, shape (K, K)
        The linear system.
    right, defect, pending : np.ndarray, shape (K,), (K,) and that of Live.pending
        Its right-hand side, g(q), and the effects' work before the step.

    """

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    sizes: np.ndarray
    lengths: np.ndarray
    old: np.ndarray
    new: np.ndarray
    inverse_mass: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    defect: np.ndarray
    pending: np.ndarray

    @classmethod
    def of(cls, stacked: tuple[np.ndarray, ...], dimension: int, effects: int) -> 'Rods':
        """Return rods with their space, for a kernel of dimension D."""
        count = stacked[4].size
        return cls(*stacked, *np.zeros((3, count, dimension)), np.zeros((count, count)),
                   *np.zeros((2, count)), np.zeros(effects))


def stack(rods: Sequence[tuple]) -> tuple[np.ndarray, ...]:
    """
    Return rods together: ends and anchors of shape (K, n), sizes and lengths of shape (K,).

    Parameters
    ----------
    rods : sequence of tuple
        What ``resolve`` gave for each of the K rods.

    """
    n = max(rod[0].size for rod in rods)
    first, second = np.full((2, len(rods), n), -1)
    anchor = np.zeros((len(rods), n))
    for k, rod in enumerate(rods):
        for target, part in zip((first, second, anchor), rod, strict=False):
            target[k, :part.size] = part
    sizes = np.array([rod[0].size for rod in rods])
    return first, second, anchor, sizes, np.array([rod[3] for rod in rods])


@called
def constrain(rods: Rods, q: np.ndarray, gradient: np.ndarray) -> float:
    """Fill g(q) and its gradient; return the largest abs(g) [m], NaN included."""
    gradient[:] = 0.0
    for k in range(rods.lengths.size):
        n = rods.sizes[k]
        first, second, anchor = rods.first[k, :n], rods.second[k, :n], rods.anchor[k, :n]
        r = distance(first, second, anchor, q)
        rods.defect[k] = r - rods.lengths[k]
        for j in range(n):
            along = separation(first, second, anchor, q, j)
            add_along(first, second, j, along / r if r != 0.0 else 0.0, gradient[k])
    return largest(rods.defect)


def rattle(step: Callable) -> Callable:
    """
    Return a step that keeps g(q) = 0 and G(q) q' = 0, G = g'.

        p+ = p_n - (h/2) G(q_n)^T lambda,  (q_(n+1), p-) = step(q_n, p+),  g(q_(n+1)) = 0
        p_(n+1) = p- - (h/2) G(q_(n+1))^T mu,  G(q_(n+1)) H_p(q_(n+1), p_(n+1)) = 0

    Symplectic on the constraint manifold and symmetric, as the step is, and of order 2. lambda
    is found by Newton's method, with the derivative -(h^2/2) G(q_(n+1)) H_pp G(q_n)^T of g.

    References
    ----------
    H. Andersen, RATTLE: a velocity version of the SHAKE algorithm, J. Comput. Phys. 52 (1983).
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """
    @inlined
    def constrained(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
                    memory: tuple[Memory, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, rods, live, _ = options
        start, space = scratch(memory), memory[len(memory) - 1]
        count = rods.lengths.size
        # The last step's solution is the first guess.
        multipliers = space.newton[:count]
        constrain(rods, z.q, rods.old)
        _apply_inverse_mass(kernel, rods, rods.old, z, space)
        rods.pending[:] = live.pending
        size = largest(z.q) + largest(rods.lengths)
        previous, residual, spent = np.inf, np.inf, 0
        for _ in range(_ITERATIONS):
            copy_point(z, start)
            live.pending[:] = rods.pending
            _kick(rods.old, multipliers, 0.5 * h, start)
            for k in range(len(memory) - 1):
                # Trials of one step are no guide to the next start.
                memory[k].count[0] = 0
            outcome, residual, gradients = step(kernel, h, inner, start, z1, memory[:-1])
            spent += gradients
            if outcome != OK:
                multipliers[:] = 0.0
                return outcome, residual, spent
            error = constrain(rods, z1.q, rods.new) / size
            if error <= _EPS or (error >= previous and error <= _ROUNDING * _EPS):
                more = _end(kernel, h, rods, z1, space)
                if more < 0:
                    return NO_CONVERGENCE, residual, spent
                return OK, residual, spent + more
            previous = error
            rods.right[:] = rods.defect
            _fill_matrix(rods, 0.5 * h * h)
            if not (error < np.inf and solve_linear(rods.matrix, rods.right)):
                break
            for k in range(count):
                multipliers[k] += rods.right[k]
        multipliers[:] = 0.0
        return NO_CONVERGENCE, previous, spent
    return constrained


@called
def _end(kernel: Kernel, h: float, rods: Rods, z: Point, space: Memory) -> int:
    """Take the velocity along the rods away; return the gradients it took, -1 if in vain."""
    _apply_inverse_mass(kernel, rods, rods.new, z, space)
    previous = np.inf
    for spent in range(1, _ITERATIONS):
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
        speed = largest(z.dH_dp[:kernel.dimension - kernel.channels])
        for k in range(rods.right.size):
            rods.right[k] = 0.0
            for i in range(z.q.size):
                rods.right[k] += rods.new[k, i] * z.dH_dp[i]
        error = largest(rods.right)
        if error <= _EPS * speed or (error >= previous and error <= _ROUNDING * _EPS * speed):
            return spent
        previous = error
        _fill_matrix(rods, 0.5 * h)
        if not (error < np.inf and solve_linear(rods.matrix, rods.right)):
            break
        _kick(rods.new, rods.right, 0.5 * h, z)
    return -1


@called
def _apply_inverse_mass(kernel: Kernel, rods: Rods, gradient: np.ndarray, z: Point, space: Memory
                        ) -> None:
    """Fill H_pp G^T, one row for each rod."""
    zero, rest = space.basis[0], space.basis[1]
    for i in range(zero.size):
        zero[i] = 0.0
    for k in range(rods.lengths.size):
        kernel.hessian_vector(kernel.parameters, z.q, z.p, zero, gradient[k], rest,
                              rods.inverse_mass[k])


@called
def _fill_matrix(rods: Rods, factor: float) -> None:
    """Fill factor G H_pp G^T, from G at the end and H_pp G^T as it was filled."""
    count = rods.lengths.size
    for k in range(count):
        for m in range(count):
            total = 0.0
            for i in range(rods.new.shape[1]):
                total += rods.new[k, i] * rods.inverse_mass[m, i]
            rods.matrix[k, m] = factor * total


@called
def _kick(gradient: np.ndarray, multipliers: np.ndarray, factor: float, z: Point) -> None:
    """Change p by -factor G^T multipliers."""
    for i in range(z.p.size):
        total = 0.0
        for k in range(multipliers.size):
            total += gradient[k, i] * multipliers[k]
        z.p[i], z.p_carry[i] = plus(z.p[i], z.p_carry[i], -factor * total)
