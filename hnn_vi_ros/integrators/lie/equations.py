# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The two implicit equations of the methods on a group: for momenta within a step, and for rotations.

Both also cover scalar coordinates, for which they reduce to the equations of the symplectic Euler
method and of its adjoint. Kernel describes the layout of arrays: a rotation uses three columns for
its momentum and four for its quaternion; unused columns before the channels stay zero.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import OK, PhasePoint, Requirements, TURNED
from hnn_vi_ros.integrators.equations import set_scale
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.lie.rotations import cross, dot, RETRACTIONS, trivialised, turn
from hnn_vi_ros.integrators.newton_solver import by_differences
from hnn_vi_ros.integrators.solvers import extrapolate, SolverOptions, store_solution
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels import called, inlined, Kernel
import numpy as np

# Limit of |h omega|, beyond which a step is refused: nearly half a revolution, where the shortest
# rotation to the next attitude changes direction.
LARGEST_TURN = 3.0
# Squares of that rotation angle, and of its vector in the Cayley map.
FURTHEST = LARGEST_TURN * LARGEST_TURN
FURTHEST_CAYLEY = float((2.0 * np.tan(0.5 * LARGEST_TURN)) ** 2)


class LieOptions(NamedTuple):
    """
    Options of a step on a group.

    Parameters
    ----------
    solver : SolverOptions
        Options of the solver of its equations.
    retraction : callable
        One of RETRACTIONS.

    """

    solver: SolverOptions
    retraction: Callable


class GroupWork(NamedTuple):
    """
    Workspace of one of the equations; arrays of shape (n,).

    Parameters
    ----------
    kept : History
        Earlier solutions.
    solver : SolverWork
        Arrays of the solvers.
    origin, slope : np.ndarray
        Reference of earlier solutions, and the best known rate of change of the unknowns.
    x : np.ndarray
        Changes of coordinates over the step; for rotations, the arguments of tau.
    momenta, change : np.ndarray
        The momenta within the step, and their change without forces: first the part of their
        equation that does not depend on them, then all of it.
    ahead, behind : np.ndarray
        Points of finite differences.

    """

    kept: History
    solver: SolverWork
    origin: np.ndarray
    slope: np.ndarray
    x: np.ndarray
    momenta: np.ndarray
    change: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'GroupWork':
        """Return the workspace of an equation of n unknowns."""
        return cls(History.empty(n, dtype), SolverWork.empty(n, dtype), *np.zeros((7, n), dtype))


class _GroupEquation(NamedTuple):
    """One equation, from z over h, at g; it fills z1. The last field is used by its tangent."""

    kernel: Kernel
    h: float
    retraction: Callable
    g: np.ndarray
    z: PhasePoint
    z1: PhasePoint
    work: GroupWork
    scale: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


@inlined
def is_rotation(kernel: Kernel, i: int, passed: int) -> bool:
    """Return True if a quaternion begins in column i of q, after ``passed`` earlier ones."""
    return passed < len(kernel.rotations) and i == kernel.rotations[passed]


@inlined
def solve_momenta_inside(kernel: Kernel, h: float, options: LieOptions, g: np.ndarray,
                         z: PhasePoint, z1: PhasePoint, work: GroupWork
                         ) -> tuple[int, float, int]:
    """
    Solve (dtau^-1_(h xi))^* mu = pi - h g^* H_g(g, mu) with xi = H_mu(g, mu).

    Parameters
    ----------
    kernel, h, options
        See Integrator.
    g : np.ndarray, shape (n,)
        The coordinates, of z or of another point.
    z : Point
        The momenta pi, and an estimate of the gradient at z.q, for the initial guess.
    z1 : Point
        Receives the gradient at (g, mu).
    work : GroupWork
        Its ``change`` is added to the right-hand side. On return it contains mu in ``momenta``,
        x = h xi, and g^* H_g in ``slope``.

    Returns
    -------
    tuple of (int, float, int)
        Outcome, relative residual [1], number of gradients.

    """
    iterates, mu = work.solver.iterates, work.momenta
    fill_forces(kernel, z.q, z.dH_dq, work.slope)
    for i in range(mu.size):
        mu[i] = z.p[i] - h * work.slope[i]
    set_scale(iterates.scale, iterates.own_scale, z.p, work.slope, h, kernel, 0)
    if options.solver.extrapolate:
        extrapolate(work.kept, z.p, mu)
    problem = _GroupEquation(kernel, h, options.retraction, g, z, z1, work, iterates.scale,
                             work.ahead, work.behind)
    outcome, residual, gradients = options.solver.solve(
        _inside_equation, _inside_tangent, problem, mu, work.solver,
        options.solver.max_iterations)
    if outcome == OK:
        store_solution(work.kept, z.p, mu)
    return outcome, residual, gradients


