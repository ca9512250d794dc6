# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Solvers of the implicit equation x = G(x) of a step, each carried to round-off.

Each method states its equation as two functions: ``equation(problem, x, value)`` fills G(x), and
``tangent(problem, x, v, product)`` fills G'(x) v; ``problem`` holds whatever they need.

Every solver has the signature ``(equation, tangent, problem, x, work, max_iterations)``. On entry
x is a first guess, on return the solution; the scales of ``work.iterates`` are read. It returns an
outcome, the largest relative residual [1] and the number of evaluations of G and of G' v.

Iterates are accepted when the residual G(x) - x, relative to the largest unknown of its kind, is
at most eps, or has stopped shrinking at no more than max(8, N) eps. An unknown that is much
smaller may then still be wrong in most of its digits: iterates go on while the residual, relative
to each unknown's own scale, is above max(8, N) eps and at least halves. It need not get there, as
where the terms of large unknowns cancel. G was then evaluated last at the very x that is
returned, so that what it left in ``problem`` belongs to x.
"""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE, NOT_FINITE, OK
from hnn_vi_ros.integrators.workspaces import (
    AndersonWork, DEPTH, FAST_MATRIX, History, Iterates, SolverWork)
from hnn_vi_ros.kernels import inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Iterations of the secant method, as many as steps take that are resolved. Of the 6155 steps of
# two methods that H = q sin(5 p) was tried with, one took another solution without a sign.
QUICK = 5
# Residuals that are not rounding alone.
_NOISE = 1e-11
GO_ON = -1
# A residual is relative first to the scale of the largest unknown, then to each one's own; or the
# solver goes back to an iterate that was good enough.
COMMON, OWN, BACK = 0, 1, 2


class SolverOptions(NamedTuple):
    """
    Options by which an implicit equation is solved.

    Parameters
    ----------
    solve : callable
        One of the solvers of this module.
    extrapolate : bool
        Whether to start from earlier solutions.
    max_iterations : int
        Iterations after which the equation counts as not solved.
    connected : bool
        Whether a solution that takes many iterations is in doubt: it may be another one than that
        which is connected to h = 0.

    """

    solve: Callable
    extrapolate: bool
    max_iterations: int
    connected: bool = False


@inlined
def fixed_point(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
                work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """Iterate x = G(x), as the paper does; see the module."""
    iterates = work.iterates
    sizes = iterates.scale, iterates.own_scale, iterates.accepted
    previous, residual, stage = math.inf, math.inf, COMMON
    value, defect = iterates.values[0], iterates.residuals[0]
    for k in range(1, max_iterations + 1):
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        if outcome != GO_ON:
            return outcome, residual, k
        previous = residual
        if k < max_iterations:
            copy_array(value, x)
    return NO_CONVERGENCE, residual, max_iterations


@inlined
def secant(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """Solve unknowns that do not depend on each other by the secant method; see the module."""
    # No rounding of one enters the equation of another.
    iterates = work.iterates
    sizes = iterates.own_scale, iterates.own_scale, iterates.accepted
    previous, residual, stage = math.inf, math.inf, COMMON
    value, defect = iterates.values[0], iterates.residuals[0]
    old_value, old_defect = iterates.values[1], iterates.residuals[1]
    for k in range(1, max_iterations + 1):
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        if outcome != GO_ON:
            return outcome, residual, k
        if stage == COMMON and is_hopeless(k, residual, previous):
            return NO_CONVERGENCE, residual, k
        if k == 2:
            iterates.slow_start[0] = residual > 0.5 * previous > _NOISE
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
             work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Accelerate the fixed-point iteration by Anderson's method of depth 3; see the module.

    Systems that are solved together, as the work's layout says, each have weights of their own.

    References
    ----------
    H. Walker, P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49
    (2011).

    """
    iterates = work.iterates
    sizes = iterates.scale, iterates.own_scale, iterates.accepted
    previous, residual, stage = math.inf, math.inf, COMMON
    rows, origin, old_stage = DEPTH + 1, 1, COMMON
    for k in range(1, max_iterations + 1):
        value, defect = iterates.values[k % rows], iterates.residuals[k % rows]
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        if outcome != GO_ON:
            return outcome, residual, k
        if stage == COMMON and is_hopeless(k, residual, previous):
            return NO_CONVERGENCE, residual, k
        if k == 2:
            iterates.slow_start[0] = residual > 0.5 * previous > _NOISE
        previous = residual
        if stage != old_stage:
            # Residuals relative to something else are not to be combined with these.
            origin, old_stage = k, stage
        if k < max_iterations:
            _accelerate(work, k, value, defect, k - origin, x)
    return NO_CONVERGENCE, residual, max_iterations


@inlined
def is_in_doubt(options: SolverOptions, slow_start: np.ndarray, matrix: np.ndarray,
                iterations: int, d: int) -> bool:
    """
    Return whether a solution of d coupled unknowns may not be the one that is connected to h = 0.

    Two solutions are apart by a place where G' has an eigenvalue of 1: to come over it, or close
    to it, takes iterations, more than where solutions follow each other smoothly, or the first
    does not contract by half.
    """
    # In this order: what is read from arrays costs more.
    if not options.connected or iterations < 3:
        return False
    if iterations <= QUICK + min(d - 1, DEPTH) and slow_start[0] == 0:
        return False
    return 0 < matrix.shape[0] <= FAST_MATRIX


@inlined
def extrapolate(history: History, base: np.ndarray, x: np.ndarray) -> None:
    """Start x from up to three earlier solutions, relative to their bases, if there are any."""
    count, increments = history.count[0], history.increments
    for i in range(x.size):
        if count == 1:
            x[i] = base[i] + increments[0, i]
        elif count == 2:
            x[i] = base[i] + (2.0 * increments[0, i] - increments[1, i])
        elif count == 3:
            x[i] = base[i] + (3.0 * (increments[0, i] - increments[1, i]) + increments[2, i])


