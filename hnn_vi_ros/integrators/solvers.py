# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Solvers of the implicit equation x = G(x) of a step, each carried to round-off.

Each method states its equation as two functions: ``equation(problem, x, value)`` fills G(x), and
``tangent(problem, x, v, product)`` fills G'(x) v; ``problem`` holds whatever they need.

Every solver has the signature ``(equation, tangent, problem, x, memory, max_iterations)``. On
entry x is a first guess, on return the solution; ``memory.scale`` is read. It returns an outcome,
the largest relative residual [1] and the number of evaluations of G and of G' v.

Iterates stop when the residual G(x) - x, relative to the scale, is at most eps, or has stopped
shrinking at no more than max(8, N) eps. G was then evaluated last at the very x that is returned,
so that what it left in ``problem`` belongs to x.
"""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE, NOT_FINITE, OK
from hnn_vi_ros.linear_algebra import solve_linear
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Of a central difference, relative to what it is about.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
_DEPTH = 3
_GO_ON = -1


class SolverOptions(NamedTuple):
    """
    How an implicit equation is solved.

    Parameters
    ----------
    solve : callable
        One of the solvers of this module.
    extrapolate : bool
        Whether to start from earlier solutions.
    max_iterations : int
        Iterations after which the equation counts as not solved.

    """

    solve: Callable
    extrapolate: bool
    max_iterations: int


@inlined
def fixed_point(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
                memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """Iterate x = G(x), as the paper does; see the module."""
    previous, residual = math.inf, math.inf
    value, defect = memory.values[0], memory.residuals[0]
    for k in range(1, max_iterations + 1):
        outcome, residual = _judge(equation, problem, x, memory.scale, value, defect, previous,
                                   k == max_iterations)
        if outcome != _GO_ON:
            return outcome, residual, k
        previous = residual
        if k < max_iterations:
            x[:] = value
    return NO_CONVERGENCE, residual, max_iterations


@inlined
def secant(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """Solve unknowns that do not depend on each other by the secant method; see the module."""
    previous, residual = math.inf, math.inf
    value, defect = memory.values[0], memory.residuals[0]
    old_value, old_defect = memory.values[1], memory.residuals[1]
    for k in range(1, max_iterations + 1):
        outcome, residual = _judge(equation, problem, x, memory.scale, value, defect, previous,
                                   k == max_iterations)
        if outcome != _GO_ON:
            return outcome, residual, k
        if _is_hopeless(k, residual, previous):
            return NO_CONVERGENCE, residual, k
        previous = residual
        if k == max_iterations:
            break
        for i in range(x.size):
            x[i] = value[i]
            change = defect[i] - old_defect[i]
            if k > 1 and change != 0.0:
                x[i] -= defect[i] / change * (value[i] - old_value[i])
            old_value[i], old_defect[i] = value[i], defect[i]
    return NO_CONVERGENCE, residual, max_iterations


@inlined
def anderson(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
             memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """
    Accelerate the fixed-point iteration by Anderson's method of depth 3; see the module.

    References
    ----------
    H. Walker, P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49
    (2011).

    """
    previous, residual, rows = math.inf, math.inf, _DEPTH + 1
    for k in range(1, max_iterations + 1):
        value, defect = memory.values[k % rows], memory.residuals[k % rows]
        outcome, residual = _judge(equation, problem, x, memory.scale, value, defect, previous,
                                   k == max_iterations)
        if outcome != _GO_ON:
            return outcome, residual, k
        if _is_hopeless(k, residual, previous):
            return NO_CONVERGENCE, residual, k
        previous = residual
        if k < max_iterations:
            depth = min(k - 1, x.size, _DEPTH)
            used = _project(memory, k, defect, depth)
            _combine(memory, k, value, used, x)
    return NO_CONVERGENCE, residual, max_iterations


@inlined
def newton(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """
    Iterate (I - G'(x)) step = G(x) - x, the matrix built column by column; see the module.

    x_j is rounded to eps abs(x_j), and so G_i is known to eps sum_j abs(G'_ij x_j) at best: the
    scale of an unknown is that sum where it is larger, as for the momenta beside an angle that
    has turned over many times.
    """
    n = x.size
    value, defect, unit = memory.values[0], memory.residuals[0], memory.values[1]
    column, step = memory.values[2], memory.residuals[1]
    previous, residual, evaluations = math.inf, math.inf, 0
    for k in range(1, max_iterations + 1):
        outcome, residual = _judge(equation, problem, x, memory.scale, value, defect, previous,
                                   k == max_iterations)
        evaluations += 1
        if outcome != _GO_ON:
            return outcome, residual, evaluations
        if k == max_iterations or memory.matrix.shape[0] != n:
            break
        previous = residual
        known = memory.residuals[2]
        known[:] = 0.0
        for j in range(n):
            unit[:] = 0.0
            unit[j] = 1.0
            tangent(problem, x, unit, column)
            for i in range(n):
                memory.matrix[i, j] = unit[i] - column[i]
                known[i] += abs(column[i] * x[j])
            step[j] = value[j] - x[j]
        for i in range(n):
            memory.scale[i] = max(memory.scale[i], known[i])
        evaluations += n
        if not solve_linear(memory.matrix, step):
            break
        for i in range(n):
            x[i] += step[i]
    return NO_CONVERGENCE, residual, evaluations


@inlined
def difference(equation: Callable, problem: NamedTuple, x: np.ndarray, v: np.ndarray,
               product: np.ndarray) -> None:
    """Fill product with G'(x) v by a central difference, in the arrays ahead and behind."""
    size = 0.0
    for i in range(x.size):
        size = max(size, abs(v[i]) * problem.scale[i])
    spacing = _SPACING * (size if size > 0.0 else 1.0)
    for i in range(x.size):
        problem.ahead[i] = x[i] + spacing * v[i]
    equation(problem, problem.ahead, product)
    for i in range(x.size):
        problem.ahead[i] = x[i] - spacing * v[i]
    equation(problem, problem.ahead, problem.behind)
    for i in range(x.size):
        product[i] = (product[i] - problem.behind[i]) / (2.0 * spacing)


@inlined
def extrapolate(memory: Memory, base: np.ndarray, x: np.ndarray) -> None:
    """Start x from up to three earlier solutions, relative to their bases, where there are."""
    count, increments = memory.count[0], memory.increments
    for i in range(x.size):
        if count == 1:
            x[i] = base[i] + increments[0, i]
        elif count == 2:
            x[i] = base[i] + (2.0 * increments[0, i] - increments[1, i])
        elif count == 3:
            x[i] = base[i] + (3.0 * (increments[0, i] - increments[1, i]) + increments[2, i])


@inlined
def remember(memory: Memory, base: np.ndarray, x: np.ndarray) -> None:
    """Keep a solution relative to its base, for the next start."""
    increments = memory.increments
    for i in range(x.size):
        increments[2, i] = increments[1, i]
        increments[1, i] = increments[0, i]
        increments[0, i] = x[i] - base[i]
    memory.count[0] = min(memory.count[0] + 1, 3)


@inlined
def _residual(value: np.ndarray, x: np.ndarray, scale: np.ndarray, defect: np.ndarray) -> float:
    """Fill the defect G(x) - x relative to the scale; return its largest entry, NaN included."""
    result = 0.0
    for i in range(x.size):
        difference = value[i] - x[i]
        if difference == 0.0:
            defect[i] = difference
        elif scale[i] > 0.0:
            defect[i] = difference / scale[i]
        else:
            # A state and slope of zero say nothing about the size of the solution.
            defect[i] = difference / max(abs(value[i]), abs(x[i]))
        if not abs(defect[i]) <= result:
            result = abs(defect[i])
    return result


@inlined
def _judge(equation: Callable, problem: NamedTuple, x: np.ndarray, scale: np.ndarray,
           value: np.ndarray, defect: np.ndarray, previous: float, is_last: bool
           ) -> tuple[int, float]:
    """Evaluate G at x; say whether x is good enough, not finite, or to be improved."""
    equation(problem, x, value)
    residual = _residual(value, x, scale, defect)
    if not math.isfinite(residual):
        return NOT_FINITE, residual
    if residual <= _EPS or (residual <= max(8, x.size) * _EPS
                            and (residual >= previous or is_last)):
        return OK, residual
    return _GO_ON, residual


@inlined
def _is_hopeless(k: int, residual: float, previous: float) -> bool:
    """Tell when there is no contraction to speak of, so that Newton's method will be cheaper."""
    return k > 5 and residual > 0.5 * previous and residual > 1e-8


@inlined
def _project(memory: Memory, k: int, defect: np.ndarray, depth: int) -> int:
    """Orthogonalise the changes of the defect, and project it on them; return how many."""
    n, rows, basis, triangle = defect.size, _DEPTH + 1, memory.basis, memory.triangle
    for j in range(depth):
        earlier = memory.residuals[(k - 1 - j) % rows]
        size = 0.0
        for i in range(n):
            basis[j, i] = defect[i] - earlier[i]
            size += basis[j, i] * basis[j, i]
        for m in range(j):
            dot = 0.0
            for i in range(n):
                dot += basis[m, i] * basis[j, i]
            triangle[m, j] = dot
            for i in range(n):
                basis[j, i] -= dot * basis[m, i]
        left, projection = 0.0, 0.0
        for i in range(n):
            left += basis[j, i] * basis[j, i]
        if left <= 1e-20 * size:
            return j
        left = math.sqrt(left)
        for i in range(n):
            basis[j, i] /= left
            projection += basis[j, i] * defect[i]
        triangle[j, j], triangle[j, _DEPTH] = left, projection
    return depth


@inlined
def _combine(memory: Memory, k: int, value: np.ndarray, used: int, x: np.ndarray) -> None:
    """Set x to G less the combination of its changes that takes the projection away."""
    triangle = memory.triangle
    for i in range(x.size):
        x[i] = value[i]
    for j in range(used - 1, -1, -1):
        weight = triangle[j, _DEPTH]
        for m in range(j + 1, used):
            weight -= triangle[j, m] * triangle[m, _DEPTH]
        weight /= triangle[j, j]
        triangle[j, _DEPTH] = weight
        earlier = memory.values[(k - 1 - j) % (_DEPTH + 1)]
        for i in range(x.size):
            x[i] -= weight * (value[i] - earlier[i])
