# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""RATTLE: impulses around a step that keep a system to its holonomic constraints."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from hnn_vi_ros.effects.constraints import Constraints, evaluator
from hnn_vi_ros.integrators.arithmetic import copy_array, copy_point, largest, plus
from hnn_vi_ros.integrators.base import Integrator, NOT_HELD, OK, Point, REDUNDANT, Step
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.linear_algebra import DEPENDENT, solve_in_order
from hnn_vi_ros.kernels.marks import called, inlined, is_own
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
_ITERATIONS = 50
# Rounding of a step's coordinates and of a distance, in units of eps and of their size.
_ROUNDING = 64
# How well the variational equation is solved, as far as its iteration goes; and how slowly
# Newton's method may converge before the equation is made anew.
_VARIATIONS, _CLOSE, _SLOW = 12, 3e-3, 0.5


class Multipliers(NamedTuple):
    """
    Multipliers that the next step starts from.

    Parameters
    ----------
    multipliers : np.ndarray, shape (m,)
        Of the m constraints at the start of the last step.

    """

    multipliers: np.ndarray


class RattleWork(NamedTuple):
    """
    The workspace of a step between two impulses.

    Parameters
    ----------
    kept : Multipliers
        For the next step.
    start : Point
        The state after the first impulse.

    """

    kept: Multipliers
    start: Point


