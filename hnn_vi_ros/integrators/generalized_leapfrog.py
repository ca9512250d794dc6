# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Generalised leapfrog: the Störmer-Verlet method for a general Hamiltonian."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import LEAPFROG, leapfrog_energy, OK, PhasePoint, Requirements
from hnn_vi_ros.integrators.equations import (
    EquationInputs, EquationOutputs, EquationWork, HalfwayWork, solve_coordinates, solve_momenta)
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import SolverOptions
from hnn_vi_ros.integrators.symplectic_euler import SymplecticEuler, SymplecticEulerAdjoint
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np

# Compiled code can refer to functions, but not to the classes that contain them.
_adjoint_step = SymplecticEulerAdjoint.step


@inlined
def _second_half(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
                 memory: tuple[EquationWork, HalfwayWork]) -> tuple[int, float, int]:
    """Take a step of the adjoint, with the workspace of the second equation."""
    return _adjoint_step(kernel, h, options, z, z1, memory[1:])


class GeneralizedLeapfrog(ImplicitIntegrator):
    """
    Half a step of SymplecticEuler, then half a step of its adjoint.

        p_half = p_n - (h/2) H_q(q_n, p_half)
        q_(n+1) = q_n + (h/2) (H_p(q_n, p_half) + H_p(q_(n+1), p_half))
        p_(n+1) = p_half - (h/2) H_q(q_(n+1), p_half)

    Symplectic, symmetric, order 2; the usual choice for a fast bounded energy. If H = T(p) + V(q),
    it is StormerVerlet. It nearly conserves the energy of leapfrog_energy, up to O(h^4).

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.3.

    """

    order, scalar, equations = 2, True, (1, 1)  # for the momenta and for the coordinates
    requirements = Requirements(symmetric=True, symplectic=True)
    halves = (SymplecticEuler.step, _second_half)
    modified_energy = staticmethod(leapfrog_energy)
    partitioned = LEAPFROG

    def memory(self, n: int, dtype: type = np.float64) -> tuple[EquationWork, HalfwayWork]:
        """Return the workspaces of the two equations."""
        first, second = (EquationWork.empty(n, dtype) for _ in range(2))
        return first, HalfwayWork(*second, *np.zeros((2, n), dtype))

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[EquationWork, HalfwayWork]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        half = 0.5 * h
        # z1.p holds the momentum at the middle of the step.
        outcome, residual, gradients = solve_momenta(
            kernel, half, EquationInputs(z.q, z.p, z.p_carry, z.dH_dq),
            EquationOutputs(z1.p, z1.p_carry, z1.dH_dq, z1.dH_dp), memory[0], options)
        if outcome != OK:
            return outcome, residual, gradients
        half_q, half_carry = memory[1].half_q, memory[1].half_carry
        for i in range(z.q.size):
            half_q[i], half_carry[i] = plus(z.q[i], z.q_carry[i], half * z1.dH_dp[i])
        outcome, residual_q, more = solve_coordinates(
            kernel, half, EquationInputs(z1.p, half_q, half_carry, z1.dH_dp),
            EquationOutputs(z1.q, z1.q_carry, z1.dH_dq, z1.dH_dp), memory[1], options)
        for i in range(z.q.size):
            z1.p[i], z1.p_carry[i] = plus(z1.p[i], z1.p_carry[i], -half * z1.dH_dq[i])
        return outcome, max(residual, residual_q), gradients + more
