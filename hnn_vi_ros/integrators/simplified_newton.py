# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simplified Newton method for the stages of collocation; see solvers."""

from collections.abc import Callable
from functools import cache
import math
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, is_hopeless, judge
from hnn_vi_ros.integrators.workspaces import NewtonWork, SolverWork
from hnn_vi_ros.kernels.linear_algebra import invert
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)


class Modes(NamedTuple):
    """
    The eigenvalues and eigenvectors of a Runge-Kutta matrix, A = right diag(values) left.

    Parameters
    ----------
    values : np.ndarray of complex, shape (r,)
        One of each conjugate pair, and the real one where the number s of stages is odd.
    left : np.ndarray of complex, shape (r, s)
        The rows of the inverse of the eigenvectors.
    right : np.ndarray of complex, shape (s, r)
        The eigenvectors, doubled for a pair: the real part of a sum over them is the sum over all.

    """

    values: np.ndarray
    left: np.ndarray
    right: np.ndarray


@cache
def modes_of(matrix: tuple[tuple[float, ...], ...]) -> Modes:
    """Return the modes of a matrix that has complex pairs, and at most one real eigenvalue."""
    values, right = np.linalg.eig(np.array(matrix, dtype=complex))
    left = np.linalg.inv(right)
    noise = _EPS * float(np.linalg.cond(right))
    kept = [k for k, value in enumerate(values) if value.imag > -noise]
    share = [1.0 if abs(values[k].imag) <= noise else 2.0 for k in kept]
    return Modes(values[kept], np.ascontiguousarray(left[kept]),
                 np.ascontiguousarray(right[:, kept] * share))


class ModesWork(NamedTuple):
    """
    The matrix of the simplified Newton method in the eigenvectors of A.

    Parameters
    ----------
    inverses : np.ndarray of complex, shape (r, N)
        The inverse of I - mu J for each eigenvalue and, one after another, each system.
    vectors : np.ndarray of complex, shape (2, s)
        Its right factor, and the product.
    pivots : np.ndarray of int, shape (s,)
        The rows that were exchanged.

    """

    inverses: np.ndarray
    vectors: np.ndarray
    pivots: np.ndarray

    @classmethod
    def empty(cls, stages: int, n: int) -> 'ModesWork':
        """Return the working space of systems of up to s / 2 coordinates, n in all."""
        return cls(np.zeros(((stages + 1) // 2, 2 * stages * n), dtype=complex),
                   np.zeros((2, stages), dtype=complex), np.zeros(stages, dtype=np.int64))


@inlined
def simplified_newton(equation: Callable, tangent: Callable, problem: Any, x: np.ndarray,
                      work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Solve for s stages with one matrix, I - h A x J, in each step.

    J = (H_pq, H_pp; -H_qq, -H_qp) is taken at the middle stage of the start, with the forces. In
    the eigenvectors of A the matrix falls into I - mu J, one for each eigenvalue mu / h. Of as
    many coordinates as half the stages, or fewer, J takes no more products than there are stages.

    Channels follow from G. Where a residual was to fall below eps with the rate of the iteration
    before, what is left is rounding.

    References
    ----------
    E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, section IV.8.

    """
    iterates = work.iterates
    sizes = iterates.scale, iterates.own_scale, iterates.accepted
    value, defect = iterates.values[0], iterates.residuals[0]
    before, previous, residual, stage = math.inf, math.inf, math.inf, COMMON
    for k in range(1, max_iterations + 1):
        settled = stage == COMMON and before < math.inf and previous * previous <= _EPS * before
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect,
                                         0.0 if settled else previous, stage, k == max_iterations)
        # J counts as one evaluation.
        if outcome != GO_ON:
            return outcome, residual, k + 1
        if stage == COMMON and is_hopeless(k, residual, previous):
            return NO_CONVERGENCE, residual, k + 1
        before, previous = previous, residual
        if k == max_iterations:
            break
        if stage == BACK:
            copy_array(value, x)
            continue
        if k == 1 and not _invert(problem, x, work.newton):
            return NO_CONVERGENCE, residual, k + 1
        _correct(problem, value, x)
    return NO_CONVERGENCE, residual, max_iterations + 1


@inlined
def _invert(problem: Any, x: np.ndarray, work: NewtonWork) -> bool:
    """Fill the inverses of I - mu J; return False if one is singular."""
    kernel, s, n = problem.kernel, problem.matrix.shape[0], problem.z.q.size
    inverses, width = problem.work.inverses, kernel.dimension
    d = width - kernel.channels
    m, middle = 2 * d, s // 2 * n
    v, product = work.direction, work.product
    for column in range(m):
        at = column if column < d else n + column - d
        v[:2 * n] = 0.0
        for i in range(0, n, width):
            v[at + i] = 1.0
        kernel.hessian_vector(
            kernel.parameters, x[middle:middle + n], x[s * n + middle:s * n + middle + n],
            v[:n], v[n:2 * n], product[:n], product[n:2 * n])
        for k in range(inverses.shape[0]):
            mu, to = problem.h * problem.modes.values[k], column
            for i in range(0, n, width):
                for row in range(d):
                    inverses[k, to + row * m] = -mu * product[n + i + row]
                    inverses[k, to + (d + row) * m] = mu * product[i + row]
                inverses[k, to + column * m] += 1.0
                to += m * m
    for k in range(inverses.shape[0]):
        for i in range(n // width):
            if not invert(inverses[k], i * m * m, problem.work.pivots[:m]):
                return False
    return True


@inlined
def _correct(problem: Any, value: np.ndarray, x: np.ndarray) -> None:
    """Take a step of Newton's method; ``value`` is not kept."""
    s, n, modes = problem.matrix.shape[0], problem.z.q.size, problem.modes
    width = problem.kernel.dimension
    d = width - problem.kernel.channels
    m, at, w, y = 2 * d, 0, problem.work.vectors[0], problem.work.vectors[1]
    for i in range(0, n, width):
        for j in range(2 * s):
            for a in range(j * n + i, j * n + i + d):
                value[a] -= x[a]
            for a in range(j * n + i + d, j * n + i + width):
                x[a] = value[a]
        for k in range(modes.values.size):
            for a in range(m):
                first = i + a if a < d else s * n + i + a - d
                w[a] = 0.0
                for j in range(s):
                    w[a] += modes.left[k, j] * value[first + j * n]
            for a in range(m):
                y[a] = 0.0
                for b in range(m):
                    y[a] += problem.work.inverses[k, at + a * m + b] * w[b]
                first = i + a if a < d else s * n + i + a - d
                for j in range(s):
                    x[first + j * n] += (modes.right[j, k] * y[a]).real
        at += m * m
