# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Servos that move joints to commanded positions, at commanded velocities, or along paths."""

from collections.abc import Callable, Sequence
from copy import copy
import math
from typing import NamedTuple, TYPE_CHECKING

from hnn_vi_ros.effects.base import EffectState, Force, motor_index, per_coordinate
from hnn_vi_ros.effects.commands import (
    Command, Commanded, indices_of, JointCommand, JointPath, LARGEST, NUMBERS, PATH, POSITION,
    printable, Reference, ServoTarget, VELOCITY)
from hnn_vi_ros.effects.drives import find_drive
from hnn_vi_ros.effects.gravity_compensation import Compensated, GravityModelKind
from hnn_vi_ros.effects.knots import knot_before, with_rounding
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import (
    check_finite, check_names_once, check_not_negative, check_positive)
from hnn_vi_ros.integrators import bend_at, cubic, quintic, slope_at, value_at
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.effects.gravity_forces import Compensation

# Modes of a coordinate: no command yet, or it follows a position, a velocity, or a path. With a
# delay all commands wait in the knots; accelerations of a knot from which a command is held are
# NaN, infinite at those of cubic polynomials, and negative infinite at those of ramps.
_IDLE, _AT_POSITION, _AT_VELOCITY, _ON_PATH = range(4)
# Number of a command that switches a motor off; others are at most LARGEST.
OFF = 1e90
# Maximum number of knots of a path. Each has a row of Reference.knots, whose size is fixed,
# because compiled steps contain its address.
MOST_KNOTS = 1024
# A path that starts further ahead was stamped by another clock, not in simulated time [s].
_MAX_DELAY = 3600.0


class ServoParameters(NamedTuple):
    """
    Parameters of the compiled function of a servo of n joints.

    Parameters
    ----------
    columns : np.ndarray of int64, shape (n,)
        Columns of the joints in q.
    reference, clock, part
        See EffectState.
    command : np.ndarray
        See EffectState; without plain numbers, one that has expired.
    delay, speed, rate_limit : float
        Delay of commands [s], u, and the largest rate of commanded positions, possibly infinite.
    gravity : Compensation
        V'(q), zero for none.
    stiffness, damping, limit, back_emf, offset, punch, load : np.ndarray, shape (n,)
        k, c, F, b, o, P and l; F is infinite for no limit.
    start : np.ndarray, shape (n,)
        Positions at which the joints are held before the first command; NaN for none.

    """

    columns: np.ndarray
    reference: Reference
    clock: np.ndarray
    command: np.ndarray
    part: np.ndarray
    delay: float
    speed: float
    rate_limit: float
    gravity: 'Compensation'
    stiffness: np.ndarray
    damping: np.ndarray
    limit: np.ndarray
    start: np.ndarray
    back_emf: np.ndarray
    offset: np.ndarray
    punch: np.ndarray
    load: np.ndarray


