# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The symplectic Euler method on a group: the paper's scheme in the staggered momentum."""

from hnn_vi_ros.integrators.base import Point
from hnn_vi_ros.integrators.lie.base import LieIntegrator
from hnn_vi_ros.integrators.lie.equations import (
    check_turns, clear, GroupWork, LieOptions, move, solve_momenta_inside, transport)
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined


class LieSymplecticEuler(LieIntegrator):
    """
    Symplectic Euler for rotations, implicit in the momentum; from the action of LieIntegrator.

        (dtau^-1_(h xi))^* mu = pi_k - h g_k^* H_g(g_k, mu),  xi = H_mu(g_k, mu)
        g_(k+1) = g_k tau(h xi),  pi_(k+1) = (dtau^-1_(-h xi))^* mu

    Its momentum pi_k is that of LieVariationalEuler carried over one step. It keeps the canonical
    2-form of (g, pi): symplectic, order 1, not symmetric. Its adjoint is
    LieSymplecticEulerAdjoint. Where H does not depend on g it keeps the spatial momentum.
    """

    order = 1
    requirements = Requirements(symmetric=False, symplectic=True, coordinates='group')

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: Point, z1: Point,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work = memory[0]
        clear(work.change)
        outcome, residual, gradients = solve_momenta_inside(
            kernel, h, options, z.q, z, z1, work)
        move(kernel, options.retraction, z, work.x, z1)
        transport(kernel, h, z, work, z1)
        outcome = check_turns(kernel, options.retraction, work.x, outcome)
        return outcome, residual, gradients
