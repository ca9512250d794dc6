# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The classical Runge-Kutta method, a control."""

from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Integrator, OK, Point
from hnn_vi_ros.integrators.partitioned import PartitionedTableau
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


class StageWork(NamedTuple):
    """
    The workspace of a step; arrays of shape (n,).

    Parameters
    ----------
    q, p : np.ndarray
        A stage.
    sum_q, sum_p : np.ndarray
        The weighted sums of the slopes of the stages so far.

    """

    q: np.ndarray
    p: np.ndarray
    sum_q: np.ndarray
    sum_p: np.ndarray


class RK4(Integrator):
    """
    The classical Runge-Kutta method of four stages and order 4.

    Neither symplectic nor symmetric: its energy drifts, which is what it is here to show.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.1.

    """

    order, explicit = 4, True
    requirements = Requirements(symmetric=False, symplectic=False, coordinates='any')
    keeps_gradient = True

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return no options: nothing is solved."""
        return ()

    def memory(self, n: int, dtype: type = np.float64) -> tuple[StageWork]:
        """Return space for a stage and the sum over stages; see Integrator."""
        return (StageWork(*np.zeros((4, n), dtype)),)

    @property
    def partitioned(self) -> PartitionedTableau:
        """Return its four stages; see Integrator."""
        matrix = np.diag([0.5, 0.5, 1.0], -1)
        weights = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
        return PartitionedTableau(matrix, matrix, weights, weights)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
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
