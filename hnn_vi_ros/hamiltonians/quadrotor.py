# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A flying rigid body."""

from collections.abc import Sequence
from functools import partial

from hnn_vi_ros.hamiltonians.parameters import check_not_negative, check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.hamiltonians.turning_body import moments, spatial_component
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


def _momentum(i: int, q: np.ndarray, p: np.ndarray) -> float:
    return float(p[i])


class Quadrotor(AnalyticHamiltonian):
    """
    A rigid body with its weight, H = |p|^2 / (2 m) + sum of L_i^2 / (2 I_i) + m g z.

    q is the position of its centre of mass, z upwards, then its attitude; the momenta are p in
    space, then the angular momentum L in the frame of the body. Rotors are not part of H: the
    effect ``external_force`` accepts their thrust and torques as commands.

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    inertia : list of float
        Moments of inertia I_1, I_2, I_3 about the axes of the body [kg m^2].
    gravity : float
        g >= 0 [m/s^2]; 0 for a body in free space.

    Raises
    ------
    ValueError
        A constant is out of its range, or no body has these moments.

    References
    ----------
    T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE
    CDC 2010.

    """

    separable = True
    # The horizontal momentum [kg m/s], and the spatial angular momentum [kg m^2/s].
    known_invariants = {
        **{f'momentum_{axis}': partial(_momentum, i) for i, axis in enumerate('xy')},
        **{f'spin_{axis}': partial(spatial_component, i) for i, axis in enumerate('xyz')}}
    coordinates = (Coordinate('body', 'm', 'kg m/s', 'pose'),)
    names = ('x', 'y', 'z', 'a', 'b', 'c', 'd')  # the last four are a quaternion
    formula = ('(p_x^2 + p_y^2 + p_z^2) / (2 * m)'
               '+ (p_a^2 / I1 + p_b^2 / I2 + p_c^2 / I3) / 2 + weight * z')

    def __init__(self, mass: float = 0.8, inertia: Sequence[float] = (0.006, 0.006, 0.011),
                 gravity: float = 9.81):
        check_positive(mass=mass)
        check_not_negative(gravity=gravity)
        self.mass, self.weight = float(mass), float(mass) * float(gravity)
        self.inertia = tuple(float(value) for value in inertia)
        self.constants = {'m': self.mass, 'weight': self.weight, **moments(inertia)}
