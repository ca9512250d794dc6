# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hénon-Heiles system, in which order turns into chaos as the energy grows."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class HenonHeiles(Hamiltonian):
    """
    A star in a galaxy's plane, H(q, p) = (|p|^2 + |q|^2) / 2 + q_x^2 q_y - q_y^3 / 3.

    All quantities are without unit. Below H = 1/6 a star that starts inside the triangle with
    the corners (0, 1) and (+-sqrt(3) / 2, -1/2), the saddle points of the potential, stays
    there; above, it may escape through a corner. Most orbits are regular up to about H = 1/12,
    most are chaotic near 1/6.

    References
    ----------
    M. Hénon, C. Heiles, The applicability of the third integral of motion: some numerical
    experiments, Astron. J. 69, 73 (1964).

    """

    coordinates = (Coordinate('x'), Coordinate('y'))
    separable = True

    @property
    def barrier(self) -> tuple[str, float]:
        """Return what stars escape over, and its energy."""
        return 'escape barrier', 1.0 / 6.0

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        # In the triangle the terms of H_q are at most about one, also where they cancel.
        return compiled_kernel((_energy, _gradient, _hessian_vector), (),
                               self.dimension, (1.0, 0.0))


def _energy(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray) -> float:
    x, y = q[0], q[1]
    return (0.5 * (p[0] * p[0] + p[1] * p[1] + x * x + y * y)
            + x * x * y - y * y * y / 3.0)


def _gradient(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    for i in range(0, q.size, 2):
        x, y = q[i], q[i + 1]
        dH_dq[i] = x + 2.0 * x * y
        dH_dq[i + 1] = y + x * x - y * y
        dH_dp[i] = p[i]
        dH_dp[i + 1] = p[i + 1]


def _hessian_vector(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    for i in range(0, q.size, 2):
        x, y = q[i], q[i + 1]
        product_q[i] = (1.0 + 2.0 * y) * v_q[i] + 2.0 * x * v_q[i + 1]
        product_q[i + 1] = 2.0 * x * v_q[i] + (1.0 - 2.0 * y) * v_q[i + 1]
        product_p[i] = v_p[i]
        product_p[i + 1] = v_p[i + 1]
