# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Targets of a servo's joints: a position, a velocity, or a path of splines."""

from collections.abc import Callable, Sequence
from functools import partial
import math
from typing import NamedTuple

from hnn_vi_ros.effects.commands import (
    Aim, Command, JointCommand, JointPath, LARGEST, places_of, Reference, told)
from hnn_vi_ros.errors import listed
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# What drives a coordinate: nothing yet, a position, a velocity, a path.
IDLE, AT_POSITION, AT_VELOCITY, ON_PATH = range(4)
# Knots of a path; each has a row of Reference.knots.
MOST_KNOTS = 1024
# A start further ahead is no simulated time, but one of another clock [s].
_LONGEST_DELAY = 3600.0


class ServoParameters(NamedTuple):
    """
    Parameters of the compiled function of a servo of n joints.

    Parameters
    ----------
    places : np.ndarray of int64, shape (n,)
        Those of the joints among the coordinates.
    reference, clock
        See EffectState.
    stiffness, damping, limit : np.ndarray, shape (n,)
        k, c and F; infinite for none.
    start : np.ndarray, shape (n,)
        Where the joints are held before the first command; NaN where they are not.

    """

    places: np.ndarray
    reference: Reference
    clock: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    limit: np.ndarray
    start: np.ndarray


@inlined
def segment_at(reference: Reference, t: float) -> int:
    """Return the last knot of the path that is not after a time; 0 before all of them."""
    # No count of a damaged file leads beyond the knots.
    low, high = 0, min(reference.extent[0], reference.knots.shape[0]) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if reference.knots[middle, 0] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@inlined
def target_at(own: ServoParameters, k: int, segment: int, t: float
              ) -> tuple[float, float, float]:
    """Return the position, velocity and acceleration that joint k is to have; NaN for none."""
    reference, i = own.reference, own.places[k]
    mode = reference.modes[i]
    if mode == ON_PATH:
        return _along(reference, segment, i, t)
    if mode == AT_POSITION:
        return reference.targets[0, i], reference.targets[1, i], 0.0
    if mode == AT_VELOCITY:
        return np.nan, reference.targets[1, i], 0.0
    return own.start[k], np.nan if math.isnan(own.start[k]) else 0.0, 0.0


@inlined
def _along(reference: Reference, segment: int, i: int, t: float) -> tuple[float, float, float]:
    """Return a coordinate of the path, and its derivatives, in the segment after a knot."""
    knots, d = reference.knots, reference.modes.size
    q0, v0, a0 = knots[segment, 1 + i], knots[segment, 1 + d + i], knots[segment, 1 + 2 * d + i]
    if segment + 1 >= min(reference.extent[0], knots.shape[0]) or t < knots[segment, 0]:
        # It stays at its end.
        return q0, 0.0, 0.0
    q1, v1 = knots[segment + 1, 1 + i], knots[segment + 1, 1 + d + i]
    length, x = knots[segment + 1, 0] - knots[segment, 0], t - knots[segment, 0]
    if reference.extent[1] == 3:
        # By Hermite, of the values at both ends and of the slopes.
        slope = (q1 - q0) / length
        c2 = (3.0 * slope - 2.0 * v0 - v1) / length
        c3 = (v0 + v1 - 2.0 * slope) / (length * length)
        c4 = c5 = 0.0
    else:
        # What the Taylor polynomial of the start lacks at the end, in position, velocity and
        # acceleration, each in the unit of the position.
        c2 = 0.5 * a0
        lacks_q = q1 - q0 - length * (v0 + length * c2)
        lacks_v = length * (v1 - v0 - length * a0)
        lacks_a = length * length * (knots[segment + 1, 1 + 2 * d + i] - a0)
        cube = length * length * length
        c3 = (10.0 * lacks_q - 4.0 * lacks_v + 0.5 * lacks_a) / cube
        c4 = (-15.0 * lacks_q + 7.0 * lacks_v - lacks_a) / (cube * length)
        c5 = (6.0 * lacks_q - 3.0 * lacks_v + 0.5 * lacks_a) / (cube * length * length)
    return (q0 + x * (v0 + x * (c2 + x * (c3 + x * (c4 + x * c5)))),
            v0 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
            2.0 * c2 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)))


def aim_of(own: ServoParameters, names: Sequence[str]) -> Aim:
    """Return where joints of these names are to be now."""
    t = own.clock[0]
    segment = segment_at(own.reference, t)
    targets = np.array([target_at(own, k, segment, t) for k in range(own.places.size)])
    modes = own.reference.modes[own.places]
    return Aim(names, own.places, targets.T, bool((modes == ON_PATH).any()))


def prepare(command: Command, own: ServoParameters, names: Sequence[str], q: np.ndarray
            ) -> Callable[[], None]:
    """Return what lets joints of these names follow a command; see Commanded."""
    if isinstance(command, JointPath):
        return _prepare_path(command, own, names, q)
    assert isinstance(command, JointCommand)
    return _prepare_targets(command, own, names)