@inlined
def solve_turns(kernel: Kernel, h: float, options: LieOptions, z: PhasePoint, z1: PhasePoint,
                work: GroupWork) -> tuple[int, float, int]:
    """
    Solve x = h H_mu(g tau(x), mu) with mu = dtau_x^* pi, and store g tau(x) in z1.q.

    Parameters
    ----------
    kernel, h, options
        See Integrator.
    z : Point
        g and pi, and an estimate of H_mu, for the initial guess.
    z1 : Point
        Receives q, and the gradient at (q, mu).
    work : GroupWork
        On return it contains x, mu in ``momenta``, and g^* H_g in ``slope``.

    Returns
    -------
    tuple of (int, float, int)
        Outcome, relative residual [1], number of gradients.

    """
    iterates, x = work.solver.iterates, work.x
    for i in range(x.size):
        x[i] = h * z.dH_dp[i]
    set_turn_scale(kernel, h, z, x, iterates.scale, iterates.own_scale)
    if turns_beyond(kernel, x, FURTHEST):
        return TURNED, np.inf, 0
    if options.solver.extrapolate:
        extrapolate(work.kept, work.origin, x)
    problem = _GroupEquation(kernel, h, options.retraction, z.q, z, z1, work, iterates.scale,
                             work.ahead, work.behind)
    outcome, residual, gradients = options.solver.solve(
        _turn_equation, _turn_tangent, problem, x, work.solver, options.solver.max_iterations)
    if outcome == OK:
        store_solution(work.kept, work.origin, x)
    fill_forces(kernel, z1.q, z1.dH_dq, work.slope)
    return check_turns(kernel, options.retraction, x, outcome), residual, gradients


@called
def turns_beyond(kernel: Kernel, x: np.ndarray, squared: float) -> bool:
    """Return True if the square of a rotation vector in x reaches a bound."""
    for start in range(0, x.size, kernel.dimension):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            if dot(x, x, at) >= squared:
                return True
    return False


@called
def check_turns(kernel: Kernel, retraction: Callable, x: np.ndarray, outcome: int) -> int:
    """
    Return the outcome, or TURNED if the momentum that led to x implies too large a rotation.

    pi = (dtau^-1_x)^* mu is parallel to mu if x is, and larger by this factor. In the Cayley map a
    body rotates less than its momentum implies, increasingly so for large momenta.
    """
    for start in range(0, x.size, kernel.dimension):
        for k in range(len(kernel.rotations)):
            squared = dot(x, x, start + kernel.rotations[k] - k)
            tau = retraction(0.25 * squared)
            longer = 1.0 + (tau.along - tau.squared) * squared
            if squared * longer * longer > FURTHEST:
                return TURNED
    return outcome


@called
def move(kernel: Kernel, retraction: Callable, z: PhasePoint, x: np.ndarray, z1: PhasePoint
         ) -> None:
    """Fill z1.q with z.q moved by x: g tau(x) for a rotation, a sum for other coordinates."""
    d = kernel.dimension
    for start in range(0, x.size, d):
        i, passed, end = 0, 0, d - kernel.channels
        while i < end:
            at = start + i - passed
            if is_rotation(kernel, i, passed):
                turn(z.q, z.q_carry, start + i, x, at, retraction(0.25 * dot(x, x, at)),
                     z1.q, z1.q_carry)
                i, passed = i + 4, passed + 1
            else:
                z1.q[start + i], z1.q_carry[start + i] = plus(
                    z.q[start + i], z.q_carry[start + i], x[at])
                i += 1
        for j in range(start + end, start + d):
            z1.q[j], z1.q_carry[j] = plus(z.q[j], z.q_carry[j], x[j])


@called
def transport(kernel: Kernel, h: float, z: PhasePoint, work: GroupWork, z1: PhasePoint) -> None:
    """
    Fill z1.p with pi1 = (dtau^-1_(-x))^* mu, from pi, x, mu and g^* H_g in ``slope``.

    The force h g^* H_g is subtracted either in (dtau^-1_x)^* mu = pi - h g^* H_g or from pi1. In
    both cases the terms even in x cancel, and pi1 = pi - h g^* H_g - x cross mu.
    """
    x, mu, change, d = work.x, work.momenta, work.change, kernel.dimension
    for i in range(x.size):
        change[i] = -h * work.slope[i]
    for start in range(0, x.size, d):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            bend = cross(x, mu, at)
            for j in range(3):
                change[at + j] -= bend[j]
    for i in range(x.size):
        z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], change[i])


@called
def add_bend(kernel: Kernel, retraction: Callable, x: np.ndarray, mu: np.ndarray, side: float,
             result: np.ndarray) -> None:
    """Add (dtau^-1_(side x))^* mu - mu; terms even in x are the same for both signs of side."""
    d = kernel.dimension
    for start in range(0, x.size, d):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            squared, along = dot(x, x, at), dot(x, mu, at)
            tau, bend = retraction(0.25 * squared), cross(x, mu, at)
            for j in range(3):
                result[at + j] += (0.5 * side * bend[j] + tau.along * along * x[at + j]
                                   - tau.squared * squared * mu[at + j])


