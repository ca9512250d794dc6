# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The implicit midpoint rule."""

from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import midpoint_energy, OK, PhasePoint, Requirements, tableau
from hnn_vi_ros.integrators.equations import set_scale
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import extrapolate, SolverOptions, store_solution
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


class MidpointWork(NamedTuple):
    """
    Workspace of the equation for the midpoint; arrays of shape (2 n,) hold q, then p.

    Parameters
    ----------
    kept : History
        Earlier midpoints.
    solver : SolverWork
        Arrays of the solvers.
    midpoint, start : np.ndarray
        The midpoint, and the state at the start of the step.

    """

    kept: History
    solver: SolverWork
    midpoint: np.ndarray
    start: np.ndarray


class _MidpointEquation(NamedTuple):
    """The equation for the midpoint; it stores the gradient there."""

    kernel: Kernel
    half: float
    z: PhasePoint
    dH_dq: np.ndarray
    dH_dp: np.ndarray


class ImplicitMidpoint(ImplicitIntegrator):
    """
    Implicit midpoint rule: the variational integrator of the midpoint rule for the action.

        y = z_n + (h/2) J H'(y),  z_(n+1) = z_n + h J H'(y)

    Symplectic, symmetric, order 2; use it for stiff systems. It conserves every quadratic
    invariant, and nearly conserves the energy of midpoint_energy, up to O(h^4).

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.4.

    """

    order, equations = 2, (2,)  # for q and p of the midpoint
    requirements = Requirements(symmetric=True, symplectic=True)
    modified_energy = staticmethod(midpoint_energy)
    partitioned = tableau([[0.5]], [[0.5]], [1], [1])  # the stage is the midpoint

    def memory(self, n: int, dtype: type = np.float64) -> tuple[MidpointWork]:
        """Return the workspace of the equation."""
        return (MidpointWork(History.empty(2 * n, dtype), SolverWork.empty(2 * n, dtype),
                             *np.zeros((2, 2 * n), dtype)),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[MidpointWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        n, kept, solver = z.q.size, memory[0].kept, memory[0].solver
        y, start, iterates = memory[0].midpoint, memory[0].start, solver.iterates
        for i in range(n):
            start[i], start[n + i] = z.q[i], z.p[i]
            y[i] = z.q[i] + 0.5 * h * z.dH_dp[i]
            y[n + i] = z.p[i] - 0.5 * h * z.dH_dq[i]
        set_scale(iterates.scale[:n], iterates.own_scale[:n], z.q, z.dH_dp, h, kernel, 1)
        set_scale(iterates.scale[n:], iterates.own_scale[n:], z.p, z.dH_dq, h, kernel, 0)
        if options.extrapolate:
            extrapolate(kept, start, y)
        problem = _MidpointEquation(kernel, 0.5 * h, z, z1.dH_dq, z1.dH_dp)
        outcome, residual, gradients = options.solve(
            _equation, _tangent, problem, y, solver, options.max_iterations)
        if outcome == OK:
            store_solution(kept, start, y)
        for i in range(n):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z1.dH_dq[i])
        return outcome, residual, gradients


@inlined
def _equation(problem: _MidpointEquation, x: np.ndarray, value: np.ndarray) -> None:
    z, n = problem.z, problem.z.q.size
    problem.kernel.gradient(problem.kernel.parameters, x[:n], x[n:], problem.dH_dq, problem.dH_dp)
    for i in range(n):
        value[i] = z.q[i] + (z.q_carry[i] + problem.half * problem.dH_dp[i])
        value[n + i] = z.p[i] + (z.p_carry[i] - problem.half * problem.dH_dq[i])


@inlined
def _tangent(problem: _MidpointEquation, x: np.ndarray, v: np.ndarray, product: np.ndarray
             ) -> None:
    n = problem.z.q.size
    # Free until the next evaluation of the equation fills these arrays.
    at_q, at_p = problem.dH_dq, problem.dH_dp
    problem.kernel.hessian_vector(problem.kernel.parameters, x[:n], x[n:], v[:n], v[n:],
                                  at_q, at_p)
    for i in range(n):
        product[i], product[n + i] = problem.half * at_p[i], -problem.half * at_q[i]
