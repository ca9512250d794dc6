# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The adjoint of the symplectic Euler method on a group."""

from hnn_vi_ros.integrators.base import Point
from hnn_vi_ros.integrators.lie.base import LieIntegrator
from hnn_vi_ros.integrators.lie.equations import GroupWork, LieOptions, solve_turns, transport
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined


class LieSymplecticEulerAdjoint(LieIntegrator):
    """
    Symplectic Euler for rotations, implicit in the attitude: the adjoint of LieSymplecticEuler.

        g_(k+1) = g_k tau(h xi),  xi = H_mu(g_(k+1), mu),  (dtau^-1_(h xi))^* mu = pi_k
        pi_(k+1) = (dtau^-1_(-h xi))^* mu - h g_(k+1)^* H_g(g_(k+1), mu)

    Symplectic, order 1, not symmetric. Where H does not depend on g it keeps the spatial momentum.
    """

    order = 1
    requirements = Requirements(symmetric=False, symplectic=True, coordinates='group')

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: Point, z1: Point,
             memory: tuple[GroupWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        outcome, residual, gradients = solve_turns(kernel, h, options, z, z1, memory[0])
        transport(kernel, h, z, memory[0], z1)
        return outcome, residual, gradients
