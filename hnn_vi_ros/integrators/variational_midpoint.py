# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The midpoint rule for the action of a one-form and an energy, in any coordinates."""

from typing import Any, NamedTuple

from hnn_vi_ros import models
from hnn_vi_ros.integrators.arithmetic import copy_array, largest, plus
from hnn_vi_ros.integrators.base import OK, Point, Requirements
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.newton import difference
from hnn_vi_ros.integrators.solvers import extrapolate, remember, SolverOptions
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


class VariationalWork(NamedTuple):
    """
    The workspace of the equation for the new state; arrays of shape (2 n,) hold q, then p.

    Parameters
    ----------
    kept : History
        Earlier solutions.
    solver : SolverWork
        What its solvers work on.
    end, start, middle : np.ndarray
        The new state, the old one, and half-way between.
    rates : np.ndarray
        Rates of change in the last evaluation.
    ahead, behind : np.ndarray
        For differences; see newton.difference.

    """

    kept: History
    solver: SolverWork
    end: np.ndarray
    start: np.ndarray
    middle: np.ndarray
    rates: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class _Problem(NamedTuple):
    """The equation for the new state; the rates of change of its last evaluation."""

    kernel: Kernel
    h: float
    z: Point
    middle: np.ndarray
    rates: np.ndarray
    scale: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class VariationalMidpoint(ImplicitIntegrator):
    """
    The midpoint rule for the action of theta(u) . u' - H(u): W(u~) (u1 - u0) = h D(u0, u1).

    With u~ = (u0 + u1) / 2 the discrete Lagrangian is L_d = theta(u~) . (u1 - u0) - h H(u~), and
    its two equations p0 = -D_1 L_d, p1 = D_2 L_d are, added and subtracted,

        (p0 + p1) / 2 = theta(u~),  p1 - p0 = theta'(u~)^T (u1 - u0) - h H'(u~).

    L is linear in u', so that p is no free variable: it is theta(u). The two equations hold that
    only in their middles. Taken literally, they have twice as many solutions as there are
    motions; the others alternate in sign from step to step, and may grow: with a gradient added
    to theta, which changes no motion, a double pendulum is lost within 2 s. So p = theta(u)
    takes the place of the first equation, and theta(u1) - theta(u0) = theta'(u~) (u1 - u0), to
    the order of the method, closes the second one: with W = theta'^T - theta'

        W(u~) (u1 - u0) = h H'(u~),

    a one-step map that gradients in theta leave alone. W is skew, so (u1 - u0) . H'(u~) = 0 and
    H changes by terms of third order, which need not cancel where no time reversal makes them.
    Therefore D is the midpoint discrete gradient of H, which is H'(u~) but for those terms; see
    DiscreteGradient. Then (u1 - u0) . D = H(u1) - H(u0) = 0: the energy is conserved, up to the
    rounding of H.

    Symmetric, order 2; where W is constant it is DiscreteGradient in canonical coordinates. Not
    symplectic.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Neural Symplectic Form, NeurIPS 2021.
    M. Kraus, Projected variational integrators for degenerate Lagrangian systems, 2017,
    arXiv:1708.07356, on the solutions that grow.
    D. Cohen, E. Hairer, Linear energy-preserving integrators for Poisson systems, BIT 51 (2011).

    """

    order = 2
    requirements = Requirements(symmetric=True, symplectic=False, coordinates='other',
                                forces=False)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the number of unknowns: the new q and p."""
        return (2 * n,)

    def memory(self, n: int, dtype: type = np.float64) -> tuple[VariationalWork]:
        """Return the workspace of the equation; see Integrator."""
        return (VariationalWork(History.empty(2 * n, dtype), SolverWork.empty(2 * n, dtype),
                                *np.zeros((6, 2 * n), dtype)),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: Point, z1: Point,
             memory: tuple[VariationalWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        n, work, iterates = z.q.size, memory[0], memory[0].solver.iterates
        x, start, rates = work.end, work.start, work.rates
        for i in range(n):
            start[i], start[n + i] = z.q[i], z.p[i]
            x[i], x[n + i] = z.q[i] + h * z.dH_dp[i], z.p[i] - h * z.dH_dq[i]
        _set_scale(iterates.scale, kernel, h, z)
        # The rounding of H, of all coordinates together, enters the equation of each.
        copy_array(iterates.scale, iterates.own_scale)
        if options.extrapolate:
            extrapolate(work.kept, start, x)
        problem = _Problem(kernel, h, z, work.middle, rates, iterates.scale, work.ahead,
                           work.behind)
        outcome, residual, gradients = options.solve(
            _equation, _tangent, problem, x, work.solver, options.max_iterations)
        if outcome == OK:
            remember(work.kept, start, x)
        for i in range(n):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * rates[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], h * rates[n + i])
            z1.dH_dp[i], z1.dH_dq[i] = rates[i], -rates[n + i]
        return outcome, residual, gradients


@inlined
def _set_scale(scale: np.ndarray, kernel: Kernel, h: float, z: Point) -> None:
    """
    Set the scale of q and p of each trajectory.

    D holds the rounding of H over abs(u1 - u0), which W^-1 makes one of u'.
    """
    n, d = z.q.size, kernel.dimension
    form: Any = kernel.parameters
    for a in range(0, n, d):
        slope_q, slope_p = largest(z.dH_dp[a:a + d]), largest(z.dH_dq[a:a + d])
        fastest = max(slope_q, slope_p)
        rounding = form.energy_rounding * form.inverse_norm / fastest if fastest > 0.0 else 0.0
        for i in range(a, a + d):
            scale[i] = max(largest(z.q[a:a + d]), abs(h) * slope_q,
                           abs(h) * kernel.gradient_scale[1], rounding)
            scale[n + i] = max(largest(z.p[a:a + d]), abs(h) * slope_p,
                               abs(h) * kernel.gradient_scale[0], rounding)


@inlined
def _equation(problem: _Problem, x: np.ndarray, value: np.ndarray) -> None:
    kernel, z, n, h = problem.kernel, problem.z, problem.z.q.size, problem.h
    d, middle = kernel.dimension, problem.middle
    for i in range(n):
        middle[i], middle[n + i] = 0.5 * (z.q[i] + x[i]), 0.5 * (z.p[i] + x[n + i])
    for a in range(0, n, d):
        b = a + d
        # Each trajectory's covector and rates lie together until they are sorted below.
        covector = value[2 * a:2 * b]
        # Reached through its package, already loaded, since H comes from it. An import in this
        # file would load the compiler for anyone who only reads a scene.
        models.symplectic_form.slope(  # type: ignore[attr-defined]
            kernel.parameters, middle[a:b], middle[n + a:n + b], covector)
        square, along = 0.0, 0.0
        for i in range(d):
            dq, dp = x[a + i] - z.q[a + i], x[n + a + i] - z.p[a + i]
            square += dq * dq + dp * dp
            along += covector[i] * dq + covector[d + i] * dp
        difference = (kernel.energy(kernel.parameters, x[a:b], x[n + a:n + b])
                      - kernel.energy(kernel.parameters, z.q[a:b], z.p[a:b]))
        factor = (difference - along) / square if square > 0.0 else 0.0
        for i in range(d):
            covector[i] += factor * (x[a + i] - z.q[a + i])
            covector[d + i] += factor * (x[n + a + i] - z.p[a + i])
        models.symplectic_form.raise_index(  # type: ignore[attr-defined]
            kernel.parameters, middle[a:b], middle[n + a:n + b], covector)
        for i in range(d):
            problem.rates[a + i], problem.rates[n + a + i] = covector[i], covector[d + i]
    for i in range(n):
        value[i] = z.q[i] + (z.q_carry[i] + h * problem.rates[i])
        value[n + i] = z.p[i] + (z.p_carry[i] + h * problem.rates[n + i])


@inlined
def _tangent(problem: _Problem, x: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
    """Approximate G'(x) v: Newton's method asks for no more."""
    difference(_equation, problem, x, v, product)
