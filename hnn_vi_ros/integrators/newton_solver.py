# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Newton's method for the equation x = G(x) of a step; see solvers.

Variants: with a Jacobian, matrix-free with GMRES, and by continuation from h = 0.
"""

from collections.abc import Callable
from functools import cache
import math
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE, NO_SOLUTION
from hnn_vi_ros.integrators.solvers import GO_ON, OWN, raise_scales, Round, solver
from hnn_vi_ros.integrators.workspaces import NewtonWork, SolverWork
from hnn_vi_ros.kernels import called, factorise_rows, inlined, solve_factorised, solve_linear
import numpy as np

# Spacing of a central difference, relative to its argument.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
_EPS = float(np.finfo(np.float64).eps)
# A Jacobian is reused while each iteration reduces the residual by at least this factor: a new one
# for N unknowns costs N evaluations, and is worth it for a sixteenth of the digits.
_REUSE_RATIO = 0.1


@solver(rescales=False, gives_up=False)
def newton(tangent: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
           value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """
    Iterate (I - G'(y)) step = G(x) - x, with the matrix built column by column; see the module.

    y is an earlier iterate, at first the initial guess: the factorised matrix is reused as long as
    the residual decreases fast. Nothing is kept from step to step.

    Since x_j is rounded to eps abs(x_j), G_i is known only to eps sum_j abs(G'_ij x_j). The scale
    of an unknown is that sum if it is larger, as for the momentum of an angle after many
    revolutions. All unknowns of a kind share the largest of their scales, because terms that do
    not cancel in H may cancel in the sum.
    """
    n, iterates, own, spent = x.size, work.iterates, work.newton, 0
    if own.matrix.shape[0] != n:
        return NO_CONVERGENCE, spent, 0
    # Residuals of the size of rounding contain no information about the matrix.
    if at.state == 0 or at.residual > max(max(8, n) * _EPS, _REUSE_RATIO * at.before):
        fill_matrix(tangent, problem, x, 1.0, own)
        raise_scales(iterates.scale, iterates.own_scale, own.known)
        spent = n
        if not factorise_rows(own.matrix, own.pivots):
            return NO_CONVERGENCE, spent, 0
    for i in range(n):
        own.direction[i] = value[i] - x[i]
    solve_factorised(own.matrix, own.pivots, own.direction)
    for i in range(n):
        x[i] += own.direction[i]
    return GO_ON, spent, 1


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


@cache
def by_differences(equation: Callable[..., None]) -> Callable[..., None]:
    """Return the tangent of an equation by central differences, for Newton's method only."""
    @inlined
    def tangent(problem: Any, x: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
        """Fill product with G'(x) v by a central difference, using the arrays ahead and behind."""
        size = 0.0
        for i in range(x.size):
            # The integral of a channel has no scale: nothing depends on it.
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
    return tangent


# Tolerance of the linear system of an iteration, relative to its right-hand side.
_LINEAR_TOLERANCE = 1e-3


@solver(rescales=False, gives_up=False)
def krylov(tangent: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
           value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """
    Iterate (I - G'(x)) step = G(x) - x, where each step is solved by GMRES; see the module.

    GMRES needs products G'(x) v and no matrix, and keeps a few vectors. If they do not suffice for
    a linear system, the next iteration continues from the best approximation. Scales are raised as
    in Newton's method with a Jacobian, but with abs(G'(x) x) instead of the sum of absolute
    values, which needs the matrix. Both agree if one unknown dominates.

    References
    ----------
    Y. Saad, M. Schultz, GMRES: a generalized minimal residual algorithm for solving nonsymmetric
    linear systems, SIAM J. Sci. Stat. Comput. 7 (1986). R. Dembo, S. Eisenstat, T. Steihaug,
    Inexact Newton methods, SIAM J. Numer. Anal. 19 (1982).

    """
    iterates, own, spent, used, goal = work.iterates, work.newton, 0, 0, 0.0
    n, columns, first = x.size, own.hessenberg.shape[1], at.number == 1
    v, product, weights = own.direction, own.product, own.weights
    if columns == 0:
        return NO_CONVERGENCE, spent, 0
    copy_array(x, v)
    for j in range(-1, columns):
        if j >= 0 or first:
            tangent(problem, x, v, product)
            spent += 1
        if j >= 0:
            left = _extend(own, product, j)
            used = j + 1
        else:
            if first:
                for i in range(n):
                    own.known[i] = abs(product[i])
                raise_scales(iterates.scale, iterates.own_scale, own.known)
            left = _begin(own, iterates.own_scale if at.stage == OWN else iterates.scale,
                          x, value)
            goal = _LINEAR_TOLERANCE * left
        # The negated form also ends the loop for NaN.
        if used == columns or not left > goal:
            break
        for i in range(n):
            v[i] = weights[i] * own.directions[used, i]
    _add_combination(own, used, value, x)
    return GO_ON, spent, 0


@inlined
def _begin(work: NewtonWork, scale: np.ndarray, x: np.ndarray, value: np.ndarray) -> float:
    """Set the weights of unknowns, set the first direction to G(x) - x, and return its length."""
    first, weights, length = work.directions[0], work.weights, 0.0
    for i in range(x.size):
        weights[i] = scale[i]
        if scale[i] == 0.0:
            # A state and slope of zero contain no information about the size of the solution.
            weights[i] = max(abs(x[i]), abs(value[i]), 1.0)
        elif math.isinf(scale[i]):
            # Unknowns that nothing depends on are not part of the system.
            weights[i] = 0.0
        first[i] = (value[i] - x[i]) / weights[i] if weights[i] > 0.0 else 0.0
        length += first[i] * first[i]
    length = math.sqrt(length)
    for i in range(x.size):
        first[i] = first[i] / length if length > 0.0 else 0.0
    work.rotations[2, 0] = length
    return length


@inlined
def _extend(work: NewtonWork, product: np.ndarray, j: int) -> float:
    """
    Add (I - G') times direction j to the space, orthogonalised; return the residual of the system.

    Rotations keep the small matrix triangular; the last one gives the residual.
    """
    weights, column = work.weights, work.hessenberg[:, j]
    n = weights.size
    cosine, sine, right = work.rotations[0], work.rotations[1], work.rotations[2]
    new, length = work.directions[j + 1], 0.0
    for i in range(n):
        new[i] = work.directions[j, i]
        if weights[i] > 0.0:
            new[i] -= product[i] / weights[i]
    for a in range(j + 1):
        other, dot = work.directions[a], 0.0
        for i in range(n):
            dot += other[i] * new[i]
        column[a] = dot
        for i in range(n):
            new[i] -= dot * other[i]
    for i in range(n):
        length += new[i] * new[i]
    length = math.sqrt(length)
    for i in range(n):
        new[i] = new[i] / length if length > 0.0 else 0.0
    for a in range(j):
        above = column[a]
        column[a] = cosine[a] * above + sine[a] * column[a + 1]
        column[a + 1] = cosine[a] * column[a + 1] - sine[a] * above
    size = math.hypot(column[j], length)
    if size == 0.0:
        # (I - G') maps this direction to zero, so it is discarded.
        cosine[j], sine[j], column[j] = 1.0, 0.0, math.inf
    else:
        cosine[j], sine[j], column[j] = column[j] / size, length / size, size
    right[j + 1] = -sine[j] * right[j]
    right[j] *= cosine[j]
    return abs(right[j + 1])


@inlined
def _add_combination(work: NewtonWork, used: int, value: np.ndarray, x: np.ndarray) -> None:
    """Add the combination of the directions that minimises the residual of the linear system."""
    right, weights = work.rotations[2], work.weights
    for j in range(used - 1, -1, -1):
        for a in range(j + 1, used):
            right[j] -= work.hessenberg[j, a] * right[a]
        right[j] /= work.hessenberg[j, j]
        for i in range(x.size):
            x[i] += weights[i] * right[j] * work.directions[j, i]
    for i in range(x.size):
        if weights[i] == 0.0:
            x[i] = value[i]


# First and shortest step, as fractions of the way from h = 0; maximum of points and Newton steps.
_FIRST_LENGTH, _SHORTEST_LENGTH, _MAX_POINTS, _MAX_CORRECTIONS = 0.25, 2.0**-16, 100, 8
# Each Newton step must be shorter than the previous one by this factor. The iteration has
# converged at this length relative to the scale, since the next step doubles the digits.
_MAX_CONTRACTION, _CONVERGED_LENGTH = 0.25, float(np.sqrt(np.finfo(np.float64).eps))


@inlined
def continuation(equation: Callable, tangent: Callable, problem: Any, x: np.ndarray,
                 work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Follow the solution from h = 0 to this h, then apply Newton's method; see solvers.

    x(s) = b + s (G(x(s)) - b) for s from 0 to 1, where b = problem.base solves the equation with
    h = 0. Points are so close that Newton's method contracts from each to the next and the
    determinant of I - s G' stays positive, so it cannot jump to another solution. The path ends
    with NO_SOLUTION at a fold, where that determinant passes through 0.

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
    for _ in range(_MAX_POINTS):
        if at == 1.0:
            break
        share = min(1.0, at + length)
        copy_array(last, x)
        left, more = _correct(equation, tangent, problem, x, share, work)
        spent += more
        if left <= _CONVERGED_LENGTH:
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
    """Move x to b + share (G(x) - b); return the last step over the scale, and the evaluations."""
    n, iterates, own = x.size, work.iterates, work.newton
    value, step, scale = iterates.values[0], own.direction, iterates.scale
    size, spent = math.inf, 0
    for k in range(_MAX_CORRECTIONS):
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
        if size <= _CONVERGED_LENGTH:
            return size, spent
        if k > 0 and not size <= _MAX_CONTRACTION * before:
            break
    return 1.0 if math.isfinite(size) else size, spent
