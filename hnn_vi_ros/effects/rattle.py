# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
RATTLE: impulses around a step that keep a system on its holonomic constraints g(q) = 0.

Constraints are distances, planes and user-defined functions, or the loops of a robot.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import StepLayer
from hnn_vi_ros.effects.points import add_along, distance, separation
from hnn_vi_ros.hamiltonians import fill_loops, Loops
from hnn_vi_ros.integrators import (
    copy_array, copy_point, discard_history, Integrator, largest, NOT_HELD, OK, PhasePoint, plus,
    REDUNDANT, Step)
from hnn_vi_ros.kernels import (
    called, DEPENDENT, inlined, is_own, Kernel, Parameters, solve_in_order)
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
_MAX_ITERATIONS = 50
# Rounding error of a step's coordinates and of a distance, in units of eps times their size. The
# iteration stops there if an error no longer decreases; smaller errors cannot be resolved.
_ROUNDINGS = 64
# The variational equation only serves as the Jacobian of Newton's method, so that an error of
# _VARIATION_TOLERANCE costs less than more of its own iterations; it is solved again if an error
# decreases by less than the factor _SLOW_RATIO.
_MAX_VARIATIONS, _VARIATION_TOLERANCE, _SLOW_RATIO = 12, 3e-3, 0.5


class ConstraintEquation(NamedTuple):
    """
    One equation g(q) = 0 between n coordinates.

    Parameters
    ----------
    first, second, anchor : np.ndarray, shape (n,)
        Two points, or a point and a fixed position; see points.resolve_pair.
    length : float
        The required distance [m], 0 for a plane.
    normal : np.ndarray, shape (n,)
        The unit normal of a plane, zero for a distance.
    function : callable or None
        The user's ``function(q, gradient)``, which replaces the rest; see HolonomicConstraint.

    """

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    length: float
    normal: np.ndarray
    function: Callable[..., float] | None = None


class Constraints(NamedTuple):
    """
    K constraints, and workspace to solve for their impulses.

    Distances and planes come first, user-defined functions last.

    Parameters
    ----------
    first, second, anchor, normal : np.ndarray, shape (L, n)
        See ConstraintEquation; for the L distances and planes.
    sizes, planes : np.ndarray, shape (L,)
        Number of coordinates of each, and True if it is a plane.
    lengths : np.ndarray, shape (L,)
        The required distances [m].
    loops : LoopRows or ()
        The equations of loops.
    dropped : np.ndarray of bool, shape (K,)
        True for equations of loops that depend on others; they have no impulse.
    sine : np.ndarray, shape (3,)
        Smallest distance of a gradient from the span of the earlier ones, over the largest one,
        at the start of the last step; its largest relative change in a step; and the time at the
        end of that step [s].
    extent : np.ndarray, shape (1,)
        Scale of the rounding errors of lengths.
    old, new, response : np.ndarray, shape (K, D)
        The gradient G of g at the start and at the end, and the change of q by impulses G^T.
    variation : np.ndarray, shape (4, D)
        A variation of q and p, and its image under the Hessian of H.
    matrix : np.ndarray, shape (K, K)
        The linear system.
    right, defect, scale, impulse : np.ndarray, shape (K,)
        The right-hand side of the system, g(q), the diagonal of the matrix, and the impulse at
        the end of the step.
    pending : np.ndarray
        EffectState.pending before the step.
    dependent : np.ndarray, shape (1,)
        The constraint that was last found to depend on earlier ones.
    middle : np.ndarray, shape (2, D)
        q and p at the middle of the step.

    """

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    normal: np.ndarray
    sizes: np.ndarray
    planes: np.ndarray
    lengths: np.ndarray
    loops: Any
    dropped: np.ndarray
    sine: np.ndarray
    extent: np.ndarray
    old: np.ndarray
    new: np.ndarray
    response: np.ndarray
    variation: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    defect: np.ndarray
    scale: np.ndarray
    impulse: np.ndarray
    pending: np.ndarray
    dependent: np.ndarray
    middle: np.ndarray

    @classmethod
    def of(cls, listed: Sequence[ConstraintEquation], loops: Loops | None, dimension: int,
           effects: int) -> 'Constraints':
        """Return constraints, functions last, or loops, with workspace for D coordinates."""
        known = [part for part in listed if part.function is None]
        count = len(listed) if loops is None else len(loops.names)
        n = max((part.first.size for part in known), default=0)
        first, second = np.full((2, len(known), n), -1)
        anchor, normal = np.zeros((2, len(known), n))
        for k, part in enumerate(known):
            for target, values in zip((first, second, anchor, normal), (
                    part.first, part.second, part.anchor, part.normal), strict=True):
                target[k, :values.size] = values
        old, new, response = np.zeros((3, count, dimension))
        right, defect, scale, impulse = np.zeros((4, count))
        sizes = np.array([part.first.size for part in known], int)
        lengths = np.array([part.length for part in known], float)
        extent = lengths.max(initial=0.0 if loops is None else loops.reach)
        return cls(first, second, anchor, normal, sizes, np.asarray(normal.any(axis=1)), lengths,
                   () if loops is None else loops.rows, np.zeros(count, bool), np.zeros(3),
                   np.array([extent]),
                   old, new, response, np.zeros((4, dimension)),
                   np.zeros((count, count)), right, defect, scale, impulse,
                   np.zeros(effects), np.zeros(1, dtype=np.int64), np.zeros((2, dimension)))


