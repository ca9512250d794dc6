# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The variational integrator of the paper, its equation (6)."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import euler_energy, PhasePoint, tableau
from hnn_vi_ros.integrators.equations import (
    EquationInputs, EquationOutputs, EquationWork, solve_momenta)
from hnn_vi_ros.integrators.implicit import EulerIntegrator, NO_SOLUTION_OF_EQ_6
from hnn_vi_ros.integrators.solvers import SolverOptions
from hnn_vi_ros.kernels import inlined, Kernel


class VariationalEuler(EulerIntegrator):
    """
    Variational integrator from the rectangle rule for the action of a general H(q, p).

    Discrete action: sum over n of p_n . (q_(n+1) - q_n) - h H(q_n, p_n). It is stationary,
    with q_0 and q_N fixed, where

        q_(n+1) = q_n + h H_p(q_n, p_n)
        p_(n+1) = p_n - h H_q(q_(n+1), p_(n+1))

    The first equation is explicit, the second is solved for p_(n+1); the gradient at the new state
    also serves the next step. It is the method of the paper; others are more accurate.

    The map is symplectic Euler in the staggered pair (q_n, p_(n-1)). In (q_n, p_n) it conserves
    the 2-form dq ^ d(p + h H_q), not dq ^ dp: it is conjugate to symplectic. It nearly
    conserves the modified energy H + (h / 2) H_q . H_p, up to O(h^2).

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Variational Integrator for Hamiltonian Neural Networks.
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.6.

    """

    modified_energy = staticmethod(euler_energy)
    no_solution = NO_SOLUTION_OF_EQ_6
    keeps_gradient = True
    # The stages are the state before and the state after.
    partitioned = tableau([[0, 0], [1, 0]], [[0, 0], [0, 1]], [1, 0], [0, 1])

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[EquationWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        for i in range(z.q.size):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z.dH_dp[i])
        # The paper starts from (q_n, p_n), whose gradient is available.
        return solve_momenta(kernel, h, EquationInputs(z1.q, z.p, z.p_carry, z.dH_dq),
                             EquationOutputs(z1.p, z1.p_carry, z1.dH_dq, z1.dH_dp), memory[0],
                             options)
