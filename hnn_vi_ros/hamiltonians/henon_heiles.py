# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hénon-Heiles system, whose motion becomes chaotic with increasing energy."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import Coordinate


class HenonHeiles(AnalyticHamiltonian):
    """
    A star in the plane of a galaxy, H(q, p) = (|p|^2 + |q|^2) / 2 + q_x^2 q_y - q_y^3 / 3.

    All quantities are dimensionless. Below H = 1/6 a star that starts inside the triangle with the
    corners (0, 1) and (+-sqrt(3) / 2, -1/2), the saddle points of the potential, stays there;
    above, it may escape through a corner. Most orbits are regular up to about H = 1/12, and most
    are chaotic near 1/6.

    References
    ----------
    M. Hénon, C. Heiles, The applicability of the third integral of motion: some numerical
    experiments, Astron. J. 69, 73 (1964).

    """

    coordinates = (Coordinate('x'), Coordinate('y'))
    separable = True

    barrier = 'escape barrier', 1.0 / 6.0
    names, formula = ('x', 'y'), '(p_x^2 + p_y^2 + x^2 + y^2) / 2 + x^2 * y - y^3 / 3'

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        # In the triangle the terms of H_q are at most about one, even if they cancel.
        return super().kernel._replace(gradient_scale=(1.0, 0.0))