@cache
def evaluator(functions: tuple[Callable[..., float], ...], looped: bool = False
              ) -> Callable[..., float]:
    """
    Return a function that evaluates distances, planes and these functions, or loops.

    ``evaluate(constraints, q, gradient)`` fills ``constraints.defect`` with g and the last
    argument, of shape (K, D), with its gradient, and returns the largest distance of q from
    g = 0 [m], or NaN.
    """
    fill_others = fill_loops if looped else _chain(functions)

    @called
    def evaluate(constraints: Constraints, q: np.ndarray, gradient: np.ndarray) -> float:
        gradient[:] = 0.0
        count = constraints.lengths.size
        for k in range(count):
            n = constraints.sizes[k]
            first, second = constraints.first[k, :n], constraints.second[k, :n]
            anchor = constraints.anchor[k, :n]
            if constraints.planes[k]:
                constraints.defect[k] = 0.0
                for j in range(n):
                    gradient[k, first[j]] = constraints.normal[k, j]
                    constraints.defect[k] += constraints.normal[k, j] * separation(
                        first, second, anchor, q, j)
            else:
                r = distance(first, second, anchor, q)
                constraints.defect[k] = r - constraints.lengths[k]
                for j in range(n):
                    along = separation(first, second, anchor, q, j)
                    add_along(first, second, j, along / r if r != 0.0 else 0.0, gradient[k])
        fill_others(constraints.loops, q, count, constraints.defect, gradient)
        worst = 0.0
        for k in range(constraints.defect.size):
            if constraints.dropped[k]:
                constraints.defect[k] = 0.0
                gradient[k, :] = 0.0
                continue
            slope = 0.0
            for i in range(q.size):
                slope = max(slope, abs(gradient[k, i]))
            away = abs(constraints.defect[k]) / slope if slope > 0.0 else np.nan
            # Not max(worst, away), which would drop a NaN.
            worst = worst if worst >= away or worst != worst else away
        return worst
    return evaluate


_jitable = cache(inlined)


@cache
def _chain(functions: tuple[Callable[..., float], ...]) -> Callable[..., None]:
    """Return a function that evaluates the user's functions in sequence."""
    if not functions:
        return _evaluate_none
    function, rest = _jitable(functions[0]), _chain(functions[1:])

    @inlined
    def fill(loops: Any, q: np.ndarray, k: int, defect: np.ndarray, gradient: np.ndarray) -> None:
        defect[k] = function(q, gradient[k])
        rest(loops, q, k + 1, defect, gradient)
    return fill


@inlined
def _evaluate_none(*_: Any) -> None:
    """End the chain of functions."""


class Multipliers(NamedTuple):
    """
    Initial guess of the next step.

    Parameters
    ----------
    multipliers : np.ndarray, shape (m,)
        The multipliers of the m constraints at the start of the last step.

    """

    multipliers: np.ndarray


class LoopMultipliers(NamedTuple):
    """
    Initial guess of the next step, and the result of the last one.

    Parameters
    ----------
    multipliers : np.ndarray, shape (m,)
        See Multipliers.
    means : np.ndarray, shape (m,)
        Both impulses of the last step over its size.

    """

    multipliers: np.ndarray
    means: np.ndarray


class RattleWork(NamedTuple):
    """
    Workspace of a step between two impulses.

    Parameters
    ----------
    kept : Multipliers or LoopMultipliers
        The part that the next step reads, or that is published.
    start : Point
        The state after the first impulse.

    """

    kept: Multipliers | LoopMultipliers
    start: PhasePoint


