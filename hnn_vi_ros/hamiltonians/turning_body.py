# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of a rigid body that rotates about a point, in a uniform field or in none."""

from collections.abc import Sequence

from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


def moments(inertia: Sequence[float]) -> dict[str, float]:
    """Return the moments of inertia of a body about principal axes, or raise ValueError."""
    if len(inertia) != 3:
        raise ValueError(f'inertia has {len(inertia)} values, expected 3 about principal axes')
    check_positive(**{f'inertia[{i}]': value for i, value in enumerate(inertia)})
    if 2.0 * max(inertia) > sum(inertia) * (1.0 + 1e-12):
        raise ValueError(f'inertia = {list(inertia)}: the largest moment must not exceed the sum '
                         'of the other two')
    return {f'I{i}': float(value) for i, value in enumerate(inertia, 1)}


def spatial_momentum(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return R p of shape (..., 3), for quaternions (x, y, z, w) and p in the body's frame."""
    vector, scalar = q[..., :3], q[..., 3:4]
    twice = 2.0 * np.cross(vector, p)
    return p + scalar * twice + np.cross(vector, twice)


def spatial_component(axis: int, q: np.ndarray, p: np.ndarray) -> float:
    """Return a spatial component of the angular momentum of a body; q ends with its attitude."""
    return float(spatial_momentum(q[-4:], p[-3:])[axis])


def spin(q: np.ndarray, p: np.ndarray) -> float:
    """Return the angular momentum of a body about its third axis."""
    return float(p[2])


class TurningBody(AnalyticHamiltonian):
    """
    H = sum of p_i^2 / (2 I_i) + m g l e_z . R e_3, with p the angular momentum in the body.

    Parameters
    ----------
    inertia : sequence of float
        I1, I2, I3 about the body's axes [kg m^2].
    moment : float
        m g l [N m], with the centre of mass at l on the third axis; 0 for no weight.

    """

    coordinates = (Coordinate('attitude', '1', 'kg m2/s', 'rotation'),)
    names = ('x', 'y', 'z', 'w')
    formula = ('(p_x^2 / I1 + p_y^2 / I2 + p_z^2 / I3) / 2'
               '+ moment * (w^2 + z^2 - x^2 - y^2)')

    def __init__(self, inertia: Sequence[float], moment: float):
        self.moment, self.constants = moment, {**moments(inertia), 'moment': moment}
        self.inertia = tuple(float(value) for value in inertia)
