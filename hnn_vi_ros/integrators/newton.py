# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Newton's method with a Jacobian, for the equation x = G(x) of a step; see solvers."""

from collections.abc import Callable
import math
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, judge
from hnn_vi_ros.integrators.workspaces import NewtonWork, SolverWork
from hnn_vi_ros.kernels.linear_algebra import factorise_rows, solve_factorised
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

# Spacing of a central difference, relative to its argument.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
_EPS = float(np.finfo(np.float64).eps)
# A Jacobian is kept while each iteration takes the residual at least this many times down: one of
# N unknowns costs N evaluations, and a sixteenth of the digits is worth one.
_KEPT = 0.1


@inlined
def newton(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Iterate (I - G'(y)) step = G(x) - x, the matrix built column by column; see the module.

    y is an earlier iterate, at first the start: the matrix and its factors are kept as long as the
    residual shrinks fast with them. Nothing is kept from step to step.

    x_j is rounded to eps abs(x_j), and so G_i is known to eps sum_j abs(G'_ij x_j) at best: the
    scale of an unknown is that sum where it is larger, as for the momenta of an angle that has
    turned over many times. The scale of the largest of a kind holds for all of them: terms that
    do not cancel in H may cancel in the sum.
    """
    n, iterates, own = x.size, work.iterates, work.newton
    value, defect, step = iterates.values[0], iterates.residuals[0], own.direction
    sizes = iterates.scale, iterates.own_scale, iterates.accepted
    previous, residual, stage, evaluations = math.inf, math.inf, COMMON, 0
    bound, is_kept = max(8, n) * _EPS, False
    for k in range(1, max_iterations + 1):
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        evaluations += 1
        if outcome != GO_ON:
            return outcome, residual, evaluations
        if k == max_iterations or own.matrix.shape[0] != n:
            break
        if stage == BACK:
            copy_array(value, x)
            continue
        # Residuals of the size of rounding say nothing about the matrix.
        if not is_kept or residual > max(bound, _KEPT * previous):
            fill_matrix(tangent, problem, x, 1.0, own)
            raise_scales(iterates.scale, iterates.own_scale, own.known)
            evaluations += n
            is_kept = factorise_rows(own.matrix, own.pivots)
            if not is_kept:
                break
        previous = residual
        for i in range(n):
            step[i] = value[i] - x[i]
        solve_factorised(own.matrix, own.pivots, step)
        for i in range(n):
            x[i] += step[i]
    return NO_CONVERGENCE, residual, evaluations


@called
def fill_matrix(tangent: Callable, problem: NamedTuple, x: np.ndarray, share: float,
                work: NewtonWork) -> None:
    """Fill the matrix with I - share G'(x), and ``known`` with sum_j abs(G'_ij x_j)."""
    unit, column, known = work.direction, work.product, work.known
    known[:] = 0.0
    for j in range(x.size):
        unit[:] = 0.0
        unit[j] = 1.0
        tangent(problem, x, unit, column)
        for i in range(x.size):
            work.matrix[i, j] = unit[i] - share * column[i]
            known[i] += abs(column[i] * x[j])


@inlined
def raise_scales(scale: np.ndarray, own_scale: np.ndarray, known: np.ndarray) -> None:
    """Raise each own scale to the accuracy of the equation, and the others to the largest."""
    for i in range(scale.size):
        own_scale[i] = max(own_scale[i], known[i])
    first = 0
    for i in range(1, scale.size + 1):
        # Unknowns of one kind and trajectory lie together, and share a scale.
        if i == scale.size or scale[i] != scale[first]:
            size = scale[first]
            for j in range(first, i):
                size = max(size, own_scale[j])
            for j in range(first, i):
                scale[j] = size
            first = i


@inlined
def difference(equation: Callable, problem: Any, x: np.ndarray, v: np.ndarray,
               product: np.ndarray) -> None:
    """Fill product with G'(x) v by a central difference, in the arrays ahead and behind."""
    size = 0.0
    for i in range(x.size):
        # An integral of a channel has no scale: nothing depends on it.
        if problem.scale[i] < math.inf:
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
