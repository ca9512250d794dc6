# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The way from the staggered pair (q_n, p_(n-1)) to the state (q_n, p_n) of eq. (6)."""

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.base import Memory, Point
from hnn_vi_ros.integrators.equations import solve_momenta
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import SolverOptions


class StaggeredMomentum(ImplicitIntegrator):
    """
    The momentum half A of eq. (6): (q, P) -> (q, p) with p = P - h H_q(q, p).

    Eq. (6) is A o Psi o A^-1, with Psi the symplectic Euler method. Where there is no such p, the
    new point holds the last one on the way from h = 0.
    """

    order, symmetric, symplectic = 0, False, False

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: SolverOptions, z: Point, z1: Point,
             memory: tuple[Memory, ...]) -> tuple[int, float, int]:
        """Take the way; see Integrator."""
        for i in range(z.q.size):
            z1.q[i], z1.q_carry[i] = z.q[i], z.q_carry[i]
        return solve_momenta(kernel, h, z.q, z.p, z.p_carry, z.dH_dq, z1.p, z1.p_carry,
                             z1.dH_dq, z1.dH_dp, memory[0], options)
