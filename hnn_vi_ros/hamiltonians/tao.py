# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tao's non-separable Hamiltonian, the standard test for non-separable systems."""


from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate


class Tao(AnalyticHamiltonian):
    """
    H(q, p) = (q^2 + 1) (p^2 + 1) / 2, which is not separable.

    All quantities are dimensionless. Its orbits are closed, and its mixed derivative is 2 q p.

    References
    ----------
    M. Tao, Explicit symplectic approximation of nonseparable Hamiltonians: Algorithm and long
    time performance, Phys. Rev. E 94, 043303 (2016), section III.A.

    """

    coordinates = (Coordinate('x'),)
    separable = False
    names, formula = ('q',), '(q^2 + 1) * (p^2 + 1) / 2'
