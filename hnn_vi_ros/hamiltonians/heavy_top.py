# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A heavy top with a fixed point."""

from collections.abc import Sequence
from functools import partial

from hnn_vi_ros.hamiltonians.parameters import check_finite, check_positive
from hnn_vi_ros.hamiltonians.turning_body import spatial_component, spin, TurningBody


class HeavyTop(TurningBody):
    """
    A rigid body with a fixed point and its centre of mass on its third axis.

    H = sum of p_i^2 / (2 I_i) + m g l cos(theta), with p the angular momentum in the frame of the
    body, theta between its third axis and the vertical. With I_1 = I_2, Lagrange's top, p_3 is
    conserved besides H and the vertical component of the spatial angular momentum. Upright
    rotation is stable (sleeping top) if p_3^2 > 4 m g l I_1.

    Parameters
    ----------
    inertia : list of float
        Moments of inertia I_1, I_2, I_3 about the axes of the body through the point [kg m^2].
    mass : float
        m > 0 [kg].
    length : float
        l, from the point to the centre of mass [m]; negative for a hanging body.
    gravity : float
        g > 0 [m/s^2].

    Raises
    ------
    ValueError
        A constant is out of its range, or no body has these moments.

    References
    ----------
    H. Goldstein, Classical Mechanics, section 5.7.

    """

    separable = True

    def __init__(self, inertia: Sequence[float] = (1.0, 1.0, 0.5), mass: float = 1.0,
                 length: float = 0.5, gravity: float = 9.81):
        check_positive(mass=mass, gravity=gravity)
        check_finite(length=length)
        self.mass, self.length, self.gravity = float(mass), float(length), float(gravity)
        super().__init__(inertia, self.mass * self.gravity * self.length)
        # The vertical angular momentum [kg m^2/s], and the spin of a symmetric top.
        symmetric = self.inertia[0] == self.inertia[1]
        self.known_invariants = {'vertical_momentum': partial(spatial_component, 2),
                                 **({'spin': spin} if symmetric else {})}
