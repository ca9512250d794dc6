# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The variational integrator of the paper, its equation (6), for bodies that turn."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Point, TURNED
from hnn_vi_ros.integrators.lie.equations import (
    add_bend, clear, GroupWork, is_too_far, LieIntegrator, LieOptions, move, solve_momenta_inside)
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


class LieVariationalEuler(LieIntegrator):
    """
    Equation (6) of the paper on a group, from the action of LieIntegrator.

        g_(k+1) = g_k tau(h xi_k),  xi_k = H_mu(g_k, mu_k)
        (dtau^-1_(h xi_(k+1)))^* mu_(k+1)
            = (dtau^-1_(-h xi_k))^* mu_k - h g_(k+1)^* H_g(g_(k+1), mu_(k+1))

    The first equation is explicit; the second is solved for mu_(k+1), and the one gradient at the
    new state serves the next step as well. For scalar coordinates it is VariationalEuler.

    The map is LieSymplecticEuler in (g_k, pi_k) with pi_k = (dtau^-1_(-h xi_(k-1)))^* mu_(k-1); in
    (g_k, mu_k) it is conjugate to symplectic. Order 1, not symmetric.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Variational Integrator for Hamiltonian Neural Networks.
    N. Bou-Rabee, J. Marsden, Hamilton-Pontryagin integrators on Lie groups, part I, Found.
    Comput. Math. 9 (2009).

    """

    order = 1
    requirements = Requirements(symmetric=False, symplectic=True, coordinates='group')
    keeps_gradient = True

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: Point, z1: Point,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work = memory[0]
        for i in range(z.q.size):
            work.x[i] = h * z.dH_dp[i]
        if is_too_far(kernel, work.x):
            return TURNED, np.inf, 0
        move(kernel, options.retraction, z, work.x, z1)
        clear(work.change)
        add_bend(kernel, options.retraction, work.x, z.p, -1.0, work.change)
        outcome, residual, gradients = solve_momenta_inside(
            kernel, h, options, z1.q, z, z1, work)
        for i in range(z.p.size):
            work.change[i] -= h * work.slope[i]
            work.ahead[i] = 0.0
        add_bend(kernel, options.retraction, work.x, work.momenta, 1.0, work.ahead)
        for i in range(z.p.size):
            # What mu lacks of the right-hand side is kept in the carry.
            total, rest = plus(z.p[i], z.p_carry[i], work.change[i] - work.ahead[i])
            z1.p[i] = work.momenta[i]
            z1.p_carry[i] = rest + (total - z1.p[i])
        return outcome, residual, gradients
