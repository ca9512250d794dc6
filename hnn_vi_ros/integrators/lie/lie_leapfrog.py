# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One-step methods on a group: eq. (6), symplectic Euler, its adjoint, and the leapfrog."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import OK, PhasePoint, PointWork, Requirements, TURNED
from hnn_vi_ros.integrators.lie.equations import (
    add_bend, check_turns, FURTHEST, GroupWork, LieIntegrator, LieOptions, move,
    solve_momenta_inside, solve_turns, transport, turns_beyond)
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


class LieVariationalEuler(LieIntegrator):
    """
    Equation (6) of the paper on a group, from the action of LieIntegrator.

        g_(k+1) = g_k tau(h xi_k),  xi_k = H_mu(g_k, mu_k)
        (dtau^-1_(h xi_(k+1)))^* mu_(k+1)
            = (dtau^-1_(-h xi_k))^* mu_k - h g_(k+1)^* H_g(g_(k+1), mu_(k+1))

    The first equation is explicit; the second is solved for mu_(k+1), and the gradient at the new
    state also serves the next step. For scalar coordinates it is VariationalEuler.

    In (g_k, pi_k) with pi_k = (dtau^-1_(-h xi_(k-1)))^* mu_(k-1) the map is LieSymplecticEuler; in
    (g_k, mu_k) it is conjugate to symplectic. Order 1, not symmetric: use `lie_leapfrog` instead.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Variational Integrator for Hamiltonian Neural Networks.
    N. Bou-Rabee, J. Marsden, Hamilton-Pontryagin integrators on Lie groups, part I, Found.
    Comput. Math. 9 (2009).

    """

    keeps_gradient = True

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work = memory[0]
        for i in range(z.q.size):
            work.x[i] = h * z.dH_dp[i]
        if turns_beyond(kernel, work.x, FURTHEST):
            return TURNED, np.inf, 0
        move(kernel, options.retraction, z, work.x, z1)
        work.change[:] = 0.0
        add_bend(kernel, options.retraction, work.x, z.p, -1.0, work.change)
        outcome, residual, gradients = solve_momenta_inside(kernel, h, options, z1.q, z, z1, work)
        for i in range(z.p.size):
            work.change[i] -= h * work.slope[i]
            work.ahead[i] = 0.0
        add_bend(kernel, options.retraction, work.x, work.momenta, 1.0, work.ahead)
        for i in range(z.p.size):
            # The difference of mu to the right-hand side is kept in the carry.
            total, rest = plus(z.p[i], z.p_carry[i], work.change[i] - work.ahead[i])
            z1.p[i] = work.momenta[i]
            z1.p_carry[i] = rest + (total - z1.p[i])
        return outcome, residual, gradients


class LieSymplecticEuler(LieIntegrator):
    """
    Symplectic Euler for rotations, implicit in the momentum, from the action of LieIntegrator.

        (dtau^-1_(h xi))^* mu = pi_k - h g_k^* H_g(g_k, mu),  xi = H_mu(g_k, mu)
        g_(k+1) = g_k tau(h xi),  pi_(k+1) = (dtau^-1_(-h xi))^* mu

    The momentum pi_k is that of LieVariationalEuler, transported over one step. It preserves the
    canonical 2-form of (g, pi): symplectic, order 1, not symmetric, with the adjoint
    LieSymplecticEulerAdjoint. If H does not depend on g, spatial momentum is conserved.
    """

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work = memory[0]
        work.change[:] = 0.0
        outcome, residual, gradients = solve_momenta_inside(kernel, h, options, z.q, z, z1, work)
        move(kernel, options.retraction, z, work.x, z1)
        transport(kernel, h, z, work, z1)
        outcome = check_turns(kernel, options.retraction, work.x, outcome)
        return outcome, residual, gradients


class LieSymplecticEulerAdjoint(LieIntegrator):
    """
    Symplectic Euler for rotations, implicit in the attitude: the adjoint of LieSymplecticEuler.

        g_(k+1) = g_k tau(h xi),  xi = H_mu(g_(k+1), mu),  (dtau^-1_(h xi))^* mu = pi_k
        pi_(k+1) = (dtau^-1_(-h xi))^* mu - h g_(k+1)^* H_g(g_(k+1), mu)

    Symplectic, order 1, not symmetric. If H does not depend on g, spatial momentum is conserved.
    """

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        outcome, residual, gradients = solve_turns(kernel, h, options, z, z1, memory[0])
        transport(kernel, h, z, memory[0], z1)
        return outcome, residual, gradients


# Compiled code can refer to functions, but not to the classes that contain them.
_first_step, _second_step = LieSymplecticEuler.step, LieSymplecticEulerAdjoint.step


class LieLeapfrog(LieIntegrator):
    """
    Half a step of LieSymplecticEuler, then half a step of its adjoint.

    Symplectic, symmetric, order 2, for any H; for scalar coordinates it is GeneralizedLeapfrog. If
    H is separable use `lie_stormer_verlet`. Spatial momentum is kept if H does not depend on g.
    """

    order, equations = 2, (1, 1)  # for the momenta and for the rotations
    requirements = Requirements(symmetric=True, symplectic=True, coordinates='group')

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of the two equations, and the point between them."""
        return (GroupWork.empty(n, dtype), GroupWork.empty(n, dtype),
                PointWork(PhasePoint.empty(n, dtype)))

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        middle = memory[2].point
        outcome, residual, gradients = _first_step(kernel, 0.5 * h, options, z, middle, memory[:1])
        if outcome != OK:
            return outcome, residual, gradients
        outcome, residual_turn, more = _second_step(
            kernel, 0.5 * h, options, middle, z1, memory[1:])
        return outcome, max(residual, residual_turn), gradients + more
