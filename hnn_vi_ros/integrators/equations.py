# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The two implicit equations of the Euler-type methods: one for momenta, one for coordinates."""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import IN_DOUBT, OK
from hnn_vi_ros.integrators.solvers import (
    extrapolate, may_be_disconnected, SolverOptions, store_solution)
from hnn_vi_ros.integrators.workspaces import History, SolverWork
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


# Unknowns smaller than this count as zero: eps times it is the smallest normal number.
LEAST_SCALE = float(np.finfo(np.float64).tiny / np.finfo(np.float64).eps)


class EquationInputs(NamedTuple):
    """
    Inputs of an equation x = base + factor H_x(...); each array has shape (n,).

    Parameters
    ----------
    held : np.ndarray
        The other variable, which is constant in the equation.
    base, carry : np.ndarray
        The old values of x, and their rounding errors.
    slope : np.ndarray
        H_x, or its best estimate, for the initial guess.

    """

    held: np.ndarray
    base: np.ndarray
    carry: np.ndarray
    slope: np.ndarray


class EquationOutputs(NamedTuple):
    """
    Outputs of an equation; each array has shape (n,).

    Parameters
    ----------
    x, carry : np.ndarray
        The solution and its rounding error.
    dH_dq, dH_dp : np.ndarray
        The gradient at the solution.

    """

    x: np.ndarray
    carry: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray


class EquationWork(NamedTuple):
    """
    Workspace of one equation for momenta or for coordinates.

    Parameters
    ----------
    kept : History
        Earlier solutions.
    solver : SolverWork
        Arrays of the solvers.
    product_q, product_p : np.ndarray, shape (n,)
        Products with H''; on entry, the half of the factor that is zero.

    """

    kept: History
    solver: SolverWork
    product_q: np.ndarray
    product_p: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'EquationWork':
        """Return the workspace of an equation of n unknowns."""
        return cls(History.empty(n, dtype), SolverWork.empty(n, dtype), *np.zeros((2, n), dtype))


class HalfwayWork(NamedTuple):
    """
    Workspace of an equation that starts at the middle of a step.

    Parameters
    ----------
    kept, solver, product_q, product_p
        See EquationWork.
    half_q, half_carry : np.ndarray, shape (n,)
        The coordinates at the middle of the step, and their rounding errors.

    """

    kept: History
    solver: SolverWork
    product_q: np.ndarray
    product_p: np.ndarray
    half_q: np.ndarray
    half_carry: np.ndarray


class _EulerEquation(NamedTuple):
    """x = base + factor H_x(...), and arrays of shape (n,): held, and for products with H''."""

    kernel: Kernel
    factor: float
    known: EquationInputs
    sought: EquationOutputs
    base: np.ndarray
    held: np.ndarray
    product_q: np.ndarray
    product_p: np.ndarray


@inlined
def solve_momenta(kernel: Kernel, h: float, known: EquationInputs, sought: EquationOutputs,
                  work: EquationWork | HalfwayWork, options: SolverOptions
                  ) -> tuple[int, float, int]:
    """
    Solve p1 = p - h H_q(q, p1), and store the gradient at (q, p1).

    Parameters
    ----------
    kernel : Kernel
        The Hamiltonian.
    h : float
        Step size, or a part of it [s].
    known : Known
        q, p and H_q.
    sought : Sought
        Receives p1 and the gradient.
    work : EquationWork or HalfwayWork
        Workspace of this equation.
    options : SolverOptions
        Options of the solver.

    Returns
    -------
    tuple of (int, float, int)
        Outcome, relative residual [1], number of gradients.

    """
    return _solve(_momentum_equation, _momentum_tangent, _EulerEquation(
        kernel, -h, known, sought, known.base, work.solver.iterates.held, work.product_q,
        work.product_p), sought.dH_dq, 0, work, options)


@inlined
def solve_coordinates(kernel: Kernel, h: float, known: EquationInputs, sought: EquationOutputs,
                      work: EquationWork | HalfwayWork, options: SolverOptions
                      ) -> tuple[int, float, int]:
    """
    Solve q1 = q + h H_p(q1, p), and store the gradient at (q1, p).

    Parameters
    ----------
    kernel, h, work, options
        See solve_momenta.
    known : Known
        p, q and H_p.
    sought : Sought
        Receives q1 and the gradient.

    Returns
    -------
    tuple of (int, float, int)
        Outcome, relative residual [1], number of gradients.

    """
    return _solve(_coordinate_equation, _coordinate_tangent, _EulerEquation(
        kernel, h, known, sought, known.base, work.solver.iterates.held, work.product_q,
        work.product_p), sought.dH_dp, 1, work, options)