@called
def fill_forces(kernel: Kernel, q: np.ndarray, dH_dq: np.ndarray, forces: np.ndarray) -> None:
    """Fill the left-trivialised derivative of H in the layout of the momenta."""
    d = kernel.dimension
    for start in range(0, q.size, d):
        i, passed, end = 0, 0, d - kernel.channels
        while i < end:
            at = start + i - passed
            if is_rotation(kernel, i, passed):
                forces[at], forces[at + 1], forces[at + 2] = trivialised(q, dH_dq, start + i)
                i, passed = i + 4, passed + 1
            else:
                forces[at] = dH_dq[start + i]
                i += 1
        for j in range(start + end - passed, start + end):
            forces[j] = 0.0
        for j in range(start + end, start + d):
            forces[j] = dH_dq[j]


@called
def set_turn_scale(kernel: Kernel, h: float, z: PhasePoint, x: np.ndarray, scale: np.ndarray,
                   own_scale: np.ndarray) -> None:
    """Set the scale of each change: that of the coordinates, 1 for a quaternion, and its own."""
    d = kernel.dimension
    for i in range(x.size):
        own_scale[i] = max(abs(x[i]), abs(h) * kernel.gradient_scale[1])
    for start in range(0, x.size, d):
        # The largest entry of a unit quaternion would be almost the same.
        size, end = 1.0, start + d - kernel.channels
        for i in range(start, end):
            size = max(size, abs(z.q[i]))
        for j in range(start, end):
            scale[j] = size
        for j in range(end, start + d):
            # A time, which is known.
            scale[j], own_scale[j] = abs(h), abs(h)


@inlined
def _inside_equation(problem: _GroupEquation, x: np.ndarray, value: np.ndarray) -> None:
    """Fill value with pi - h g^* H_g(g, x) minus (dtau^-1)^* x - x."""
    kernel, h, z, z1, work = problem.kernel, problem.h, problem.z, problem.z1, problem.work
    kernel.gradient(kernel.parameters, problem.g, x, z1.dH_dq, z1.dH_dp)
    fill_forces(kernel, problem.g, z1.dH_dq, work.slope)
    for i in range(x.size):
        work.x[i], value[i] = h * z1.dH_dp[i], 0.0
    add_bend(kernel, problem.retraction, work.x, x, 1.0, value)
    for i in range(x.size):
        value[i] = plus(z.p[i], z.p_carry[i], work.change[i] - h * work.slope[i] - value[i])[0]


_inside_tangent = by_differences(_inside_equation)


@inlined
def _turn_equation(problem: _GroupEquation, x: np.ndarray, value: np.ndarray) -> None:
    """Fill value with h H_mu(g tau(x), dtau_x^* pi)."""
    kernel, z, z1, mu = problem.kernel, problem.z, problem.z1, problem.work.momenta
    d = kernel.dimension
    move(kernel, problem.retraction, z, x, z1)
    for i in range(x.size):
        mu[i] = z.p[i]
    for start in range(0, x.size, d):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            tau = problem.retraction(0.25 * dot(x, x, at))
            bend, along = cross(x, z.p, at), dot(x, z.p, at)
            for j in range(3):
                mu[at + j] = (tau.own * z.p[at + j] - tau.cross * bend[j]
                              + tau.line * along * x[at + j])
    kernel.gradient(kernel.parameters, z1.q, mu, z1.dH_dq, z1.dH_dp)
    for i in range(x.size):
        value[i] = problem.h * z1.dH_dp[i]


_turn_tangent = by_differences(_turn_equation)


class LieIntegrator(ImplicitIntegrator):
    """
    Variational integrator for rotations and poses, from the discrete Hamilton-Pontryagin action.

    The action is the sum over k of <mu_k, tau^-1(g_k^-1 g_(k+1))> - h H(g_k, mu_k), where the
    retraction tau maps angular velocities in the body frame, times h, to rotations. For a scalar
    coordinate tau is the identity, and the action is that of eq. (6). Attitudes are updated by
    multiplication, so quaternions keep their norm. A rotation of 3 rad or more in one step fails.

    Parameters
    ----------
    retraction : str
        ``'cayley'`` or ``'exponential'``.
    solver, max_iterations
        See ImplicitIntegrator.

    Raises
    ------
    ValueError
        An unknown retraction or solver, or fewer than one iteration.

    References
    ----------
    N. Bou-Rabee, J. Marsden, Hamilton-Pontryagin integrators on Lie groups, part I, Found.
    Comput. Math. 9 (2009).
    M. Kobilarov, J. Marsden, Discrete geometric optimal control on Lie groups, IEEE Trans. Robot.
    27 (2011).

    """

    order, fallback = 1, 'lie_leapfrog'
    requirements = Requirements(symmetric=False, symplectic=True, coordinates='group')

    def __init__(self, retraction: str = 'cayley', solver: str = 'chain',
                 max_iterations: int = 100):
        super().__init__(solver, max_iterations)
        if retraction not in RETRACTIONS:
            raise ValueError(f'retraction = {retraction!r}; valid: {", ".join(RETRACTIONS)}')
        self.retraction = retraction

    def options(self, attempt: int = 0, dimension: int = 1) -> Any:
        """Return the options of an attempt of the chain, and the retraction."""
        return LieOptions(super().options(attempt, dimension), RETRACTIONS[self.retraction])

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspace of the equation."""
        return (GroupWork.empty(n, dtype),)
