# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States in the phase space of (q, p), with names and units of their columns."""

from collections.abc import Sequence
from dataclasses import dataclass
import re
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike


# Suffixes of a coordinate's columns in q and in p, by kind.
_COLUMNS = {
    'scalar': (('',), ('',)),
    'rotation': (('_qx', '_qy', '_qz', '_qw'), ('_rx', '_ry', '_rz')),
    'pose': (('_x', '_y', '_z', '_qx', '_qy', '_qz', '_qw'),
             ('_x', '_y', '_z', '_rx', '_ry', '_rz')),
}
# Pattern of column units and names in degrees; angles are in radians.
IN_DEGREES = re.compile(r'(?<![a-z])deg(rees?)?(?![a-z])|°', re.IGNORECASE)
_SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
# Pattern of units.
UNIT = r'[\w %°/*·⋅^().⁻+-]{0,64}'
# Tolerance of a quaternion's norm: a larger error is not due to truncated digits.
_NORM_ERROR = 1e-6


class Follower(NamedTuple):
    """A joint without a coordinate of its own: multiplier times a coordinate, plus an offset."""

    name: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Coordinate:
    """
    One generalised coordinate and its conjugate momentum.

    Parameters
    ----------
    name : str
        Name in topics, logs and plots.
    q_unit, p_unit : str
        Units of the coordinate and of the momentum; for a pose, the units of its position.
    kind : str
        ``'scalar'``: one number. ``'rotation'``: an attitude as a unit quaternion (x, y, z, w)
        that maps body vectors to the world frame, and the angular momentum in the body frame,
        three numbers. ``'pose'``: a position and its momentum in the world frame, each followed by
        the columns of a rotation.
    followers : tuple of Follower
        Joints that move with it.
    rotor_of : str
        Joint whose rotor it is, behind an elastic gear; empty for all other coordinates.

    Raises
    ------
    ValueError
        A name contains ``$``, which marks formulas in the texts of pictures, or is not printable;
        or a unit has other characters.

    """

    name: str
    q_unit: str = '1'
    p_unit: str = '1'
    kind: Literal['scalar', 'rotation', 'pose'] = 'scalar'
    followers: tuple[Follower, ...] = ()
    rotor_of: str = ''

    def __post_init__(self) -> None:
        """Check the texts."""
        if '$' in self.name or not self.name.isprintable():
            raise ValueError(f'{self.name!r}: names of coordinates are printable, without $')
        for unit in (self.q_unit, self.p_unit):
            if not re.fullmatch(UNIT, unit):
                raise ValueError(f'{unit!r} is not a unit; give one such as kg m2/s: letters, '
                                 'digits, spaces and %°/*·^().+-')


def leaders(coordinates: Sequence[Coordinate]) -> dict[str, str]:
    """Return the coordinate that each follower moves with, by name."""
    return {follower.name: coordinate.name for coordinate in coordinates
            for follower in coordinate.followers}


def rotor_name(joint: str) -> str:
    """Return the name of the coordinate of a joint's rotor."""
    return f'{joint}_motor'


def motor_names(coordinates: Sequence[Coordinate]) -> dict[str, str]:
    """Return the coordinate on which the motor of each coordinate acts: its rotor, or itself."""
    rotors = {c.rotor_of: c.name for c in coordinates}
    return {c.name: rotors.get(c.name, c.name) for c in coordinates}


def columns(coordinates: Sequence[Coordinate]) -> tuple[list[str], list[str]]:
    """Return the names of the columns of q and of p."""
    names: tuple[list[str], list[str]] = [], []
    for coordinate in coordinates:
        for target, endings in zip(names, _COLUMNS[coordinate.kind], strict=True):
            target.extend(coordinate.name + ending for ending in endings)
    return names


def momentum_name(name: str) -> str:
    """Return the name of a coordinate's momentum: q2 has p2, x has p_x."""
    return f'p{name[1:]}' if name[:1] == 'q' else f'p_{name}'


def column_units(coordinates: Sequence[Coordinate]) -> tuple[list[str], list[str]]:
    """Return the units of the columns of q and of p."""
    units: tuple[list[str], list[str]] = [], []
    for coordinate in coordinates:
        own = coordinate.q_unit, coordinate.p_unit
        for target, unit, endings in zip(units, own, _COLUMNS[coordinate.kind], strict=True):
            target.extend([unit] * len(endings))
        if coordinate.kind == 'pose':
            # After the position and its momentum: a quaternion, and an angular momentum.
            units[0][-4:] = ['1'] * 4
            units[1][-3:] = ['kg m2/s' if own == ('m', 'kg m/s') else f'({own[1]}) {own[0]}'] * 3
    return units


# Units of momenta whose product with a velocity in the unit of the coordinate is an energy in J.
_OF_JOULES = {'m': ('kg m/s', 'N s'), 'rad': ('kg m2/s', 'N m s'), '1': ('1', 'kg m/s', 'kg m2/s')}


def energy_unit(coordinates: Sequence[Coordinate]) -> str:
    """Return the unit of H: J, unless a coordinate and its momentum have other units."""
    return next((f'({own.p_unit}) {own.q_unit}/s' for own in coordinates
                 if own.p_unit not in _OF_JOULES.get(own.q_unit, ())), 'J')


def raised(unit: str) -> str:
    """Return a unit with exponents as superscripts, for example kg m²/s for kg m2/s."""
    return re.sub('(?<=[A-Za-z])-?[0-9]+', lambda power: power[0].translate(_SUPERSCRIPTS), unit)