@inlined
def remember(history: History, base: np.ndarray, x: np.ndarray) -> None:
    """Keep a solution relative to its base, for the next start."""
    increments = history.increments
    for i in range(x.size):
        increments[2, i] = increments[1, i]
        increments[1, i] = increments[0, i]
        increments[0, i] = x[i] - base[i]
    history.count[0] = min(history.count[0] + 1, 3)


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
            # A state and slope of zero say nothing about the size of the solution; nor does a lost
            # iterate, where NaN may meet zero.
            size = max(abs(value[i]), abs(x[i]))
            defect[i] = difference / size if size > 0.0 else difference
        if not abs(defect[i]) <= result:
            result = abs(defect[i])
    return result


@inlined
def judge(equation: Callable, problem: NamedTuple, x: np.ndarray,
          sizes: tuple[np.ndarray, np.ndarray, np.ndarray], value: np.ndarray,
          defect: np.ndarray, previous: float, stage: int, is_last: bool
          ) -> tuple[int, float, int]:
    """Evaluate G at x; judge whether x is good enough, not finite, or to be improved, and how."""
    scale, own_scale, accepted = sizes
    equation(problem, x, value)
    residual, bound = _residual(value, x, scale, defect), max(8, x.size) * _EPS
    if not math.isfinite(residual):
        return NOT_FINITE, residual, stage
    if stage == OWN and residual > bound and not is_last:
        # What has led away from an iterate that was good enough is rounding: back to it.
        for i in range(x.size):
            value[i], defect[i] = accepted[i], 0.0
        return GO_ON, residual, BACK
    if stage == BACK:
        return OK, residual, stage
    if stage == COMMON and not (residual <= _EPS or (
            residual <= bound and (residual >= previous or is_last))):
        return GO_ON, residual, stage
    own = _residual(value, x, own_scale, defect)
    if own <= bound or is_last or (stage == OWN and own > 0.5 * previous):
        return OK, residual, stage
    for i in range(x.size):
        accepted[i] = x[i]
    return GO_ON, own, OWN


@inlined
def is_hopeless(k: int, residual: float, previous: float) -> bool:
    """Return whether there is no contraction to speak of: Newton's method will be cheaper."""
    return k > 5 and residual > 0.5 * previous and residual > 1e-8


@inlined
def _accelerate(work: SolverWork, k: int, value: np.ndarray, defect: np.ndarray, rounds: int,
                x: np.ndarray) -> None:
    """Set x to the next iterate, each system by itself, of so many rounds at most."""
    row, width = work.iterates.layout[0], work.iterates.layout[1]
    n = x.size // row * width
    for first in range(0, row, width):
        depth = min(rounds, n, DEPTH)
        if n < x.size and _largest(defect, first, row, width) <= max(8, n) * _EPS:
            # Solved, which others are not: what is left is rounding, and no direction.
            depth = 0
        used = _project(work.anderson, work.iterates, k, defect, first, depth)
        _combine(work.anderson, work.iterates, k, value, first, used, x)


@inlined
def _largest(defect: np.ndarray, first: int, row: int, width: int) -> float:
    """Return the largest entry of a system."""
    result = 0.0
    for start in range(first, defect.size, row):
        for i in range(start, start + width):
            result = max(result, abs(defect[i]))
    return result


@inlined
def _project(work: AndersonWork, iterates: Iterates, k: int, defect: np.ndarray, first: int,
             depth: int) -> int:
    """Orthogonalise the changes of a system's defect, and project it on them; return how many."""
    row, width, rows = iterates.layout[0], iterates.layout[1], DEPTH + 1
    n, basis, triangle = defect.size // row * width, work.basis, work.triangle
    for j in range(depth):
        earlier = iterates.residuals[(k - 1 - j) % rows]
        size, at = 0.0, 0
        for start in range(first, defect.size, row):
            for i in range(start, start + width):
                basis[j, at] = defect[i] - earlier[i]
                size += basis[j, at] * basis[j, at]
                at += 1
        for m in range(j):
            dot = 0.0
            for i in range(n):
                dot += basis[m, i] * basis[j, i]
            triangle[m, j] = dot
            for i in range(n):
                basis[j, i] -= dot * basis[m, i]
        left, projection, at = 0.0, 0.0, 0
        for i in range(n):
            left += basis[j, i] * basis[j, i]
        if left <= 1e-20 * size:
            return j
        left = math.sqrt(left)
        for start in range(first, defect.size, row):
            for i in range(start, start + width):
                basis[j, at] /= left
                projection += basis[j, at] * defect[i]
                at += 1
        triangle[j, j], triangle[j, DEPTH] = left, projection
    return depth


@inlined
def _combine(work: AndersonWork, iterates: Iterates, k: int, value: np.ndarray, first: int,
             used: int, x: np.ndarray) -> None:
    """Set a system's x to G less the combination of its changes that ends the projection."""
    row, width, triangle = iterates.layout[0], iterates.layout[1], work.triangle
    for start in range(first, x.size, row):
        for i in range(start, start + width):
            x[i] = value[i]
    for j in range(used - 1, -1, -1):
        weight = triangle[j, DEPTH]
        for m in range(j + 1, used):
            weight -= triangle[j, m] * triangle[m, DEPTH]
        weight /= triangle[j, j]
        triangle[j, DEPTH] = weight
        earlier = iterates.values[(k - 1 - j) % (DEPTH + 1)]
        for start in range(first, x.size, row):
            for i in range(start, start + width):
                x[i] -= weight * (value[i] - earlier[i])
