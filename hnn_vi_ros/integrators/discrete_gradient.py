# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The discrete gradient method of Gonzalez, which conserves the energy exactly."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array, largest, plus
from hnn_vi_ros.integrators.base import OK, PhasePoint, Requirements, Step
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.newton_solver import by_differences
from hnn_vi_ros.integrators.solvers import extrapolate, SolverOptions, store_solution
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


class DiscreteGradientWork(NamedTuple):
    """
    Workspace of the equation for the new state; arrays of shape (2 n,) hold q, then p.

    Parameters
    ----------
    kept : History
        Earlier solutions.
    solver : SolverWork
        Arrays of its solvers.
    end, start, middle : np.ndarray
        The new state, the old one, and their mean.
    rates : np.ndarray
        Rates of change in the last evaluation.
    ahead, behind : np.ndarray
        Points of finite differences; see newton_solver.by_differences.

    """

    kept: History
    solver: SolverWork
    end: np.ndarray
    start: np.ndarray
    middle: np.ndarray
    rates: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class EndProblem(NamedTuple):
    """The equation for the new state, and the rates of change of its last evaluation."""

    kernel: Kernel
    h: float
    z: PhasePoint
    middle: np.ndarray
    rates: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    scale: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class EnergyConserving(ImplicitIntegrator):
    """A method of order 2 whose equation for the new state contains a discrete gradient of H."""

    order, equations = 2, (2,)  # for the new q and p

    def memory(self, n: int, dtype: type = np.float64) -> tuple[DiscreteGradientWork]:
        """Return the workspace of the equation."""
        return (DiscreteGradientWork(History.empty(2 * n, dtype), SolverWork.empty(2 * n, dtype),
                                     *np.zeros((6, 2 * n), dtype)),)


@cache
def step_to_end(set_scale: Callable[..., None], equation: Callable[..., None]) -> Step:
    """
    Return the step function that solves an equation for the new state.

    Parameters
    ----------
    set_scale : callable
        ``set_scale(scale, kernel, h, z)`` fills the scale of q, then of p, of each trajectory.
    equation : callable
        Equation as in ``solvers`` for an EndProblem, whose ``rates`` it fills.

    """
    end_tangent = by_differences(equation)

    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        n, work, iterates = z.q.size, memory[0], memory[0].solver.iterates
        x, start, rates = work.end, work.start, work.rates
        for i in range(n):
            start[i], start[n + i] = z.q[i], z.p[i]
            x[i], x[n + i] = z.q[i] + h * z.dH_dp[i], z.p[i] - h * z.dH_dq[i]
        set_scale(iterates.scale, kernel, h, z)
        # The rounding error of H, which sums over all coordinates, enters every equation.
        copy_array(iterates.scale, iterates.own_scale)
        if options.extrapolate:
            extrapolate(work.kept, start, x)
        problem = EndProblem(kernel, h, z, work.middle, rates, z1.dH_dq, z1.dH_dp,
                             iterates.scale, work.ahead, work.behind)
        outcome, residual, gradients = options.solve(
            equation, end_tangent, problem, x, work.solver, options.max_iterations)
        if outcome == OK:
            store_solution(work.kept, start, x)
        for i in range(n):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * rates[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], h * rates[n + i])
            z1.dH_dp[i], z1.dH_dq[i] = rates[i], -rates[n + i]
        return outcome, residual, gradients
    return step


@inlined
def discrete_factor(problem: EndProblem, x: np.ndarray, a: int, at_q: np.ndarray,
                    at_p: np.ndarray) -> float:
    """Return (H(z') - H(z) - g . (z' - z)) / |z' - z|^2 of the trajectory at offset a; needs g."""
    kernel, z, n, b = problem.kernel, problem.z, problem.z.q.size, a + problem.kernel.dimension
    square, along = 0.0, 0.0
    for i in range(b - a):
        dq, dp = x[a + i] - z.q[a + i], x[n + a + i] - z.p[a + i]
        square += dq * dq + dp * dp
        along += at_q[i] * dq + at_p[i] * dp
    change = (kernel.energy(kernel.parameters, x[a:b], x[n + a:n + b])
              - kernel.energy(kernel.parameters, z.q[a:b], z.p[a:b]))
    return (change - along) / square if square > 0.0 else 0.0


@inlined
def fill_middle(problem: EndProblem, x: np.ndarray) -> None:
    """Fill the mean of the old state and x."""
    z, n, middle = problem.z, problem.z.q.size, problem.middle
    for i in range(n):
        middle[i], middle[n + i] = 0.5 * (z.q[i] + x[i]), 0.5 * (z.p[i] + x[n + i])


@inlined
def fill_end(problem: EndProblem, value: np.ndarray) -> None:
    """Fill value with the state that the rates lead to."""
    z, n, h = problem.z, problem.z.q.size, problem.h
    for i in range(n):
        value[i] = z.q[i] + (z.q_carry[i] + h * problem.rates[i])
        value[n + i] = z.p[i] + (z.p_carry[i] + h * problem.rates[n + i])


@inlined
def _set_scale(scale: np.ndarray, kernel: Kernel, h: float, z: PhasePoint) -> None:
    """Set the scale of q and p of each trajectory, including the rounding error of H."""
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
def _equation(problem: EndProblem, x: np.ndarray, value: np.ndarray) -> None:
    kernel, z, n = problem.kernel, problem.z, problem.z.q.size
    d, middle, rates = kernel.dimension, problem.middle, problem.rates
    at_q, at_p = problem.dH_dq, problem.dH_dp
    fill_middle(problem, x)
    kernel.gradient(kernel.parameters, middle[:n], middle[n:], at_q, at_p)
    for a in range(0, n, d):
        factor = discrete_factor(problem, x, a, at_q[a:a + d], at_p[a:a + d])
        for i in range(a, a + d):
            rates[i] = at_p[i] + factor * (x[n + i] - z.p[i])
            rates[n + i] = -(at_q[i] + factor * (x[i] - z.q[i]))
    fill_end(problem, value)


class DiscreteGradient(EnergyConserving):
    """
    Midpoint discrete gradient D of Gonzalez: z_(n+1) = z_n + h J D(z_n, z_(n+1)).

        D(z, z') = g + (H(z') - H(z) - g . (z' - z)) / |z' - z|^2 (z' - z),  g = H'((z + z')/2)

    Since D . (z' - z) = H(z') - H(z), the energy is conserved up to the rounding of H. Symmetric,
    of order 2, not symplectic: use it if the energy must be exact. DGNet is trained through it.

    References
    ----------
    O. Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Sci. 6 (1996).
    T. Matsubara, A. Ishikawa, T. Yaguchi, Deep energy-based modeling of discrete-time physics,
    NeurIPS 2020.

    """

    requirements = Requirements(symmetric=True, symplectic=False, forces=False)
    step = staticmethod(step_to_end(_set_scale, _equation))
