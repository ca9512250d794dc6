# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Explicit Störmer-Verlet method for separable Hamiltonians."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import (
    Integrator, LEAPFROG, leapfrog_energy, OK, PhasePoint, Requirements)
from hnn_vi_ros.kernels import inlined, Kernel


@inlined
def _first_half(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
                memory: tuple) -> tuple[int, float, int]:
    """Take the kick and the drift of a step of 2 h."""
    for i in range(z.q.size):
        z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z.dH_dq[i])
    kernel.gradient(kernel.parameters, z.q, z1.p, z1.dH_dq, z1.dH_dp)
    for i in range(z.q.size):
        z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z1.dH_dq[i])
        z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
    return OK, 0.0, 1


@inlined
def _second_half(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
                 memory: tuple) -> tuple[int, float, int]:
    """Take the drift and the kick of a step of 2 h."""
    kernel.gradient(kernel.parameters, z.q, z.p, z1.dH_dq, z1.dH_dp)
    for i in range(z.q.size):
        z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
    kernel.gradient(kernel.parameters, z1.q, z.p, z1.dH_dq, z1.dH_dp)
    for i in range(z.q.size):
        z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z1.dH_dq[i])
    return OK, 0.0, 2


class StormerVerlet(Integrator):
    """
    Störmer-Verlet (leapfrog) for H(q, p) = T(p) + V(q).

        p_half = p_n - (h/2) V'(q_n),  q_(n+1) = q_n + h T'(p_half),
        p_(n+1) = p_half - (h/2) V'(q_(n+1))

    Symplectic, symmetric, order 2, stable for h omega < 2; it nearly conserves the energy of
    leapfrog_energy, up to O(h^4). Explicit and fast. A Hamiltonian that is not separable, such as
    a general network, is refused: the order would fall to 1. Use `generalized_leapfrog` there.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.1.

    """

    order, explicit, halves = 2, True, (_first_half, _second_half)
    requirements = Requirements(symmetric=True, symplectic=True, separable=True)
    modified_energy = staticmethod(leapfrog_energy)
    partitioned = LEAPFROG

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        # V' does not depend on p: z.dH_dq is V'(q_n) of the previous step.
        for i in range(z.q.size):
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -0.5 * h * z.dH_dq[i])
        kernel.gradient(kernel.parameters, z.q, z1.p, z1.dH_dq, z1.dH_dp)
        for i in range(z.q.size):
            # The momenta are the same; but the power of a force, in a channel, depends on p.
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -0.5 * h * z1.dH_dq[i])
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z1.dH_dp[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        for i in range(z.q.size):
            z1.p[i], z1.p_carry[i] = plus(z1.p[i], z1.p_carry[i], -0.5 * h * z1.dH_dq[i])
        return OK, 0.0, 2
