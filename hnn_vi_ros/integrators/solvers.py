# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Solvers of the implicit equation x = G(x) of a step; each converges to round-off.

Each method defines its equation by two functions: ``equation(problem, x, value)`` fills G(x), and
``tangent(problem, x, v, product)`` fills G'(x) v; ``problem`` contains their data.

All solvers are one loop, each with its own choice of the next iterate; see ``solver``. They have
the signature ``(equation, tangent, problem, x, work, max_iterations)``. On entry x is the initial
guess, on return the solution; ``work.iterates`` contains the scales. They return the outcome, the
largest relative residual [1] and the number of evaluations of G and G' v.

An iterate is accepted when the residual G(x) - x, relative to the largest unknown of its kind, is
at most eps, or no longer decreases at no more than max(8, N) eps. A much smaller unknown may then
still have few correct digits: iteration continues while the residual relative to each unknown's
own scale is above max(8, N) eps and at least halves. It need not reach that if terms of large
unknowns cancel. If iterations stall because terms of G cancel, as the forces on a machine at rest,
the scales are raised to these terms. The last evaluation of G is at the returned x, so that the
values that it left in ``problem`` belong to x.
"""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE, NOT_FINITE, OK
from hnn_vi_ros.integrators.workspaces import (
    AndersonWork, DEPTH, FAST_MATRIX, History, Iterates, SolverWork)
from hnn_vi_ros.kernels import called, inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Iterations of the secant method that suffice for resolved steps. Of 6155 steps of two methods for
# H = q sin(5 p), one converged to another solution without being detected.
QUICK = 5
# Residuals that are larger than rounding errors.
_NOISE = 1e-11
# Relative change of the variables that shows the size of the terms of G.
_STRETCH = 2.0**-20
GO_ON = -1
# Stages of a solver: the residual is relative to the scale of the largest unknown (COMMON), then
# to that of each (OWN); or the solver returns to an accepted iterate (BACK).
COMMON, OWN, BACK = 0, 1, 2


class SolverOptions(NamedTuple):
    """
    Options of the solution of an implicit equation.

    Parameters
    ----------
    solve : callable
        One of the solvers of this module.
    extrapolate : bool
        True to extrapolate the initial guess from earlier solutions.
    max_iterations : int
        Maximum number of iterations.
    connected : bool
        True to treat a solution that takes many iterations as in doubt: it may not be the one that
        is connected to h = 0.

    """

    solve: Callable
    extrapolate: bool
    max_iterations: int
    connected: bool = False


# Returns the outcome, the largest relative residual, and the number of evaluations.
_Solver = Callable[..., tuple[int, float, int]]
# Changes x to the next iterate; see solver.
_Choice = Callable[..., tuple[int, int, int]]


class Round(NamedTuple):
    """
    A round of a solver, for the choice of its next iterate.

    Parameters
    ----------
    number : int
        Number of the round, from 1.
    origin : int
        The first round whose residual has the present scales.
    stage : int
        COMMON or OWN.
    residual, before : float
        The residual, and that of the round before.
    state : int
        What the choice in the round before returned; 0 at first.

    """

    number: int
    origin: int
    stage: int
    residual: float
    before: float
    state: int


def solver(shared: bool = True, rescales: bool = True, gives_up: bool = True,
           foresees: bool = False, cost: int = 0, rows: int = 1
           ) -> Callable[[_Choice], _Solver]:
    """
    Return a decorator that makes a solver of a function that chooses its next iterate.

    The function is ``choose(tangent, problem, x, work, value, defect, at)`` with a ``Round``. It
    changes x, and returns GO_ON or the outcome, the number of evaluations, and a state.

    Parameters
    ----------
    shared : bool, optional
        False to make residuals relative to each unknown from the beginning.
    rescales : bool, optional
        True to raise the scales where iterations stall.
    gives_up : bool, optional
        True to end where convergence is slow.
    foresees : bool, optional
        True to take a residual for rounding if the last convergence rate predicts less than eps.
    cost : int, optional
        Number of evaluations in addition to one each round.
    rows : int, optional
        Number of the last evaluations that are kept.

    """
    def made(choose: _Choice) -> _Solver:
        inlined(choose)

        # Whether products with G' are needed is told by a choice that uses the name `tangent`, not
        # by this loop, which only passes them on; see provide_for.
        @inlined
        def solve(equation: Callable, derivative: Callable, problem: NamedTuple, x: np.ndarray,
                  work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
            iterates = work.iterates
            common = iterates.scale if shared else iterates.own_scale
            sizes = common, iterates.own_scale, iterates.accepted
            before, previous, residual = math.inf, math.inf, math.inf
            stage, old_stage, origin, known, more, state = COMMON, COMMON, 1, 0, cost, 0
            for k in range(1, max_iterations + 1):
                value, defect = iterates.values[k % rows], iterates.residuals[k % rows]
                settled = foresees and stage == COMMON and before < math.inf \
                    and previous * previous <= _EPS * before
                outcome, residual, stage = assess(
                    equation, problem, x, sizes, value, defect, 0.0 if settled else previous,
                    stage, k == max_iterations)
                if outcome != GO_ON:
                    return outcome, residual, k + more
                if rescales and stalls(k, known, stage, residual, previous):
                    old = residual
                    residual, known, more = rescaled(
                        equation, problem, x, work, common, value, defect), known + 1, more + 1
                    origin = k if residual != old else origin
                if gives_up and stage == COMMON and converges_too_slowly(k, residual, previous):
                    return NO_CONVERGENCE, residual, k + more
                if k <= 2:
                    iterates.first[k - 1] = residual
                before, previous = previous, residual
                if shared and stage != old_stage:
                    origin, old_stage = k, stage
                if k == max_iterations:
                    break
                if stage == BACK:
                    copy_array(value, x)
                    continue
                outcome, spent, state = choose(
                    derivative, problem, x, work, value, defect, Round(
                        k, origin, stage, residual, before, state))
                more += spent
                if outcome != GO_ON:
                    return outcome, residual, k + more
            return NO_CONVERGENCE, residual, max_iterations + more

        # Compiled code is named and cached by these.
        solve.__module__, solve.__name__ = choose.__module__, choose.__name__
        solve.__doc__ = choose.__doc__
        return solve
    return made


@solver(gives_up=False)
def fixed_point(tangent: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
                value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """Iterate x = G(x), as the paper does; see the module."""
    copy_array(value, x)
    return GO_ON, 0, 0


# The rounding of one unknown does not enter the equation of another.
@solver(shared=False)
def secant(tangent: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
           value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """Solve for unknowns that do not depend on each other by the secant method; see the module."""
    old_value, old_defect = work.iterates.values[1], work.iterates.residuals[1]
    for i in range(x.size):
        x[i] = value[i]
        change = defect[i] - old_defect[i]
        if at.number > at.origin and change != 0.0:
            x[i] -= defect[i] / change * (value[i] - old_value[i])
        old_value[i], old_defect[i] = value[i], defect[i]
    return GO_ON, 0, 0


@solver(rows=DEPTH + 1)
def anderson(tangent: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
             value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """
    Accelerate the fixed-point iteration by Anderson's method of depth 3; see the module.

    Independent systems that are solved together, see ``layout``, each have their own weights.

    References
    ----------
    H. Walker, P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49
    (2011).

    """
    _accelerate(work, at.number, value, defect, at.number - at.origin, x)
    return GO_ON, 0, 0


@inlined
def may_be_disconnected(options: SolverOptions, first: np.ndarray, matrix: np.ndarray,
                        iterations: int, d: int) -> bool:
    """
    Return True if a solution of d coupled unknowns may not be the one connected to h = 0.

    Between two solutions G' has an eigenvalue of 1 somewhere. To pass over that point, or close to
    it, takes more iterations than solutions that follow each other smoothly, or the first
    iteration does not halve the residual.
    """
    # Conditions on scalars come first, since reading arrays costs more.
    if not options.connected or iterations < 3 or first[0] <= _NOISE:
        return False
    if iterations <= QUICK + min(d - 1, DEPTH) and not first[1] > 0.5 * first[0]:
        return False
    return 0 < matrix.shape[0] <= FAST_MATRIX


@inlined
def extrapolate(history: History, base: np.ndarray, x: np.ndarray) -> None:
    """Extrapolate x from up to three earlier solutions, relative to their bases."""
    count, increments = history.count[0], history.increments
    for i in range(x.size):
        if count == 1:
            x[i] = base[i] + increments[0, i]
        elif count == 2:
            x[i] = base[i] + (2.0 * increments[0, i] - increments[1, i])
        elif count == 3:
            x[i] = base[i] + (3.0 * (increments[0, i] - increments[1, i]) + increments[2, i])


@inlined
def store_solution(history: History, base: np.ndarray, x: np.ndarray) -> None:
    """Store a solution relative to its base, for the next initial guess."""
    increments = history.increments
    for i in range(x.size):
        increments[2, i] = increments[1, i]
        increments[1, i] = increments[0, i]
        increments[0, i] = x[i] - base[i]
    history.count[0] = min(history.count[0] + 1, 3)


@inlined
def _residual(value: np.ndarray, x: np.ndarray, scale: np.ndarray, defect: np.ndarray) -> float:
    """Fill the defect (G(x) - x) / scale; return its largest absolute entry, or NaN."""
    result = 0.0
    for i in range(x.size):
        difference = value[i] - x[i]
        if difference == 0.0:
            defect[i] = difference
        elif scale[i] > 0.0:
            defect[i] = difference / scale[i]
        else:
            # A state and slope of zero contain no information about the size of the solution, and
            # neither does a diverged iterate, where NaN may meet zero.
            size = max(abs(value[i]), abs(x[i]))
            defect[i] = difference / size if size > 0.0 else difference
        if not abs(defect[i]) <= result:
            result = abs(defect[i])
    return result


@inlined
def assess(equation: Callable, problem: NamedTuple, x: np.ndarray,
           sizes: tuple[np.ndarray, np.ndarray, np.ndarray], value: np.ndarray,
           defect: np.ndarray, previous: float, stage: int, is_last: bool
           ) -> tuple[int, float, int]:
    """Evaluate G at x; return the next action: accept x, fail as not finite, or iterate."""
    scale, own_scale, accepted = sizes
    equation(problem, x, value)
    residual, bound = _residual(value, x, scale, defect), max(8, x.size) * _EPS
    if not math.isfinite(residual):
        return NOT_FINITE, residual, stage
    if stage == OWN and residual > bound and not is_last:
        # An increase after an accepted iterate is due to rounding: return to that iterate.
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
def stalls(k: int, known: int, stage: int, residual: float, previous: float) -> bool:
    """Return True if iteration k does not halve the residual; after some known stalls, later."""
    return stage == COMMON and k > 2 << known and residual > 0.5 * previous


@called
def rescaled(equation: Callable, problem: NamedTuple, x: np.ndarray, work: SolverWork,
             scale: np.ndarray, value: np.ndarray, defect: np.ndarray) -> float:
    """
    Raise the scales to the terms of G if the residual is rounding of these; return it.

    The terms are measured by stretching all variables, including those held in the equation.
    """
    iterates, own, at_rounding = work.iterates, work.newton, True
    known, held = own.known, iterates.held
    for i in range(x.size):
        own.solved[i], own.product[i] = x[i], held[i]
        x[i], held[i] = x[i] * (1.0 + _STRETCH), held[i] * (1.0 + _STRETCH)
    equation(problem, x, known)
    for i in range(x.size):
        x[i], held[i] = own.solved[i], own.product[i]
        known[i] = abs(known[i] - value[i]) / _STRETCH
        if not abs(value[i] - x[i]) <= _NOISE * max(scale[i], known[i]):
            at_rounding = False
    if at_rounding:
        before = _residual(value, x, scale, defect)
        raise_scales(iterates.scale, iterates.own_scale, known)
        after = _residual(value, x, scale, defect)
        iterates.first[0] *= after / before
        iterates.first[1] *= after / before
        return after
    return _residual(value, x, scale, defect)


@inlined
def raise_scales(scale: np.ndarray, own_scale: np.ndarray, known: np.ndarray) -> None:
    """Raise each own scale to the accuracy of the equation, and shared scales to the largest."""
    for i in range(scale.size):
        own_scale[i] = max(own_scale[i], known[i])
    first = 0
    for i in range(1, scale.size + 1):
        # Unknowns of one kind and trajectory are adjacent, and share a scale.
        if i == scale.size or scale[i] != scale[first]:
            size = scale[first]
            for j in range(first, i):
                size = max(size, own_scale[j])
            for j in range(first, i):
                scale[j] = size
            first = i


@inlined
def converges_too_slowly(k: int, residual: float, previous: float) -> bool:
    """Return True if convergence is so slow that Newton's method will be cheaper."""
    return k > 5 and residual > 0.5 * previous and residual > 1e-8


@inlined
def _accelerate(work: SolverWork, k: int, value: np.ndarray, defect: np.ndarray, rounds: int,
                x: np.ndarray) -> None:
    """Set x to the next iterate, for each system separately, with a maximum of ``rounds``."""
    row, width = work.iterates.layout[0], work.iterates.layout[1]
    end = work.iterates.layout[2]
    n = x.size // row * width
    for i in range(x.size):
        x[i] = value[i]
    for first in range(0, end, width):
        depth = min(rounds, n, DEPTH)
        if n < x.size and _largest(defect, first, row, width) <= max(8, n) * _EPS:
            # This system has converged while others have not; its residual is rounding.
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
    """Project a system's defect on the orthogonalised changes of it, and return their number."""
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
    """Set a system's x to G minus the combination of its changes found by the projection."""
    row, width, triangle = iterates.layout[0], iterates.layout[1], work.triangle
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