class Rattle:
    """RATTLE with distances and planes, for Wrapped; see ``rattle``."""

    functions: tuple[Callable[..., float], ...] = ()
    repeats = True

    @staticmethod
    def inner_step(integrator: Integrator) -> Step:
        """Return the step of the method."""
        return integrator.step

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> RattleWork:
        """Return the workspace for n coordinates."""
        return RattleWork(Multipliers(np.zeros(settings[0].defect.size)), Point.empty(n))

    @classmethod
    def wrap(cls, step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two impulses of the constraints."""
        return rattle(step, cls.functions)


@cache
def rattle_kind(functions: tuple[Callable[..., float], ...]) -> type[Rattle]:
    """Return Rattle with functions of the user's, which nothing on disk is to know."""
    if not functions:
        return Rattle
    foreign = [function.__module__ for function in functions if not is_own(function.__module__)]
    return type('Rattle', (Rattle,), {
        'functions': functions, '__module__': str([*foreign, 'constraint'][0])})


@cache
def rattle(step: Step, functions: tuple[Callable[..., float], ...] = ()) -> Step:
    """
    Return a step that keeps g(q) = 0 and G(q) q' = 0, G = g'.

        p+ = p_n - (h/2) G(q_n)^T lambda,  (q_(n+1), p-) = step(q_n, p+),  g(q_(n+1)) = 0
        p_(n+1) = p- - (h/2) G(q_(n+1))^T mu,  G(q_(n+1)) H_p(q_(n+1), p_(n+1)) = 0

    Symplectic on the constraint manifold and symmetric, as the step is, and of order 2. lambda
    is found by Newton's method. The derivative of q_(n+1) by an impulse is that of the
    variational equation, with H_pp, H_qp and H_qq half-way, by the midpoint rule.
    The solution that goes to zero with h is taken: there all leading minors of the Jacobian are
    positive.

    References
    ----------
    H. Andersen, RATTLE: a velocity version of the SHAKE algorithm, J. Comput. Phys. 52 (1983).
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """
    evaluate = evaluator(functions)

    @inlined
    def constrained(kernel: Kernel, h: float, options: Parameters, z: Point, z1: Point,
                    memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, constraints, state, _ = options
        work, inside = memory[-1], memory[:-1]
        # The last step's solution is the first guess.
        start, multipliers = work.start, work.kept.multipliers
        evaluate(constraints, z.q, constraints.old)
        copy_array(state.pending, constraints.pending)
        size = largest(z.q) + largest(constraints.lengths)
        previous, residual, spent = np.inf, np.inf, 0
        for iteration in range(_ITERATIONS):
            copy_point(z, start)
            copy_array(constraints.pending, state.pending)
            _kick(constraints.old, multipliers, 0.5 * h, start)
            # Trials of one step are no guide to the next start.
            forget(inside)
            outcome, residual, gradients = step(kernel, h, inner, start, z1, inside)
            spent += gradients
            if outcome != OK:
                break
            error = evaluate(constraints, z1.q, constraints.new) / size
            if iteration == 0 or error > _SLOW * previous:
                spent += _respond(kernel, h, constraints, start, z1)
            if iteration == 0:
                constraints.right[:] = 0.0
                outcome = _solve(constraints, constraints.old, h)
                if outcome != OK:
                    break
            copy_array(constraints.defect, constraints.right)
            outcome = _solve(constraints, constraints.new, 0.5 * h)
            if outcome != OK:
                break
            outcome = NOT_HELD
            if not error < np.inf:
                break
            if error <= _EPS or (error >= previous and error <= _ROUNDING * _EPS):
                more = _end(kernel, h, constraints, z1)
                if more < 0:
                    break
                return OK, residual, spent + more
            previous = error
            for k in range(multipliers.size):
                multipliers[k] += constraints.right[k]
        multipliers[:] = 0.0
        return outcome, residual, spent
    return constrained


@called
def _end(kernel: Kernel, h: float, constraints: Constraints, z: Point) -> int:
    """Take the velocity off the constraints away; return what it took, -1 if in vain."""
    count, previous, spent = constraints.defect.size, np.inf, 0
    for _ in range(_ITERATIONS):
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
        spent += 1
        speed, error = largest(z.dH_dp[:kernel.dimension - kernel.channels]), 0.0
        for k in range(count):
            constraints.right[k] = 0.0
            for i in range(z.q.size):
                constraints.right[k] += constraints.new[k, i] * z.dH_dp[i]
            error = max(error, abs(constraints.right[k]) / largest(constraints.new[k]))
        if error <= _EPS * speed or (error >= previous and error <= _ROUNDING * _EPS * speed):
            return spent
        previous = error
        variation = constraints.variation
        variation[0] = 0.0
        for k in range(count):
            kernel.hessian_vector(kernel.parameters, z.q, z.p, variation[0], constraints.new[k],
                                  variation[2], constraints.response[k])
        spent += count
        if not error < np.inf or _solve(constraints, constraints.new, 1.0) != OK:
            break
        _kick(constraints.new, constraints.right, 1.0, z)
    return -1


@called
def _respond(kernel: Kernel, h: float, constraints: Constraints, z: Point, z1: Point) -> int:
    """Fill how q at the end answers to an impulse along each G at the start; return the cost."""
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
        for _ in range(_VARIATIONS):
            kernel.hessian_vector(kernel.parameters, q, p, v_q, v_p, product_q, product_p)
            spent += 1
            change = 0.0
            for i in range(q.size):
                change = max(change, abs(h * product_p[i] - response[i]))
                response[i] = h * product_p[i]
                v_q[i] = 0.5 * response[i]
                v_p[i] = constraints.old[k, i] - 0.5 * h * product_q[i]
            if change <= _CLOSE * largest(response):
                break
    return spent


@called
def _solve(constraints: Constraints, gradient: np.ndarray, factor: float) -> int:
    """
    Solve factor G R x = right in place, R the response, with G at the start or at the end.

    Returns
    -------
    int
        OK; REDUNDANT, and which is noted, where one row depends on those before it; else
        NOT_HELD, where a step is too long, or no number comes out.

    """
    matrix, count = constraints.matrix, constraints.defect.size
    for k in range(count):
        for m in range(count):
            total = 0.0
            for i in range(gradient.shape[1]):
                total += gradient[k, i] * constraints.response[m, i]
            matrix[k, m] = factor * total
    row = solve_in_order(matrix, constraints.right, constraints.scale)
    if row < 0:
        return OK
    if not abs(matrix[row, row]) <= DEPENDENT * constraints.scale[row]:
        return NOT_HELD
    constraints.dependent[0] = row
    return REDUNDANT


@called
def _kick(gradient: np.ndarray, multipliers: np.ndarray, factor: float, z: Point) -> None:
    """Change p by -factor G^T multipliers."""
    for i in range(z.p.size):
        total = 0.0
        for k in range(multipliers.size):
            total += gradient[k, i] * multipliers[k]
        z.p[i], z.p_carry[i] = plus(z.p[i], z.p_carry[i], -factor * total)
