# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The discrete gradient method of Gonzalez, which conserves the energy exactly."""

from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array, largest, plus
from hnn_vi_ros.integrators.base import OK, Point, Requirements
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.newton import difference
from hnn_vi_ros.integrators.solvers import extrapolate, remember, SolverOptions
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


class DiscreteGradientWork(NamedTuple):
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
    ahead, behind : np.ndarray
        For differences; see newton.difference.

    """

    kept: History
    solver: SolverWork
    end: np.ndarray
    start: np.ndarray
    middle: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'DiscreteGradientWork':
        """Return the workspace for n coordinates."""
        return cls(History.empty(2 * n, dtype), SolverWork.empty(2 * n, dtype),
                   *np.zeros((5, 2 * n), dtype))


class _Problem(NamedTuple):
    """The equation for the new state; the discrete gradient of its last evaluation."""

    kernel: Kernel
    h: float
    z: Point
    middle: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    scale: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class DiscreteGradient(ImplicitIntegrator):
    """
    The midpoint discrete gradient D of Gonzalez: z_(n+1) = z_n + h J D(z_n, z_(n+1)).

        D(z, z') = g + (H(z') - H(z) - g . (z' - z)) / |z' - z|^2 (z' - z),  g = H'((z + z')/2)

    Since D . (z' - z) = H(z') - H(z), the energy is conserved, up to the rounding of H. The
    method is symmetric and of order 2, but not symplectic. DGNet learns through it.

    References
    ----------
    O. Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Sci. 6 (1996).
    T. Matsubara, A. Ishikawa, T. Yaguchi, Deep energy-based modeling of discrete-time physics,
    NeurIPS 2020.

    """

    order = 2
    requirements = Requirements(symmetric=True, symplectic=False, forces=False)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the number of unknowns: the new q and p."""
        return (2 * n,)

    def memory(self, n: int, dtype: type = np.float64) -> tuple[DiscreteGradientWork]:
        """Return the workspace of the equation; see Integrator."""
        return (DiscreteGradientWork.empty(n, dtype),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: Point, z1: Point,
             memory: tuple[DiscreteGradientWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        n, work = z.q.size, memory[0]
        x, start, iterates = work.end, work.start, work.solver.iterates
        for i in range(n):
            start[i], start[n + i] = z.q[i], z.p[i]
            x[i], x[n + i] = z.q[i] + h * z.dH_dp[i], z.p[i] - h * z.dH_dq[i]
        _set_scale(iterates.scale, kernel, h, z)
        # The rounding of H, of all coordinates together, enters the equation of each.
        copy_array(iterates.scale, iterates.own_scale)
        if options.extrapolate:
            extrapolate(work.kept, start, x)
        problem = _Problem(kernel, h, z, work.middle, z1.dH_dq, z1.dH_dp, iterates.scale,
                           work.ahead, work.behind)
        outcome, residual, gradients = options.solve(
            _equation, _tangent, problem, x, work.solver, options.max_iterations)
        if outcome == OK:
            remember(work.kept, start, x)
        for i in range(n):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z1.dH_dq[i])
        return outcome, residual, gradients


@inlined
def _set_scale(scale: np.ndarray, kernel: Kernel, h: float, z: Point) -> None:
    """Set the scale of q and p of each trajectory; the rounding of H enters the equation."""
    n, d = z.q.size, kernel.dimension
    for start in range(0, n, d):
        end = start + d
        slope_q, slope_p = largest(z.dH_dp[start:end]), largest(z.dH_dq[start:end])
        square = slope_q * slope_q + slope_p * slope_p
        energy = max(abs(kernel.energy(kernel.parameters, z.q[start:end], z.p[start:end])),
                     kernel.energy_scale)
        rounding = energy / square if square > 0.0 else 0.0
        for i in range(start, end):
            scale[i] = max(largest(z.q[start:end]), abs(h) * slope_q,
                           abs(h) * kernel.gradient_scale[1], rounding * slope_q)
            scale[n + i] = max(largest(z.p[start:end]), abs(h) * slope_p,
                               abs(h) * kernel.gradient_scale[0], rounding * slope_p)


@inlined
def _equation(problem: _Problem, x: np.ndarray, value: np.ndarray) -> None:
    kernel, z, n, h = problem.kernel, problem.z, problem.z.q.size, problem.h
    d, middle = kernel.dimension, problem.middle
    for i in range(n):
        middle[i], middle[n + i] = 0.5 * (z.q[i] + x[i]), 0.5 * (z.p[i] + x[n + i])
    kernel.gradient(kernel.parameters, middle[:n], middle[n:], problem.dH_dq, problem.dH_dp)
    for start in range(0, n, d):
        end = start + d
        square, along = 0.0, 0.0
        for i in range(start, end):
            dq, dp = x[i] - z.q[i], x[n + i] - z.p[i]
            square += dq * dq + dp * dp
            along += problem.dH_dq[i] * dq + problem.dH_dp[i] * dp
        difference = (kernel.energy(kernel.parameters, x[start:end], x[n + start:n + end])
                      - kernel.energy(kernel.parameters, z.q[start:end], z.p[start:end]))
        factor = (difference - along) / square if square > 0.0 else 0.0
        for i in range(start, end):
            problem.dH_dq[i] += factor * (x[i] - z.q[i])
            problem.dH_dp[i] += factor * (x[n + i] - z.p[i])
    for i in range(n):
        value[i] = z.q[i] + (z.q_carry[i] + h * problem.dH_dp[i])
        value[n + i] = z.p[i] + (z.p_carry[i] - h * problem.dH_dq[i])


@inlined
def _tangent(problem: _Problem, x: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
    """Approximate G'(x) v: Newton's method asks for no more."""
    difference(_equation, problem, x, v, product)
