# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of methods that solve an equation in each step."""

from hnn_vi_ros.hamiltonians import check_between
from hnn_vi_ros.integrators.base import Integrator, Requirements
from hnn_vi_ros.integrators.equations import EquationWork
from hnn_vi_ros.integrators.newton_solver import continuation, krylov, newton
from hnn_vi_ros.integrators.solvers import anderson, fixed_point, secant, SolverOptions
from hnn_vi_ros.integrators.workspaces import FAST_MATRIX, LARGEST_MATRIX
import numpy as np

SOLVERS = ('chain', 'fixed_point')
_MAX_NEWTON_ITERATIONS = 20
_MAX_ITERATIONS = 10_000
# Evaluations needed to solve an equation to round-off from an extrapolated initial guess: 4 to 6
# by the secant method, up to about ten by Anderson's method.
_USUAL_ITERATIONS = 10
NO_SOLUTION_OF_EQ_6 = ('eq. (6) has no solution connected to h = 0 here: '
                       'det(I + h H_qp) changes sign on the way')


class ImplicitIntegrator(Integrator):
    """
    A method whose step solves equations of n unknowns each, unless ``equations`` differs.

    The chain of solvers starts from an extrapolated guess, with the secant method if the unknowns
    are independent, the simplified Newton method for Gauss methods with few coordinates, or
    Anderson's method otherwise. If these fail, Newton's method follows: with a Jacobian up to 128
    unknowns, without one beyond, and with one again, up to 512 unknowns, if that fails. Then
    follows ``on_failure``, see Rescue. If ``no_solution`` is set, a step of up to 128 unknowns
    that does not converge fast is solved by continuation from h = 0, so that the choice among
    several solutions does not depend on earlier steps.

    Parameters
    ----------
    solver : str
        ``'chain'``, or ``'fixed_point'`` for only the paper's iteration.
    max_iterations : int
        Maximum number of fixed-point iterations, accelerated or not.

    Raises
    ------
    ValueError
        An unknown solver, or fewer than one iteration.

    """

    explicit, fallback = False, 'generalized_leapfrog'
    # True if a trajectory of one coordinate has an equation of one unknown.
    scalar = False
    equations: tuple[int, ...] = (1,)

    def __init__(self, solver: str = 'chain', max_iterations: int = 100):
        if solver not in SOLVERS:
            raise ValueError(f'solver = {solver!r}; valid: {", ".join(SOLVERS)}')
        check_between(1, _MAX_ITERATIONS, max_iterations=max_iterations)
        self.solver, self.max_iterations = solver, max_iterations
        if solver == 'fixed_point':
            # Started from the state, it converges to the same solution each time, or to none.
            self.no_solution = self.fallback = ''

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts in order: 0 fast, 1 Newton, 2 without a matrix, 3 continuation."""
        if self.solver == 'fixed_point':
            return (0,)
        most = max(self.unknowns(n))
        if most <= FAST_MATRIX:
            return (0, 3, 1) if self.no_solution else (0, 1)
        return (0, 2, 1) if most <= LARGEST_MATRIX else (0, 2)

    @property
    def usual_gradients(self) -> int:
        """Return the usual number of gradients, ten for each equation."""
        return _USUAL_ITERATIONS * len(self.unknowns(1))

    def options(self, attempt: int = 0, dimension: int = 1) -> SolverOptions:
        """Return the solver options of an attempt of the chain."""
        if self.solver == 'fixed_point':
            return SolverOptions(fixed_point, False, self.max_iterations)
        if attempt > 0:
            solve = (newton, krylov, continuation)[attempt - 1]
            return SolverOptions(solve, attempt < 3, _MAX_NEWTON_ITERATIONS)
        solve = secant if self.scalar and dimension == 1 else anderson
        return SolverOptions(solve, True, self.max_iterations, bool(self.no_solution))


class EulerIntegrator(ImplicitIntegrator):
    """A symplectic method of order 1 that solves one equation, for momenta or coordinates."""

    order, scalar = 1, True
    requirements = Requirements(symmetric=False, symplectic=True)

    def memory(self, n: int, dtype: type = np.float64) -> tuple[EquationWork]:
        """Return the workspace of the equation."""
        return (EquationWork.empty(n, dtype),)
