# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid wall that a coordinate bounces off."""

from collections.abc import Sequence
from typing import Literal

from hnn_vi_ros.effects.base import coordinate_index, EffectState
from hnn_vi_ros.effects.stops import RigidContact, Stops
from hnn_vi_ros.hamiltonians import check_finite
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Impact(RigidContact):
    """
    A rigid wall at q_c = a: each impact changes the velocity v of the coordinate to -e v.

    Every impact in a step is located to round-off; only the momentum p_c jumps. With e < 1 the
    body comes to rest at the limit of the geometric series of its flights, until a force pulls it
    away. A step whose impacts cannot be resolved fails; `soft_wall` is a smooth alternative.
    Energy account: the change of H in the jump, 0 for e = 1 if H is quadratic in p.

    Parameters
    ----------
    coordinate : str
        The coordinate that the wall bounds.
    position : float
        a, in the coordinate's unit.
    side : str
        Side of free motion, ``'above'`` or ``'below'``.
    restitution : float
        e, from 0 to 1 [1].

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    R. Fetecau, J. Marsden, M. Ortiz, M. West, Nonsmooth Lagrangian mechanics and variational
    collision integrators, SIAM J. Appl. Dyn. Syst. 2 (2003).

    """

    beyond = 'behind the wall of an impact at'

    def __init__(self, coordinate: str, position: float = 0.0,
                 side: Literal['above', 'below'] = 'above', restitution: float = 1.0):
        check_finite(position=position)
        super().__init__(restitution)
        self.coordinate, self.position = coordinate, float(position)
        self.sign = {'above': 1.0, 'below': -1.0}[side]

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Stops:
        """Return the stop."""
        column = coordinate_index(coordinates, self.coordinate)
        return Stops.of(np.array([column]), np.array([self.position]), np.array([self.sign]),
                        self.restitution, state)