class Rattle(StepLayer):
    """Layer of Wrapped that satisfies the constraints by RATTLE; see ``rattle``."""

    functions: tuple[Callable[..., float], ...] = ()
    looped = False
    repeats = True

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> RattleWork:
        """Return the workspace for n coordinates."""
        return RattleWork(Multipliers(np.zeros(settings[0].defect.size)), PhasePoint.empty(n))

    @classmethod
    def wrap(cls, step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two impulses of the constraints."""
        return rattle(step, cls.functions, cls.looped)


class RattleOfLoops(Rattle):
    """Layer of Wrapped that keeps loops closed."""

    looped = True

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> RattleWork:
        """Return the workspace for n coordinates."""
        return RattleWork(LoopMultipliers(*np.zeros((2, settings[0].defect.size))),
                          PhasePoint.empty(n))


def suits_rattle(integrator: Integrator) -> bool:
    """Return True if the method is symmetric, symplectic and of order 2, like RATTLE."""
    keeps = integrator.requirements
    return keeps.symmetric and keeps.symplectic and integrator.order == 2 and keeps.hamiltonian


@cache
def rattle_kind(functions: tuple[Callable[..., float], ...]) -> type[Rattle]:
    """Return the layer with the user's functions, whose compiled code is not cached on disk."""
    if not functions:
        return Rattle
    foreign = [function.__module__ for function in functions if not is_own(function.__module__)]
    return type('Rattle', (Rattle,), {
        'functions': functions, '__module__': str([*foreign, 'constraint'][0])})


@cache
def rattle(step: Step, functions: tuple[Callable[..., float], ...] = (), looped: bool = False
           ) -> Step:
    """
    Return a step that keeps g(q) = 0 and G(q) q' = 0, where G = g'.

        p+ = p_n - (h/2) G(q_n)^T lambda,  (q_(n+1), p-) = step(q_n, p+),  g(q_(n+1)) = 0
        p_(n+1) = p- - (h/2) G(q_(n+1))^T mu,  G(q_(n+1)) H_p(q_(n+1), p_(n+1)) = 0

    The step is symplectic on the constraint manifold and symmetric if the method's step is, and of
    order 2. lambda is computed by Newton's method. The derivative of q_(n+1) by an impulse solves
    the variational equation by the midpoint rule, with H_pp, H_qp and H_qq at the middle: h H_pp
    alone would be cheaper, but converges slowly if H is stiff. Of several solutions the one that
    vanishes with h is chosen; all leading minors of its Jacobian are positive.

    References
    ----------
    H. Andersen, RATTLE: a velocity version of the SHAKE algorithm, J. Comput. Phys. 52 (1983).
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """
    evaluate, keep_means = evaluator(functions, looped), _store_means if looped else _keep_nothing

    @inlined
    def constrained(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
                    memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, constraints, state, _ = options
        work, inside = memory[-1], memory[:-1]
        # The solution of the last step is the initial guess.
        start, multipliers = work.start, work.kept.multipliers
        evaluate(constraints, z.q, constraints.old)
        copy_array(state.pending, constraints.pending)
        size = largest(z.q) + constraints.extent[0]
        previous, residual, spent = np.inf, np.inf, 0
        for iteration in range(_MAX_ITERATIONS):
            copy_point(z, start)
            copy_array(constraints.pending, state.pending)
            _kick(constraints.old, multipliers, 0.5 * h, start)
            # Solutions for other impulses are bad initial guesses for the method's equations.
            discard_history(inside)
            outcome, residual, gradients = step(kernel, h, inner, start, z1, inside)
            spent += gradients
            if outcome != OK:
                break
            error = evaluate(constraints, z1.q, constraints.new) / size
            if iteration == 0 or error > _SLOW_RATIO * previous:
                spent += _fill_response(kernel, h, constraints, start, z1)
            outcome = _solve_for_impulses(constraints, h, iteration == 0, state.clock[0])
            if outcome != OK:
                break
            outcome = NOT_HELD
            if not error < np.inf:
                break
            if error <= _EPS or (error >= previous and error <= _ROUNDINGS * _EPS):
                more = _remove_normal_velocity(kernel, h, constraints, z1)
                if more < 0:
                    break
                keep_means(work.kept, constraints.impulse, h)
                return OK, residual, spent + more
            previous = error
            for k in range(multipliers.size):
                multipliers[k] += constraints.right[k]
        multipliers[:] = 0.0
        return outcome, residual, spent
    return constrained


@inlined
def _store_means(kept: LoopMultipliers, impulse: np.ndarray, h: float) -> None:
    for k in range(impulse.size):
        kept.means[k] = 0.5 * kept.multipliers[k] + impulse[k] / h


@inlined
def _keep_nothing(*_: Any) -> None:
    """Keep no more than the initial guess."""


@inlined
def _solve_for_impulses(constraints: Constraints, h: float, first: bool, time: float) -> int:
    """Fill the right-hand side with the change of the multipliers; return an outcome."""
    if first:
        # Check if the constraints are independent at the start of the step.
        constraints.right[:] = 0.0
        outcome = _solve(constraints, constraints.old, h)
        if outcome != OK:
            return outcome
        least, most, watched = np.inf, 0.0, constraints.sine
        for k in range(constraints.defect.size):
            if not constraints.dropped[k]:
                least = min(least, constraints.matrix[k, k])
                most = max(most, constraints.scale[k])
        sine = np.sqrt(least / most)
        # Trials go back in time: only successive steps are compared.
        if watched[0] > 0.0 and abs(time - watched[2]) < 0.5 * h:
            watched[1] = max(watched[1], abs(sine - watched[0]) / min(sine, watched[0]))
        watched[0], watched[2] = sine, time + h
    copy_array(constraints.defect, constraints.right)
    return _solve(constraints, constraints.new, 0.5 * h)


@called
def _remove_normal_velocity(kernel: Kernel, h: float, constraints: Constraints, z: PhasePoint
                            ) -> int:
    """Remove the velocity normal to the constraints; return the gradients, -1 on failure."""
    count, previous, spent = constraints.defect.size, np.inf, 0
    constraints.impulse[:] = 0.0
    for _ in range(_MAX_ITERATIONS):
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
        spent += 1
        speed, error = largest(z.dH_dp[:kernel.dimension - kernel.channels]), 0.0
        for k in range(count):
            constraints.right[k] = 0.0
            if constraints.dropped[k]:
                continue
            for i in range(z.q.size):
                constraints.right[k] += constraints.new[k, i] * z.dH_dp[i]
            error = max(error, abs(constraints.right[k]) / largest(constraints.new[k]))
        if error <= _EPS * speed or (error >= previous and error <= _ROUNDINGS * _EPS * speed):
            return spent
        previous = error
        variation = constraints.variation
        variation[0] = 0.0
        for k in range(count):
            if not constraints.dropped[k]:
                kernel.hessian_vector(kernel.parameters, z.q, z.p, variation[0],
                                      constraints.new[k], variation[2], constraints.response[k])
                spent += 1
        if not error < np.inf or _solve(constraints, constraints.new, 1.0) != OK:
            break
        _kick(constraints.new, constraints.right, 1.0, z)
        for k in range(count):
            constraints.impulse[k] += constraints.right[k]
    return -1


@called
def _fill_response(kernel: Kernel, h: float, constraints: Constraints, z: PhasePoint,
                   z1: PhasePoint) -> int:
    """Fill the derivative of the final q by an impulse along each initial G; return its cost."""
    q, p = constraints.middle
    for i in range(q.size):
        q[i], p[i] = 0.5 * (z.q[i] + z1.q[i]), 0.5 * (z.p[i] + z1.p[i])
    v_q, v_p, product_q, product_p = constraints.variation
    spent = 0
    for k in range(constraints.defect.size):
        v_q[:] = 0.0
        copy_array(constraints.old[k], v_p)
        response = constraints.response[k]
        response[:] = 0.0
        for _ in range(0 if constraints.dropped[k] else _MAX_VARIATIONS):
            kernel.hessian_vector(kernel.parameters, q, p, v_q, v_p, product_q, product_p)
            spent += 1
            change = 0.0
            for i in range(q.size):
                change = max(change, abs(h * product_p[i] - response[i]))
                response[i] = h * product_p[i]
                v_q[i] = 0.5 * response[i]
                v_p[i] = constraints.old[k, i] - 0.5 * h * product_q[i]
            if change <= _VARIATION_TOLERANCE * largest(response):
                break
    return spent


@called
def _solve(constraints: Constraints, gradient: np.ndarray, factor: float) -> int:
    """
    Solve factor G R x = right in place, where R is the response and G an initial or final G.

    Returns
    -------
    int
        OK; REDUNDANT, with the row stored, if it depends on earlier ones; else NOT_HELD, if a step
        is too long, or not finite.

    """
    matrix, count = constraints.matrix, constraints.defect.size
    for k in range(count):
        for m in range(count):
            total = 0.0
            for i in range(gradient.shape[1]):
                total += gradient[k, i] * constraints.response[m, i]
            matrix[k, m] = 1.0 if k == m and constraints.dropped[k] else factor * total
    row = solve_in_order(matrix, constraints.right, constraints.scale)
    if row < 0:
        return OK
    if not abs(matrix[row, row]) <= DEPENDENT * constraints.scale[row]:
        return NOT_HELD
    constraints.dependent[0] = row
    return REDUNDANT


@called
def _kick(gradient: np.ndarray, multipliers: np.ndarray, factor: float, z: PhasePoint) -> None:
    """Change p by -factor G^T multipliers."""
    for i in range(z.p.size):
        total = 0.0
        for k in range(multipliers.size):
            total += gradient[k, i] * multipliers[k]
        z.p[i], z.p_carry[i] = plus(z.p[i], z.p_carry[i], -factor * total)
