# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Explicit Runge-Kutta methods for comparison: Euler and the classical one."""

from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Integrator, OK, PhasePoint, Requirements, tableau
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


class Baseline(Integrator):
    """An explicit method for comparison, valid in any coordinates."""

    explicit = True
    requirements = Requirements(symmetric=False, symplectic=False, coordinates='any')


class ExplicitEuler(Baseline):
    """
    Explicit Euler: q_(n+1) = q_n + h H_p(q_n, p_n), p_(n+1) = p_n - h H_q(q_n, p_n).

    Order 1, not symplectic: each step multiplies the energy of the harmonic oscillator by 1 + (h
    omega)^2. It serves as a baseline; use `generalized_leapfrog` instead.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.1.

    """

    order, keeps_gradient = 1, True
    partitioned = tableau([[0]], [[0]], [1], [1])  # the stage is the state before

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        for i in range(z.q.size):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * z.dH_dp[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * z.dH_dq[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        return OK, 0.0, 1


class StageWork(NamedTuple):
    """
    Workspace of a step; arrays of shape (n,).

    Parameters
    ----------
    q, p : np.ndarray
        A stage.
    sum_q, sum_p : np.ndarray
        Weighted sums of the slopes of the previous stages.

    """

    q: np.ndarray
    p: np.ndarray
    sum_q: np.ndarray
    sum_p: np.ndarray


class RK4(Baseline):
    """
    The classical Runge-Kutta method of four stages and order 4.

    Neither symplectic nor symmetric: its energy drifts. A baseline; use `gauss4` instead.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.1.

    """

    order, keeps_gradient = 4, True
    partitioned = tableau(*2 * [np.diag([0.5, 0.5, 1.0], -1)],
                          *2 * [np.array([1.0, 2.0, 2.0, 1.0]) / 6.0])

    def memory(self, n: int, dtype: type = np.float64) -> tuple[StageWork]:
        """Return workspace for a stage and the sum over stages."""
        return (StageWork(*np.zeros((4, n), dtype)),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple[StageWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        n = z.q.size
        q, p, sum_q, sum_p = memory[0]
        for i in range(n):
            sum_q[i], sum_p[i] = z.dH_dp[i], -z.dH_dq[i]
            q[i], p[i] = z.q[i] + 0.5 * h * z.dH_dp[i], z.p[i] - 0.5 * h * z.dH_dq[i]
        for stage in range(1, 4):
            kernel.gradient(kernel.parameters, q, p, z1.dH_dq, z1.dH_dp)
            weight = 1.0 if stage == 3 else 2.0
            length = h if stage == 2 else 0.5 * h
            for i in range(n):
                sum_q[i] += weight * z1.dH_dp[i]
                sum_p[i] -= weight * z1.dH_dq[i]
                q[i], p[i] = z.q[i] + length * z1.dH_dp[i], z.p[i] - length * z1.dH_dq[i]
        for i in range(n):
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h / 6.0 * sum_q[i])
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], h / 6.0 * sum_p[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        return OK, 0.0, 4