def scalar_columns(coordinates: Sequence[Coordinate]) -> dict[str, int]:
    """Return the columns of q outside quaternions by name."""
    names, turning = columns(coordinates)[0], rotations(coordinates)
    parts = {start + i for start in turning for i in range(4)}
    return {name: i for i, name in enumerate(names) if i not in parts}


def angle_columns(coordinates: Sequence[Coordinate]) -> np.ndarray:
    """Return a mask of the columns of q that are angles, with a period of 2 pi."""
    return np.array([coordinate.q_unit == 'rad' for coordinate in coordinates
                     for _ in _COLUMNS[coordinate.kind][0]])


def rotations(coordinates: Sequence[Coordinate]) -> tuple[int, ...]:
    """Return the columns of q at which unit quaternions start."""
    places, column = [], 0
    for coordinate in coordinates:
        column += len(_COLUMNS[coordinate.kind][0])
        if coordinate.kind != 'scalar':
            places.append(column - 4)
    return tuple(places)


@dataclass(frozen=True, eq=False)
class Event:
    """
    An instant at which a condition on the state became true.

    Parameters
    ----------
    when : str
        Condition, an equation.
    direction : str
        ``'up'`` if the left minus the right side became positive, ``'down'`` if negative.
    stops : bool
        True if the event ends the run.
    t : float
        Simulated time [s].
    q, p : np.ndarray, shape (d,)
        State at the event.
    energy : float
        H(q, p) [J].

    """

    when: str
    direction: str
    stops: bool
    t: float
    q: np.ndarray
    p: np.ndarray
    energy: float

    def __str__(self) -> str:
        return f'{self.when} ({self.direction}) at t = {self.t:.9g} s'


def coordinate_rates(turning: Sequence[int], q: np.ndarray, dH_dp: np.ndarray) -> np.ndarray:
    """Return q' of a state: H_p; for a rotation q (omega, 0) / 2; see ``momentum_rates``."""
    if not turning:
        return dH_dp
    rates, start = [], 0
    for passed, column in enumerate(turning):
        (*vector, scalar), omega = q[column:column + 4], dH_dp[column - passed:][:3]
        rates += [dH_dp[start - passed:column - passed],
                  0.5 * (scalar * omega + np.cross(vector, omega)),
                  [-0.5 * np.dot(vector, omega)]]
        start = column + 4
    return np.concatenate([*rates, dH_dp[start - len(turning):]])


def momentum_rates(turning: Sequence[int], q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                   dH_dp: np.ndarray) -> np.ndarray:
    """
    Return p' of a state: -H_q; for a rotation p x omega - g^* H_g, in the body frame.

    Parameters
    ----------
    turning : sequence of int
        Columns of q at which quaternions start.
    q, p : np.ndarray
        State; p has one column less for each rotation.
    dH_dq, dH_dp : np.ndarray
        Gradient of H, of the same shapes.

    """
    if not turning:
        return np.negative(dH_dq)
    rates, start = [], 0
    for passed, column in enumerate(turning):
        rates.append(-dH_dq[start:column])
        (*vector, scalar), (*slope, last) = q[column:column + 4], dH_dq[column:column + 4]
        place = slice(column - passed, column - passed + 3)
        # q' = q (omega, 0) / 2: half of the transposed map of H_q.
        torque = 0.5 * (scalar * np.array(slope) - np.cross(vector, slope)
                        - last * np.array(vector))
        rates.append(np.cross(p[place], dH_dp[place]) - torque)
        start = column + 4
    return np.concatenate([*rates, -dH_dq[start:]])


def check_state(q: ArrayLike, p: ArrayLike, dimension: int, turning: Sequence[int] = ()
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return new float64 arrays of one or several states in their shape; raise if invalid.

    Parameters
    ----------
    q, p : array_like, shape (d,) or (m, d)
        Generalised coordinates and conjugate momenta; p has one column less for each rotation.
    dimension : int
        The number d of columns of q.
    turning : sequence of int
        Columns at which quaternions start; they are returned with norm 1.

    Raises
    ------
    ValueError
        A length is wrong, a value is not a finite number, or a quaternion does not have norm 1.

    """
    arrays = []
    for name, values, width in (('q', q, dimension), ('p', p, dimension - len(turning))):
        array = np.array(values, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != width:
            each = ('one value for each coordinate' if not turning else
                    'four for each quaternion' if name == 'q' else 'three for each rotation')
            raise ValueError(f'{name} has shape {array.shape}, expected ({width},): {each}')
        if not np.isfinite(array).all():
            raise ValueError(f'{name} = {array.tolist()} is not finite')
        arrays.append(array)
    if arrays[0].shape[:-1] != arrays[1].shape[:-1]:
        raise ValueError(f'q and p have different shapes, {arrays[0].shape}, {arrays[1].shape}')
    for column in turning:
        _normalise(arrays[0][..., column:column + 4], column)
    return arrays[0], arrays[1]


def _normalise(quaternions: np.ndarray, column: int) -> None:
    """Normalise quaternions of shape (..., 4), or raise ValueError."""
    # An infinite norm is reported as an error; numpy's warning is not needed.
    with np.errstate(over='ignore'):
        norms = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    if (abs(norms - 1.0) > _NORM_ERROR).any():
        raise ValueError(f'q, from column {column} on, is a quaternion of norm '
                         f'{float(norms.flat[abs(norms - 1.0).argmax()]):.9g}; expected a unit '
                         'quaternion x, y, z, w: divide it by its norm')
    # Keep a quaternion with norm 1 up to rounding, so that a resumed state is unchanged.
    inexact = abs(norms - 1.0) > 4.0 * np.finfo(np.float64).eps
    quaternions /= np.where(inexact, norms, 1.0)
