# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Of several solutions of an implicit equation the one that is connected to h = 0."""

from collections.abc import Callable
import math
from typing import Any

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE, NO_SOLUTION
from hnn_vi_ros.integrators.newton import fill_matrix, newton
from hnn_vi_ros.integrators.workspaces import SolverWork
from hnn_vi_ros.kernels.linear_algebra import solve_linear
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

# Lengths as shares of the way from h = 0; points on it to try, and Newton steps at each.
_FIRST_LENGTH, _SHORTEST_LENGTH, _POINTS, _CORRECTIONS = 0.25, 2.0**-16, 100, 8
# Each Newton step must be shorter than the one before by this factor; they have arrived at this
# length relative to the scale, since the next step doubles the digits.
_CONTRACTION, _ARRIVED = 0.25, float(np.sqrt(np.finfo(np.float64).eps))


@inlined
def continuation(equation: Callable, tangent: Callable, problem: Any, x: np.ndarray,
                 work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Follow the solution from h = 0 to this h, and iterate there by Newton's method; see solvers.

    x(s) = b + s (G(x(s)) - b) for s from 0 to 1, where b = problem.base solves the equation with
    h = 0. Points of the way are so close that Newton's method contracts from each to the next and
    that the determinant of I - s G' stays positive: it does not come to another solution. The way
    ends as NO_SOLUTION at a fold, where that determinant goes through 0.

    References
    ----------
    E. Allgower, K. Georg, Numerical Continuation Methods, 1990, chapter 2.

    """
    n = x.size
    base, last = problem.base, work.newton.solved
    at, length, left, spent = 0.0, _FIRST_LENGTH, 0.0, 0
    if work.newton.matrix.shape[0] != n:
        return NO_CONVERGENCE, math.nan, 0
    copy_array(base, last)
    for _ in range(_POINTS):
        if at == 1.0:
            break
        share = min(1.0, at + length)
        copy_array(last, x)
        left, more = _correct(equation, tangent, problem, x, share, work)
        spent += more
        if left <= _ARRIVED:
            copy_array(x, last)
            at, length = share, 2.0 * length
        elif length <= _SHORTEST_LENGTH:
            break
        else:
            length *= 0.5
    if at < 1.0:
        return NO_SOLUTION if math.isfinite(left) else NO_CONVERGENCE, math.nan, spent
    outcome, residual, more = newton(equation, tangent, problem, x, work, max_iterations)
    return outcome, residual, spent + more


@called
def _correct(equation: Callable, tangent: Callable, problem: Any, x: np.ndarray,
             share: float, work: SolverWork) -> tuple[float, int]:
    """Move x to b + share (G(x) - b); return the last step over the scale, and evaluations."""
    n, iterates, own = x.size, work.iterates, work.newton
    value, step, scale = iterates.values[0], own.direction, iterates.scale
    size, spent = math.inf, 0
    for k in range(_CORRECTIONS):
        equation(problem, x, value)
        fill_matrix(tangent, problem, x, share, own)
        spent += n + 1
        for i in range(n):
            step[i] = problem.base[i] - x[i] + share * (value[i] - problem.base[i])
        before, size = size, 0.0
        if solve_linear(own.matrix, step) <= 0:
            return 1.0, spent
        for i in range(n):
            x[i] += step[i]
            if not abs(step[i]) <= size * scale[i]:
                size = abs(step[i]) / scale[i] if scale[i] > 0.0 else abs(step[i])
        if size <= _ARRIVED:
            return size, spent
        if k > 0 and not size <= _CONTRACTION * before:
            break
    return 1.0 if math.isfinite(size) else size, spent