@inlined
def _solve(equation: Callable[..., None], tangent: Callable[..., None], problem: _EulerEquation,
           slope: np.ndarray, which: int, work: EquationWork | HalfwayWork,
           options: SolverOptions) -> tuple[int, float, int]:
    """Solve for the momenta (0) or the coordinates (1); ``slope`` becomes H_x at the solution."""
    kernel, known, base, x = problem.kernel, problem.known, problem.base, problem.sought.x
    iterates, matrix = work.solver.iterates, work.solver.newton.matrix
    for i in range(x.size):
        x[i] = base[i] + problem.factor * known.slope[i]
        problem.held[i] = known.held[i]
    set_scale(iterates.scale, iterates.own_scale, base, known.slope, problem.factor, kernel, which)
    if options.extrapolate:
        extrapolate(work.kept, base, x)
    outcome, residual, gradients = options.solve(
        equation, tangent, problem, x, work.solver, options.max_iterations)
    if outcome == OK and may_be_disconnected(
            options, iterates.first, matrix, gradients, kernel.dimension):
        return IN_DOUBT, residual, gradients
    if outcome == OK:
        store_solution(work.kept, base, x)
        # Store the rounding error of x = base + carry + factor * slope in the carry.
        for i in range(x.size):
            total, rest = plus(base[i], known.carry[i], problem.factor * slope[i])
            problem.sought.carry[i] = rest + (total - x[i])
    return outcome, residual, gradients


@inlined
def set_scale(scale: np.ndarray, own_scale: np.ndarray, base: np.ndarray, slope: np.ndarray,
              h: float, kernel: Kernel, which: int) -> None:
    """
    Set the scales of each unknown and of its trajectory from state, change and rounding.

    Parameters
    ----------
    scale, own_scale : np.ndarray, shape (n,)
        Outputs: scale of the largest unknown of the trajectory, and of each unknown.
    base, slope : np.ndarray, shape (n,)
        The old state and its rate of change.
    h : float
        Step size, or a part of it [s].
    kernel : Kernel
        The Hamiltonian.
    which : int
        0 for momenta, 1 for coordinates.

    """
    for start in range(0, base.size, kernel.dimension):
        end = start + kernel.dimension
        middle = end - kernel.channels
        rounding, size = abs(h) * kernel.gradient_scale[which], 0.0
        for i in range(start, middle):
            own = max(abs(base[i]), abs(h) * abs(slope[i]), rounding)
            if 0.0 < own < LEAST_SCALE:
                # A momentum brought to rest by friction decays until it underflows.
                own = LEAST_SCALE
            own_scale[i], size = own, max(size, own)
        for i in range(start, middle):
            scale[i] = size
        for i in range(middle, end):
            # The time in a channel is known. Nothing depends on its integral, so the residual of
            # that is ignored.
            scale[i] = abs(h) if which == 1 else np.inf
            own_scale[i] = scale[i]


def _equation_of(which: int) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the equation for the momenta (0) or the coordinates (1), and its tangent."""
    @inlined
    def equation(problem: _EulerEquation, x: np.ndarray, value: np.ndarray) -> None:
        q, p = (problem.held, x) if which == 0 else (x, problem.held)
        dH_dq, dH_dp = problem.sought.dH_dq, problem.sought.dH_dp
        problem.kernel.gradient(problem.kernel.parameters, q, p, dH_dq, dH_dp)
        slope = dH_dq if which == 0 else dH_dp
        for i in range(x.size):
            value[i] = plus(problem.base[i], problem.known.carry[i], problem.factor * slope[i])[0]

    @inlined
    def tangent(problem: _EulerEquation, x: np.ndarray, v: np.ndarray, product: np.ndarray
                ) -> None:
        kernel = problem.kernel
        zero, rest = problem.product_q, problem.product_p
        for i in range(x.size):
            zero[i] = 0.0
        if which == 0:
            kernel.hessian_vector(kernel.parameters, problem.held, x, zero, v, product, rest)
        else:
            kernel.hessian_vector(kernel.parameters, x, problem.held, v, zero, rest, product)
        for i in range(x.size):
            product[i] *= problem.factor

    return equation, tangent


_momentum_equation, _momentum_tangent = _equation_of(0)
_coordinate_equation, _coordinate_tangent = _equation_of(1)
