# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Motors that bring joints to where they are commanded."""

from collections.abc import Callable, Sequence
import math

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Force, per_coordinate
from hnn_vi_ros.effects.commands import Aim, Command, Commanded, PATH, POSITION, VELOCITY
from hnn_vi_ros.effects.servo_targets import (
    aim_of, MOST_KNOTS, prepare, segment_at, ServoParameters, target_at)
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Servo(Force, Commanded):
    """
    A servo for each joint, f = k (q_r - q) + c (v_r - v) within -F to F, with v = H_p.

    q_r and v_r are commanded: a position with a velocity, or zero; a velocity alone, by c; or a
    path, whose splines are taken at the method's own nodes. The last command holds until the next.
    Angles count turns: q_r - q is not wrapped. Energy account: the power f v.

    Parameters
    ----------
    coordinates : list of str
        The joints, in the order of all lists here.
    stiffness : float or list of float
        k >= 0 of all joints or of each [N/m], [N m/rad].
    damping : float or list of float
        c >= 0 of all joints or of each [N s/m], [N m s/rad].
    effort_limit : float or list of float, optional
        F > 0 of all joints or of each [N], [N m]; default: none.
    position : list of float, optional
        Where each joint is held until its first command [m], [rad]; default: nowhere.

    Raises
    ------
    ValueError
        A parameter out of its range, no coordinate, or one named twice.

    References
    ----------
    B. Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 8.5.1.

    """

    depends_on_momentum, single, knots = True, True, MOST_KNOTS
    takes = frozenset({POSITION, VELOCITY, PATH})

    def __init__(self, coordinates: list[str], stiffness: float | list[float],
                 damping: float | list[float] = 0.0,
                 effort_limit: float | list[float] | None = None,
                 position: list[float] | None = None):
        limit = math.inf if effort_limit is None else effort_limit
        for name, value in (('stiffness', stiffness), ('damping', damping)):
            if not all(math.isfinite(one) and one >= 0.0 for one in np.ravel(value)):
                raise ValueError(f'{name} = {value} must be at least 0 and finite')
        if not all(one > 0.0 for one in np.ravel(limit)):
            raise ValueError(f'effort_limit = {limit} must be positive')
        if position is not None and not np.isfinite(position).all():
            raise ValueError(f'position = {position} must be finite')
        if not coordinates or len(set(coordinates)) < len(coordinates):
            raise ValueError(f'coordinates = {coordinates} must name at least one, each once')
        self.names = coordinates
        self.values: dict[str, float | list[float]] = {
            'stiffness': stiffness, 'damping': damping, 'effort_limit': limit,
            'position': math.nan if position is None else position}

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> ServoParameters:
        """Return the joints' places, k, c, F, where they are held first, and what is followed."""
        places = np.array([coordinate_index(coordinates, name) for name in self.names])
        joints = [coordinates[i] for i in places]
        own = (per_coordinate(joints, name, value) for name, value in self.values.items())
        return ServoParameters(places, state.reference, state.clock, *own)

    def prepare(self, command: Command, parameters: ServoParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return what sets positions, velocities or a path; see Commanded."""
        return prepare(command, parameters, self.names, q)

    def aim(self, parameters: ServoParameters) -> Aim:
        """Return where the joints are to be now."""
        return aim_of(parameters, self.names)

    @staticmethod
    @inlined
    def add_force(parameters: ServoParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add k (q_r - q) + c (v_r - v), within its limits."""
        own, segment = parameters, segment_at(parameters.reference, t)
        for k in range(own.places.size):
            i, force = own.places[k], 0.0
            position, rate, _ = target_at(own, k, segment, t)
            if not math.isnan(position):
                force += own.stiffness[k] * (position - q[i])
            if not math.isnan(rate):
                force += own.damping[k] * (rate - velocity[i])
            f_p[i] += min(max(force, -own.limit[k]), own.limit[k])
