# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Newton's method for the implicit equation x = G(x) of a step, and the way to its start."""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.compilation import called, inlined
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE, NO_SOLUTION, OK
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, judge
from hnn_vi_ros.linear_algebra import solve_linear
import numpy as np

# Of a central difference, relative to what it is about.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
# Of the way from h = 0, points of it that are tried, and corrections by Newton's method at each.
_FIRST_LENGTH, _SHORTEST_LENGTH, _POINTS, _CORRECTIONS = 0.25, 2.0**-16, 100, 8
# Ever further ahead, for a fold.
_LOOKS = 8


@inlined
def continuation(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
                 memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """
    Follow the solution from h = 0 to this h, and there iterate by Newton's method; see solvers.

    With x(0) the base b, x(s) = b + s (G(x(s)) - b) for s from 0 to 1: of several solutions the
    one that is connected to h = 0, whatever came before. The connection ends where the
    determinant of I - s G' changes its sign, at a fold. Steps in s are so short that Newton's
    method contracts by 4 from the predicted point on, and does not reach another solution.
    """
    n = x.size
    base, last, rate, step = memory.base, memory.basis[0], memory.basis[1], memory.residuals[1]
    at, length, evaluations, turned = 0.0, _FIRST_LENGTH, 1, False
    if memory.matrix.shape[0] != n:
        return NO_CONVERGENCE, math.nan, 0
    x[:] = base
    equation(problem, x, memory.values[0])
    for i in range(n):
        rate[i] = memory.values[0][i] - base[i]
    for _ in range(_POINTS):
        if at == 1.0:
            break
        target = min(1.0, at + length)
        for i in range(n):
            last[i] = x[i]
            step[i] = (target - at) * rate[i]
        followed, sign, more = _correct(equation, tangent, problem, x, target, memory)
        evaluations += more
        if followed:
            at, length, turned = target, 2.0 * length, False
            _fill_matrix(tangent, problem, x, at, memory)
            for i in range(n):
                rate[i] = memory.values[0][i] - base[i]
            # G is that of the iterate before the last correction, as good as this.
            solve_linear(memory.matrix, rate)
            evaluations += n
            continue
        x[:] = last
        turned, length = turned or sign <= 0, 0.5 * length
        if length < _SHORTEST_LENGTH:
            turned = turned or _turns(tangent, problem, x, at, memory)
            return NO_SOLUTION if turned else NO_CONVERGENCE, math.nan, evaluations
    if at < 1.0:
        return NO_CONVERGENCE, math.nan, evaluations
    outcome, residual, more = newton(equation, tangent, problem, x, memory, max_iterations)
    if outcome == OK and memory.count[1] == 1:
        # The solution that was in doubt: this one, or another?
        memory.count[1] = 0
        for i in range(n):
            if abs(x[i] - memory.candidate[i]) > _SPACING * memory.scale[i]:
                memory.count[1] = 2
    return outcome, residual, evaluations + more


@called
def _turns(tangent: Callable, problem: NamedTuple, x: np.ndarray, share: float, memory: Memory
           ) -> bool:
    """Tell whether the determinant changes its sign a little further on in the same direction."""
    ahead, rate = memory.basis[2], memory.basis[1]
    for k in range(_LOOKS):
        for i in range(x.size):
            ahead[i] = x[i] + 2.0**k * _SHORTEST_LENGTH * rate[i]
        _fill_matrix(tangent, problem, ahead, share, memory)
        memory.residuals[1][:] = 0.0
        if solve_linear(memory.matrix, memory.residuals[1]) <= 0:
            return True
    return False


@inlined
def _correct(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
             share: float, memory: Memory) -> tuple[bool, int, int]:
    """
    Move x by the predicted step, and by Newton's method to b + share (G(x) - b).

    Returns
    -------
    tuple of (bool, int, int)
        Whether it contracted to the solution, the sign of the last determinant, and evaluations.

    """
    n = x.size
    value, step, scale = memory.values[0], memory.residuals[1], memory.scale
    size, evaluations, sign = math.inf, 0, 1
    for k in range(_CORRECTIONS):
        before, size = size, 0.0
        for i in range(n):
            x[i] += step[i]
            if scale[i] < math.inf and not abs(step[i]) <= size * scale[i]:
                size = abs(step[i]) / scale[i] if scale[i] > 0.0 else abs(step[i])
        if k > 0 and size <= _SPACING:
            return True, sign, evaluations
        if not size <= 0.25 * before:
            return False, sign, evaluations
        equation(problem, x, value)
        _fill_matrix(tangent, problem, x, share, memory)
        evaluations += n + 1
        for i in range(n):
            step[i] = memory.base[i] - x[i] + share * (value[i] - memory.base[i])
        sign = solve_linear(memory.matrix, step)
        if sign <= 0:
            return False, sign, evaluations
    return False, sign, evaluations


@called
def _fill_matrix(tangent: Callable, problem: NamedTuple, x: np.ndarray, share: float,
                 memory: Memory) -> None:
    """Fill the matrix with I - share G'(x), column by column, and known: see newton."""
    unit, column, known = memory.values[1], memory.values[2], memory.residuals[2]
    known[:] = 0.0
    for j in range(x.size):
        unit[:] = 0.0
        unit[j] = 1.0
        tangent(problem, x, unit, column)
        for i in range(x.size):
            memory.matrix[i, j] = unit[i] - share * column[i]
            known[i] += abs(column[i] * x[j])


@inlined
def newton(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """
    Iterate (I - G'(x)) step = G(x) - x, the matrix built column by column; see the module.

    x_j is rounded to eps abs(x_j), and so G_i is known to eps sum_j abs(G'_ij x_j) at best: the
    scale of an unknown is that sum where it is larger, as for the momenta beside an angle that
    has turned over many times. The scale of the largest of a kind is so for all of them: terms
    may cancel in the sum that do not in H.
    """
    n = x.size
    value, defect, step = memory.values[0], memory.residuals[0], memory.residuals[1]
    sizes = memory.scale, memory.own_scale, memory.accepted
    previous, residual, stage, evaluations = math.inf, math.inf, COMMON, 0
    for k in range(1, max_iterations + 1):
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        evaluations += 1
        if outcome != GO_ON:
            return outcome, residual, evaluations
        if k == max_iterations or memory.matrix.shape[0] != n:
            break
        if stage == BACK:
            x[:] = value
            continue
        previous = residual
        _fill_matrix(tangent, problem, x, 1.0, memory)
        for i in range(n):
            step[i] = value[i] - x[i]
        _raise_scales(memory.scale, memory.own_scale, memory.residuals[2])
        evaluations += n
        if not solve_linear(memory.matrix, step):
            break
        for i in range(n):
            x[i] += step[i]
    return NO_CONVERGENCE, residual, evaluations


@inlined
def _raise_scales(scale: np.ndarray, own_scale: np.ndarray, known: np.ndarray) -> None:
    """Raise each own scale to what the equation is known to, and the others to the largest."""
    for i in range(scale.size):
        own_scale[i] = max(own_scale[i], known[i])
    for i in range(scale.size):
        # Unknowns of one kind and trajectory share a scale.
        size = scale[i]
        for j in range(scale.size):
            if scale[j] == scale[i]:
                size = max(size, own_scale[j])
        known[i] = size
    for i in range(scale.size):
        scale[i] = known[i]


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
