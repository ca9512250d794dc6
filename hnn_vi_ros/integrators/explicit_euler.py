# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The explicit Euler method, the paper's baseline."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Integrator, OK, Point
from hnn_vi_ros.integrators.partitioned import PartitionedTableau, tableau
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined


class ExplicitEuler(Integrator):
    """
    Explicit Euler: q_(n+1) = q_n + h H_p(q_n, p_n), p_(n+1) = p_n - h H_q(q_n, p_n).

    It is of order 1 and not symplectic: each step multiplies the energy of the harmonic
    oscillator by 1 + (h omega)^2. It is here to be compared with.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.1.

    """

    order, explicit = 1, True
    requirements = Requirements(symmetric=False, symplectic=False, coordinates='any')
    keeps_gradient = True

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return no options: nothing is solved."""
        return ()

    @property
    def partitioned(self) -> PartitionedTableau:
        """Return its stage, the state before; see Integrator."""
        return tableau([[0]], [[0]], [1], [1])

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        for i in range(z.q.size):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z.dH_dp[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z.dH_dq[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        return OK, 0.0, 1
