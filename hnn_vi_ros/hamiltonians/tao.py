# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tao's non-separable Hamiltonian, the standard test of methods for such systems."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Tao(Hamiltonian):
    """
    H(q, p) = (q^2 + 1) (p^2 + 1) / 2, in which coordinate and momentum do not separate.

    All quantities are without unit. Its orbits are closed, and its mixed derivative is 2 q p.

    References
    ----------
    M. Tao, Explicit symplectic approximation of nonseparable Hamiltonians: Algorithm and long
    time performance, Phys. Rev. E 94, 043303 (2016), section III.A.

    """

    coordinates = (Coordinate('x'),)
    separable = False

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return compiled_kernel((_energy, _gradient, _hessian_vector), (), self.dimension)


def _energy(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray) -> float:
    return 0.5 * (q[0] * q[0] + 1.0) * (p[0] * p[0] + 1.0)


def _gradient(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    for i in range(q.size):
        dH_dq[i] = q[i] * (p[i] * p[i] + 1.0)
        dH_dp[i] = (q[i] * q[i] + 1.0) * p[i]


def _hessian_vector(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    for i in range(q.size):
        mixed = 2.0 * q[i] * p[i]
        product_q[i] = (p[i] * p[i] + 1.0) * v_q[i] + mixed * v_p[i]
        product_p[i] = mixed * v_q[i] + (q[i] * q[i] + 1.0) * v_p[i]