def _prepare_targets(command: JointCommand, own: ServoParameters, names: Sequence[str]
                     ) -> Callable[[], None]:
    moved = ~(np.isnan(command.position) & np.isnan(command.velocity))
    joints = places_of(command.names, names, moved)
    position, velocity = command.position[moved], command.velocity[moved]
    for kind, values in (('position', position), ('velocity', velocity)):
        for k in np.flatnonzero(np.abs(values) > LARGEST):
            raise ValueError(f'{kind} of {names[joints[k]]} is {values[k]:g}, at most {LARGEST:g} '
                             'is taken')

    def put() -> None:
        reference, places = own.reference, own.places[joints]
        free = np.isnan(position)
        reference.modes[places] = np.where(free, AT_VELOCITY, AT_POSITION)
        reference.targets[0, places] = np.where(free, 0.0, position)
        reference.targets[1, places] = np.where(np.isnan(velocity), 0.0, velocity)
    return put


def _prepare_path(path: JointPath, own: ServoParameters, names: Sequence[str], q: np.ndarray
                  ) -> Callable[[], None]:
    """
    Return what lets joints follow a path from now on, or raise ValueError.

    It begins where the joints are to be now: with the points that are still to come. Where these
    have no velocities, they are those of the cubic spline that rests at its end. A path without
    points holds the joints at the beginning.
    """
    _check_path(path, names)
    start = aim_of(own, names).targets
    start[0] = np.where(np.isnan(start[0]), q[own.places], start[0])
    start[1] = np.where(np.isnan(start[1]), 0.0, start[1])
    if not len(path.times):
        return partial(_hold, own, start[0])
    now, times = own.clock[0], own.clock[0] + path.delay + path.times
    ahead = times > now
    if times[-1] == now:
        raise ValueError('the last point is to be reached at once: give it a time_from_start, or '
                         'command it as the position of joints')
    if not ahead.any():
        raise ValueError(f'the last point was to be reached {now - times[-1]:.6g} s ago: stamp '
                         'the path with zero, which is now, or with simulated time')
    t = np.concatenate([[now], times[ahead]])
    if (np.diff(t) <= 0.0).any():
        raise ValueError(f'times of points are less than {np.spacing(t[-1]):.3g} s apart, which '
                         'is one time to the clock now: leave points out, or reset the time')
    order = [list(path.names).index(name) for name in names]
    points = np.vstack([start[0], path.positions[ahead][:, order]])
    slopes = bends = np.zeros_like(points)
    if path.velocities is not None:
        slopes = np.vstack([start[1], path.velocities[ahead][:, order]])
    else:
        # Imported here: who follows no path has no use for it.
        from scipy.interpolate import CubicSpline
        rest = np.zeros(len(names))
        slopes = CubicSpline(t - now, points, bc_type=((1, start[1]), (1, rest)))(t - now, 1)
    if path.accelerations is not None:
        bends = np.vstack([start[2], path.accelerations[ahead][:, order]])
    rows = np.hstack([t[:, None], points, slopes, bends])

    def put() -> None:
        reference, d = own.reference, own.reference.modes.size
        columns = [0, *(1 + part * d + i for part in range(3) for i in own.places)]
        reference.knots[:len(t), columns] = rows
        reference.extent[:] = len(t), 3 if path.accelerations is None else 5
        reference.modes[own.places] = ON_PATH
    return put


def _hold(own: ServoParameters, position: np.ndarray) -> None:
    """Let joints stay at a position, at once."""
    own.reference.modes[own.places] = AT_POSITION
    own.reference.targets[:, own.places] = position, np.zeros_like(position)


def _check_path(path: JointPath, names: Sequence[str]) -> None:
    n = len(path.times)
    if sorted(path.names) != sorted(names) and (n or path.names):
        raise ValueError(f'joint_names = [{told(path.names)}] must be '
                         f'{listed(names)}, each once')
    if not n:
        return
    if n >= MOST_KNOTS:
        raise ValueError(f'{n} points, expected at most {MOST_KNOTS - 1}: a spline joins them')
    if path.velocities is None and path.accelerations is not None:
        raise ValueError('the points have accelerations but no velocities: give both, or neither')
    for name in ('positions', 'velocities', 'accelerations'):
        values = getattr(path, name)
        if values is not None and not (
                values.shape == (n, len(names)) and (np.abs(values) <= LARGEST).all()):
            raise ValueError(f'{name} must be {len(names)} numbers of at most {LARGEST:g} in '
                             'each point')
    if not np.isfinite(path.times).all() or (np.diff(path.times) <= 0.0).any() \
            or path.times[0] < 0.0:
        raise ValueError('time_from_start must rise from point to point, from 0 on')
    if path.velocities is not None and path.velocities[-1].any():
        raise ValueError('velocities of the last point must be 0: the joints stay there')
    if not path.delay <= _LONGEST_DELAY:
        raise ValueError(f'the path begins in {path.delay:.6g} s, at most {_LONGEST_DELAY:g} s '
                         'ahead: stamp it with zero, which is now, or with simulated time')
