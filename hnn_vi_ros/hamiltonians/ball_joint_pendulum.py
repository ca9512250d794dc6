# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A ball on a rod that hangs from a ball joint."""

from functools import partial

from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.turning_body import spatial_component, spin, TurningBody


class BallJointPendulum(TurningBody):
    """
    A spherical pendulum described by its attitude: a ball on a massless rod, on a ball joint.

    H = sum of p_i^2 / (2 I_i) - m g l cos(theta), with p the angular momentum in the frame of the
    body, theta between the rod and the downward vertical, I_1 = I_2 = m l^2 + I_3 about the joint,
    and I_3 = 2 m r^2 / 5. The rod is the third axis of the body; the ball is at the bottom if that
    axis points up. Unlike a point on a sphere it can spin about the rod; without spin it moves
    like a spherical pendulum of length I_1 / (m l). Its spin p_3 and the vertical component of the
    spatial angular momentum are conserved.

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    length : float
        l > 0, from the joint to the middle of the ball [m].
    radius : float
        r > 0 of the ball [m].
    gravity : float
        g > 0 [m/s^2].

    Raises
    ------
    ValueError
        A constant is not a positive number.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, sections 14 and 35.

    """

    # The vertical angular momentum and the spin [kg m^2/s].
    known_invariants = {'vertical_momentum': partial(spatial_component, 2), 'spin': spin}

    def __init__(self, mass: float = 1.0, length: float = 1.0, radius: float = 0.1,
                 gravity: float = 9.81):
        check_positive(mass=mass, length=length, radius=radius, gravity=gravity)
        own = 0.4 * float(mass) * float(radius) ** 2
        across = float(mass) * float(length) ** 2 + own
        super().__init__((across, across, own), -float(mass) * float(gravity) * float(length))
