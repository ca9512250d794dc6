# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Symplectic Euler, which is the paper's scheme in the staggered state, and its adjoint."""

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import euler_energy, PhasePoint, tableau
from hnn_vi_ros.integrators.equations import (
    EquationInputs, EquationOutputs, EquationWork, HalfwayWork, solve_coordinates, solve_momenta)
from hnn_vi_ros.integrators.implicit import EulerIntegrator, NO_SOLUTION_OF_EQ_6
from hnn_vi_ros.integrators.solvers import SolverOptions
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


class SymplecticEuler(EulerIntegrator):
    """
    Symplectic Euler, implicit in the momentum, from the action of the paper's scheme.

        p_(n+1) = p_n - h H_q(q_n, p_(n+1))
        q_(n+1) = q_n + h H_p(q_n, p_(n+1))

    With the momentum P_n = p_(n-1) of VariationalEuler it is that scheme, in the pair (q_n,
    p_(n-1)). Symplectic, order 1, not symmetric; it nearly conserves H - (h / 2) H_q . H_p. Its
    adjoint is SymplecticEulerAdjoint. Use `generalized_leapfrog`, which composes both.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.3.

    """

    no_solution = NO_SOLUTION_OF_EQ_6
    partitioned = tableau([[0]], [[1]], [1], [1])  # the stage is (q_n, p_(n+1))

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[EquationWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        outcome, residual, gradients = solve_momenta(
            kernel, h, EquationInputs(z.q, z.p, z.p_carry, z.dH_dq),
            EquationOutputs(z1.p, z1.p_carry, z1.dH_dq, z1.dH_dp), memory[0], options)
        for i in range(z.q.size):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
        return outcome, residual, gradients

    @staticmethod
    def modified_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                        energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                        ) -> np.ndarray:
        """Return H - (h / 2) H_q . H_p [J], conserved up to O(h^2)."""
        return euler_energy(hamiltonian, -h, q, p, energy, dH_dq, dH_dp)


class SymplecticEulerAdjoint(EulerIntegrator):
    """
    Symplectic Euler, implicit in the coordinate: the adjoint of SymplecticEuler.

        q_(n+1) = q_n + h H_p(q_(n+1), p_n)
        p_(n+1) = p_n - h H_q(q_(n+1), p_n)

    Symplectic, order 1, not symmetric; it nearly conserves H + (h / 2) H_q . H_p.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.3.

    """

    modified_energy = staticmethod(euler_energy)
    partitioned = tableau([[1]], [[0]], [1], [1])  # the stage is (q_(n+1), p_n)
    no_solution = ('the adjoint of eq. (6) has no solution connected to h = 0 here: '
                   'det(I - h H_qp) changes sign on the way')

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[EquationWork | HalfwayWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        outcome, residual, gradients = solve_coordinates(
            kernel, h, EquationInputs(z.p, z.q, z.q_carry, z.dH_dp),
            EquationOutputs(z1.q, z1.q_carry, z1.dH_dq, z1.dH_dp), memory[0], options)
        for i in range(z.q.size):
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z1.dH_dq[i])
        return outcome, residual, gradients
