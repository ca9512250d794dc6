# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid stops at the limits of joints."""

from collections.abc import Sequence
from typing import Literal

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.effects.joints import check_joint_numbers, joint_numbers
from hnn_vi_ros.effects.stops import RigidContact, Stops
from hnn_vi_ros.hamiltonians import check_finite
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class JointLimits(RigidContact):
    """
    Rigid stops at the limits of joints: each impact changes the velocity v to -e v.

    Every impact in a step is located to round-off. With e < 1 joints come to rest on their stops
    and are held there together, until a force pulls them away. The URDF's limits of velocity and
    effort belong to motors and are ignored. For one wall of a coordinate use `impact`. Energy
    account: the change of H in the jumps, 0 for e = 1.

    Parameters
    ----------
    from_ : str, optional
        urdf: the limits of all joints in the URDF of H; continuous joints have none, and a missing
        limit next to a given one is 0.
    lower, upper : dict of str to float, optional
        Limits by coordinate, in addition to the URDF's values or replacing them [rad], [m].
    restitution : float
        e, from 0 to 1 [1].

    Raises
    ------
    ValueError
        No limits are given, or a number cannot be a limit.

    References
    ----------
    R. Fetecau, J. Marsden, M. Ortiz, M. West, Nonsmooth Lagrangian mechanics and variational
    collision integrators, SIAM J. Appl. Dyn. Syst. 2 (2003).

    """

    limits, beyond = True, 'beyond the limit'

    def __init__(self, from_: Literal['urdf'] | None = None,
                 lower: dict[str, float] | None = None, upper: dict[str, float] | None = None,
                 restitution: float = 0.0):
        check_joint_numbers(from_, check_finite, lower=lower, upper=upper)
        super().__init__(restitution)
        self.source, self.lower, self.upper = from_, lower, upper

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Stops:
        """Return the stops, the lower ones first."""
        ends = [joint_numbers(coordinates, self.source, lambda joint: joint.bounds[0], self.lower),
                joint_numbers(coordinates, self.source, lambda joint: joint.bounds[1], self.upper)]
        for coordinate, low, high in zip(coordinates, *ends, strict=True):
            if low >= high:
                raise ValueError(f'the lower limit of {coordinate.name}, {low:g}, must be less '
                                 f'than the upper one, {high:g}; change them, or fix the joint '
                                 'with locked')
        # Copied so that the columns are contiguous for any number of stops: compiled code is
        # cached by the layout of its arrays.
        rows, places = np.argwhere(np.isfinite(ends)).T.copy()
        if not places.size:
            raise ValueError('no joint of the URDF has limits; give lower or upper')
        return Stops.of(places, np.array(ends)[rows, places], 1.0 - 2.0 * rows, self.restitution,
                        state)