class Servo(Compensated, Force, Commanded):
    """
    A servo for each joint, f - l abs(f) tanh(v / u), f = g + P tanh(2 g / P) - b v, v = H_p.

    It has the gains of g = k (q_r - q - o) + c (v_r - v) + V'(q), the last as
    `gravity_compensation` says. P is the torque of the least voltage;
    g + P tanh(2 g / P) is limited to -F to F. Friction of the gear takes the part l of the torque.
    The limit is that of the drive's voltage, of which the back EMF b v takes a part. Without a
    target the motor is off, and no force acts. A command sets q_r and v_r: a position with a
    velocity, by default zero; only a velocity, which only c follows; or a path, whose splines are
    evaluated at the method's nodes. It is active until the next command. Angles count
    revolutions: q_r - q is not wrapped. For efforts use `external_force`; `hnn identify` fits the
    numbers to logs of commands and positions. Energy account: f v.

    Parameters
    ----------
    coordinates : list of str
        The joints, in the order of the other lists.
    stiffness : float or list of float
        k >= 0, for all joints or for each [N/m], [N m/rad].
    damping : float or list of float
        c >= 0, for all joints or for each [N s/m], [N m s/rad].
    effort_limit : float or list of float, optional
        F > 0, for all joints or for each [N], [N m]; default: none.
    position : list of float, optional
        Position at which each joint is held until its first command [m], [rad]; default: none.
    back_emf : float or list of float, optional
        b >= 0, the torque constant squared over the resistance, for all joints or for each
        [N s/m], [N m s/rad].
    offset : float or list of float, optional
        o, what the encoder reads at q = 0, for all joints or for each [m], [rad]; commands are in
        its readings.
    punch : float or list of float, optional
        P >= 0, the torque at rest of the least voltage that is added to a controller's, called
        punch or minimum startup force, for all joints or for each [N], [N m].
    load : float or list of float, optional
        l, 0 to 1, friction in the gear relative to the motor's torque, for all joints or for each
        [1]; that which does not depend on the torque is `joint_friction`.
    speed : float, optional
        u > 0 [rad/s], [m/s], as that of `joint_friction`.
    delay : float, optional
        Time from a command to its effect, >= 0 [s]. A log's `enabled` acts without it.
    rate_limit : float, optional
        Largest rate, > 0 [rad/s], [m/s], at which q_r follows commanded positions, as in drives
        that make ramps of them; v_r is still the commanded one. Paths are followed as they are.
        Default: none.
    drive : str, optional
        A drive of all joints, whose F, b, P, l and rate limit are the defaults: mx64, mx106,
        xl320, xl330, erob80_50, sts3215_7v4, sts3215_so101 or sts3215_12v.
    gravity_compensation : str, optional
        model for V' of H, with its payload; unloaded for that without a payload; urdf for that of
        a robot in ``file``, with the joints and the gravity of H; default: none.
    file : str, optional
        The URDF of ``gravity_compensation: urdf``: a path, or package://PACKAGE/PATH.

    Raises
    ------
    ValueError
        A parameter is out of its range, no coordinate is named, one is named twice, or the drive
        is unknown.

    References
    ----------
    B. Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 8.5.1.

    """

    depends_on_momentum, single, knots, numbers = True, True, MOST_KNOTS, False

    def __init__(self, coordinates: list[str], stiffness: float | list[float],
                 damping: float | list[float] = 0.0,
                 effort_limit: float | list[float] | None = None,
                 position: list[float] | None = None, back_emf: float | list[float] = 0.0,
                 offset: float | list[float] = 0.0, delay: float = 0.0,
                 drive: str | None = None, punch: float | list[float] = 0.0,
                 load: float | list[float] = 0.0, speed: float = 0.01,
                 gravity_compensation: GravityModelKind | None = None,
                 file: str | None = None, rate_limit: float | None = None):
        super().__init__(gravity_compensation, file)
        if drive is not None:
            row = find_drive(drive)
            effort_limit = row.torque_limit if effort_limit is None else effort_limit
            rate_limit = row.rate_limit if rate_limit is None else rate_limit
            back_emf, punch, load = (
                given if np.any(given) else own for given, own in (
                    (back_emf, row.back_emf), (punch, row.punch), (load, row.load)))
        limit = math.inf if effort_limit is None else effort_limit
        check_not_negative(stiffness=stiffness, damping=damping, back_emf=back_emf, delay=delay,
                           punch=punch, load=load)
        check_positive(speed=speed, **{} if rate_limit is None else {'rate_limit': rate_limit})
        if not all(one <= 1.0 for one in np.ravel(load)):
            raise ValueError(f'load = {load} must be at most 1: friction stops what drives it')
        if not all(one > 0.0 for one in np.ravel(limit)):
            raise ValueError(f'effort_limit = {limit} must be positive')
        check_finite(position=position or 0.0, offset=offset)
        check_names_once(coordinates=coordinates)
        self.names, self.delay, self.speed = coordinates, float(delay), float(speed)
        self.rate_limit = math.inf if rate_limit is None else float(rate_limit)
        self.cuts_at_knots = self.delay > 0.0 or self.rate_limit < math.inf
        self.takes = frozenset({POSITION, VELOCITY, PATH})
        self.values: dict[str, float | list[float]] = {
            'stiffness': stiffness, 'damping': damping, 'effort_limit': limit,
            'position': math.nan if position is None else position,
            'back_emf': back_emf, 'offset': offset, 'punch': punch, 'load': load}

    def on_numbers(self) -> 'Servo':
        """
        Return this servo without delay and rate limit, commanded by plain numbers, one a joint.

        They are positions, or OFF for a motor that is switched off.
        """
        other = copy(self)
        other.numbers = other.feels_command = True
        other.cuts_at_knots = False
        other.takes, other.delay, other.rate_limit = frozenset({NUMBERS}), 0.0, math.inf
        return other

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> ServoParameters:
        """Return the columns of the joints, the commands, the clock and the numbers."""
        from hnn_vi_ros.effects.gravity_forces import no_compensation
        columns = np.array([motor_index(coordinates, name) for name in self.names])
        joints = [coordinates[i] for i in columns]
        own = (per_coordinate(joints, name, value) for name, value in self.values.items())
        command = state.command if self.numbers else np.full(1, -math.inf)
        return ServoParameters(
            columns, state.reference, state.clock, command, state.part, self.delay, self.speed,
            self.rate_limit, no_compensation(columns.size), *own)

    def prepare(self, command: Command, parameters: ServoParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return a function that sets positions, velocities, a path or numbers."""
        if isinstance(command, JointPath):
            return _prepare_path(command, parameters, self.names, q)
        if isinstance(command, JointCommand):
            return _prepare_targets(command, parameters, self.names, q)

        def put() -> None:
            parameters.command[parameters.columns] = command
            parameters.command[-1] = math.inf
        return put

    def servo_target(self, parameters: ServoParameters) -> ServoTarget:
        """Return the present targets of the joints."""
        return _target(parameters, self.names, _read_at(parameters, parameters.clock[0]))

    def joints(self, parameters: ServoParameters) -> np.ndarray:
        """Return the columns of the joints."""
        return parameters.columns

    @staticmethod
    @inlined
    def add_force(parameters: ServoParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add f = g + P tanh(2 g / P) - b v, the first two within limits, and its friction."""
        own, read_at = parameters, _read_at(parameters, t)
        segment = knot_before(own.reference, read_at)
        own.gravity.fill(own.gravity.model, q, own.gravity.forces)
        for k in range(own.columns.size):
            i, force = own.columns[k], 0.0
            position, rate, _ = _target_at(own, k, segment, read_at, t)
            if not math.isnan(position):
                force += own.stiffness[k] * (position - (q[i] + own.offset[k]))
            if not math.isnan(rate):
                force += own.damping[k] * (rate - velocity[i]) + own.gravity.forces[k]
                if own.punch[k] > 0.0:
                    force += own.punch[k] * math.tanh(2.0 * force / own.punch[k])
                force = min(max(force, -own.limit[k]), own.limit[k]) \
                    - own.back_emf[k] * velocity[i]
                f_p[i] += force - own.load[k] * abs(force) * math.tanh(velocity[i] / own.speed)


@inlined
def _read_at(own: ServoParameters, t: float) -> float:
    """Return a time between the knots that a time belongs to."""
    if not _waits(own):
        return t
    return with_rounding(t) if math.isnan(own.part[0]) else own.part[0]


@inlined
def _target_at(own: ServoParameters, k: int, segment: int, read_at: float, t: float
               ) -> tuple[float, float, float]:
    """Return the target position, velocity and acceleration of joint k; NaN for none."""
    reference, i = own.reference, own.columns[k]
    if own.clock[0] < own.command[own.command.size - 1]:
        number = own.command[i]
        return (number, 0.0, 0.0) if abs(number) <= LARGEST else (np.nan, np.nan, 0.0)
    mode = reference.modes[i]
    if mode == _ON_PATH:
        return _along(reference, segment, i, read_at, t)
    if mode == _AT_POSITION:
        return reference.targets[0, i], reference.targets[1, i], 0.0
    if mode == _AT_VELOCITY:
        return np.nan, reference.targets[1, i], 0.0
    return own.start[k], np.nan if math.isnan(own.start[k]) else 0.0, 0.0


@inlined
def _along(reference: Reference, segment: int, i: int, read_at: float, t: float
           ) -> tuple[float, float, float]:
    """Return a coordinate of the path and its derivatives, in the segment after a knot."""
    knots, d = reference.knots, reference.modes.size
    q0, v0, a0 = knots[segment, 1 + i], knots[segment, 1 + d + i], knots[segment, 1 + 2 * d + i]
    if math.isnan(a0):
        return q0, v0, 0.0
    if segment + 1 >= min(reference.extent[0], knots.shape[0]) \
            or read_at < knots[segment, 0]:
        # The path is at rest after its end and before its start.
        return q0, 0.0, 0.0
    q1, v1, a1 = (knots[segment + 1, 1 + i], knots[segment + 1, 1 + d + i],
                  knots[segment + 1, 1 + 2 * d + i])
    h = knots[segment + 1, 0] - knots[segment, 0]
    x = (t - knots[segment, 0]) / h
    if a0 == -np.inf:
        return q0 + (q1 - q0) * x, v0, 0.0
    c = cubic(h, q0, v0, q1, v1) if reference.extent[1] == 3 or math.isinf(a0) else \
        quintic(h, q0, v0, a0, q1, v1, a1)
    return value_at(c, x), slope_at(c, x) / h, bend_at(c, x) / (h * h)


def _target(own: ServoParameters, names: Sequence[str], t: float) -> ServoTarget:
    """Return the targets of joints with these names at a time."""
    segment = knot_before(own.reference, t)
    targets = np.array([_target_at(own, k, segment, t, t) for k in range(own.columns.size)])
    on_path = bool((_bends(own, segment) > -math.inf).any())
    return ServoTarget(names, own.columns, targets.T, on_path)


def _bends(own: ServoParameters, segment: int) -> np.ndarray:
    """Return the accelerations of joints at a knot; NaN where they follow no path, (n,)."""
    modes, knots = own.reference.modes, own.reference.knots
    return np.where(modes[own.columns] == _ON_PATH,
                    knots[segment, 1 + 2 * modes.size + own.columns], math.nan)


def _prepare_targets(command: JointCommand, own: ServoParameters, names: Sequence[str],
                     q: np.ndarray) -> Callable[[], None]:
    moved = ~(np.isnan(command.position) & np.isnan(command.velocity))
    joints = indices_of(command.names, names, moved)
    position, velocity = command.position[moved], command.velocity[moved]
    for kind, values in (('position', position), ('velocity', velocity)):
        for k in np.flatnonzero(np.abs(values) > LARGEST):
            raise ValueError(f'{kind} of {names[joints[k]]} is {values[k]:g}, expected at most '
                             f'{LARGEST:g}')
    if _waits(own):
        places, d, (rows, begin) = 1 + own.columns[joints], own.reference.modes.size, _waiting(own)
        first = np.where(np.isnan(rows[begin, places]), q[places - 1] + own.offset[joints],
                         rows[begin, places])
        change, at = position - first, rows[begin, 0]
        ends = np.where(np.isnan(change), at, at + np.abs(change) / own.rate_limit)
        later = [*rows[begin:], *(_row(own, end) for end in np.unique(ends[ends > at]))]
        later.sort(key=lambda row: float(row[0]))
        rows = np.vstack([rows[:begin], *later])
        t = rows[begin:, :1]
        ramps = t < ends
        rows[begin:, places] = np.where(
            ramps, first + np.sign(change) * (t - at) * min(own.rate_limit, LARGEST), position)
        rows[begin:, d + places] = np.where(np.isnan(velocity), 0.0, velocity)
        rows[begin:, 2 * d + places] = np.where(ramps, -math.inf, math.nan)
        # Ends of earlier ramps.
        kinds = rows[:, 2 * d + 1 + own.columns]
        same = (np.isnan(kinds[1:]) & np.isnan(kinds[:-1])) | (
            (kinds[1:] == -math.inf) & (kinds[:-1] == -math.inf))
        kept = np.append(True, ~same.all(axis=1))
        kept[:begin + 1] = True
        return _follow(own, rows[kept], 5)

    def put() -> None:
        reference, places = own.reference, own.columns[joints]
        free = np.isnan(position)
        reference.modes[places] = np.where(free, _AT_VELOCITY, _AT_POSITION)
        reference.targets[0, places] = np.where(free, 0.0, position)
        reference.targets[1, places] = np.where(np.isnan(velocity), 0.0, velocity)
    return put


@inlined
def _waits(own: ServoParameters) -> bool:
    """Return whether commands of positions are kept in the knots."""
    return own.delay > 0.0 or own.rate_limit < math.inf


def _row(own: ServoParameters, t: float) -> np.ndarray:
    """Return the row of the knots that continues the reference from a time on."""
    reference, d, columns = own.reference, own.reference.modes.size, 1 + own.columns
    if not reference.extent[0]:
        row = np.full(1 + 3 * d, math.nan)
        row[columns] = own.start
        row[d + columns] = np.where(np.isnan(own.start), math.nan, 0.0)
    else:
        segment = knot_before(reference, t)
        row, bends = reference.knots[segment].copy(), _bends(own, segment)
        for part, values in enumerate(_target(own, (), t).targets):
            row[part * d + columns] = values
        row[2 * d + columns] = np.where(np.isfinite(bends), row[2 * d + columns], bends)
    row[0] = t
    return row


def _waiting(own: ServoParameters) -> tuple[np.ndarray, int]:
    """
    Return the rows of the knots from the active one on, and the index of the one after the delay.

    The reference is split there.
    """
    reference, at, columns = own.reference, own.clock[0] + own.delay, 1 + own.columns
    if not reference.extent[0]:
        return np.array([_row(own, own.clock[0]), _row(own, at)]), 1
    knots, d = reference.knots[:reference.extent[0]], reference.modes.size
    active, last = (knot_before(reference, t) for t in (own.clock[0], at))
    begin, bends = _row(own, at), _bends(own, last)
    rows = [*knots[active:last + 1], begin, *knots[last + 1:]]
    if not np.isnan(bends).all():
        # A quintic ends with an acceleration, whatever follows.
        end = begin.copy()
        end[2 * d + columns] = np.where(np.isnan(bends), bends, _target(own, (), at).targets[2])
        rows.insert(last + 1 - active, end)
    return np.array(rows), len(rows) - len(knots[last + 1:]) - 1


def _follow(own: ServoParameters, rows: np.ndarray, degree: int) -> Callable[[], None]:
    """Return a function that replaces the knots, or raise ValueError for too many."""
    if len(rows) > MOST_KNOTS:
        raise ValueError(f'more than {MOST_KNOTS} commands and points of paths wait for the delay '
                         f'of {own.delay:g} s to pass; command less often')

    def put() -> None:
        reference = own.reference
        reference.knots[:len(rows)] = rows
        reference.extent[:] = len(rows), degree
        reference.modes[own.columns] = _ON_PATH
    return put


def _prepare_path(path: JointPath, own: ServoParameters, names: Sequence[str], q: np.ndarray
                  ) -> Callable[[], None]:
    """
    Return a function that makes joints follow a path after the delay, or raise ValueError.

    The path starts at the targets then, so that the reference does not jump, and continues with
    the points in the future. Points without velocities get the velocities of the cubic spline that
    ends at rest. A path without points holds the joints at the start.
    """
    _check_path(path, names)
    now = own.clock[0] + own.delay
    start = _target(own, names, now).targets
    start[0] = np.where(np.isnan(start[0]), q[own.columns], start[0])
    start[1] = np.where(np.isnan(start[1]), 0.0, start[1])
    if not len(path.times):
        still = np.zeros(len(names))
        return _prepare_targets(JointCommand(names, start[0], still, still), own, names, q)
    times = now + path.delay + path.times
    ahead = times > now
    if times[-1] == now:
        raise ValueError('the last point has time_from_start = 0 s; give it a later time, or '
                         'command it as a position')
    if not ahead.any():
        raise ValueError(f'the last point is {now - times[-1]:.6g} s in the past; stamp the path '
                         'with simulated time, or with zero for the current time')
    t = np.concatenate([[now], times[ahead]])
    if (np.diff(t) <= 0.0).any():
        raise ValueError(f'times of points are less than {np.spacing(t[-1]):.3g} s apart, the '
                         'resolution of the clock now; remove points, or reset the time')
    order = [list(path.names).index(name) for name in names]
    points = np.vstack([start[0], path.positions[ahead][:, order]])
    slopes = bends = np.zeros_like(points)
    if path.velocities is not None:
        slopes = np.vstack([start[1], path.velocities[ahead][:, order]])
    else:
        # Imported lazily: the import is slow, and only such paths need it.
        from scipy.interpolate import CubicSpline
        rest = np.zeros(len(names))
        slopes = CubicSpline(t - now, points, bc_type=((1, start[1]), (1, rest)))(t - now, 1)
    if path.accelerations is not None:
        bends = np.vstack([start[2], path.accelerations[ahead][:, order]])
    d, degree = own.reference.modes.size, 3 if path.accelerations is None else 5
    rows = np.zeros((len(t), 1 + 3 * d))
    rows[:, 0] = t
    for part, values in enumerate((points, slopes, bends)):
        rows[:, 1 + part * d + own.columns] = values
    if not _waits(own):
        return _follow(own, rows, degree)
    if degree == 3:
        rows[:, 1 + 2 * d + own.columns] = math.inf
    before, begin = _waiting(own)
    return _follow(own, np.vstack([before[:begin], rows]), 5)


def _check_path(path: JointPath, names: Sequence[str]) -> None:
    n = len(path.times)
    if sorted(path.names) != sorted(names) and (n or path.names):
        raise ValueError(f'joint_names = [{printable(path.names)}] must be '
                         f'{listed(names)}, each once')
    if not n:
        return
    if n >= MOST_KNOTS:
        raise ValueError(f'{n} points, expected at most {MOST_KNOTS - 1}, joined by a spline')
    if path.velocities is None and path.accelerations is not None:
        raise ValueError('the points have accelerations but no velocities; give both, or neither')
    for name in ('positions', 'velocities', 'accelerations'):
        values = getattr(path, name)
        if values is not None and not (
                values.shape == (n, len(names)) and (np.abs(values) <= LARGEST).all()):
            raise ValueError(f'{name} must be {len(names)} numbers, at most {LARGEST:g}, in '
                             'each point')
    if not np.isfinite(path.times).all() or (np.diff(path.times) <= 0.0).any() \
            or path.times[0] < 0.0:
        raise ValueError('time_from_start must be at least 0 s and increase from point to point')
    if path.velocities is not None and path.velocities[-1].any():
        raise ValueError('velocities of the last point must be 0, because the joints stay there')
    if not path.delay <= _MAX_DELAY:
        raise ValueError(f'the path starts in {path.delay:.6g} s, limit {_MAX_DELAY:g} s; '
                         'stamp it with simulated time, or with zero for the current time')
