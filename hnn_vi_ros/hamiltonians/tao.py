# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tao's non-separable Hamiltonian, the standard test of methods for such systems."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.straight_code import formula_kernel
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate


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
        return formula_kernel(['q'], '(q^2 + 1) * (p^2 + 1) / 2')
