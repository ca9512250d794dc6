# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A spring between two points of coordinates or of bodies, or to a fixed point."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects.attitudes import add_rotation_slope, dot, rotate, rotate_tangent, Vector
from hnn_vi_ros.effects.base import coordinate_index, EffectState, Joined, Potential
from hnn_vi_ros.effects.points import add_along, check_pair, distance, resolve_pair, separation
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import check_not_negative, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import columns, Coordinate
import numpy as np


class Elastic(NamedTuple):
    """Two points, or a point and an anchor, see resolve_pair; stiffness k and rest length l."""

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    stiffness: float
    rest_length: float


class BodyElastic(NamedTuple):
    """
    Two ends in space, at least one of them on a body; stiffness k and rest length l.

    Parameters
    ----------
    columns : np.ndarray of int, shape (2, 4)
        For each end, the columns in q of its position, and of the quaternion that rotates its arm;
        -1 for none.
    arms : np.ndarray, shape (2, 3)
        Arm of each end, in the frame of its body; for an end that is not on a body, zero or its
        fixed position.
    stiffness, rest_length : float
        See Spring.

    """

    columns: np.ndarray
    arms: np.ndarray
    stiffness: float
    rest_length: float


class Spring(Potential):
    """
    A linear spring, V = k (r - l)^2 / 2, where r is the distance of its ends.

    Between points of one coordinate, r is the signed difference. A rigid rod is
    `holonomic_constraint`. Energy account: V is part of H.

    Parameters
    ----------
    point : list of str
        Names of the coordinates of one end [m], or of the body to which it is fixed.
    other : list of str, optional
        Names of the coordinates of the other end, or of its body, or
    anchor : list of float, optional
        the fixed position of the other end [m].
    stiffness : float
        k > 0 [N/m].
    rest_length : float
        l >= 0 [m].
    point_in_body, other_in_body : list of float, optional
        Positions of the ends on their bodies, in body frames [m]; by default the origin.

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, 1976, section 21.

    """

    turns = drawn = True

    def __init__(self, point: list[str], other: list[str] | None = None,
                 anchor: list[float] | None = None, stiffness: float = 1.0,
                 rest_length: float = 0.0, point_in_body: list[float] | None = None,
                 other_in_body: list[float] | None = None):
        check_positive(stiffness=stiffness)
        check_not_negative(rest_length=rest_length)
        self.ends, self.in_body = (point, other, anchor), (point_in_body, other_in_body)
        self.elastic = float(stiffness), float(rest_length)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> Elastic | BodyElastic:
        """Return the ends, the stiffness [N/m] and the rest length [m]."""
        point, other, _ = self.ends
        if self.in_body != (None, None) or any(
                _is_body(coordinates, names) for names in (point, other or ())):
            return BodyElastic(*self._resolve_ends(coordinates), *self.elastic)
        return Elastic(*resolve_pair(coordinates, *self.ends), *self.elastic)

    def _resolve_ends(self, coordinates: Sequence[Coordinate]) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns and the arms of BodyElastic, or raise ValueError."""
        (point, other, anchor), (in_body, other_in_body) = self.ends, self.in_body
        check_pair(other, anchor)
        ends = [_resolve_end(coordinates, 'point', point, in_body)]
        if other is not None:
            ends.append(_resolve_end(coordinates, 'other', other, other_in_body))
            if list(point) == list(other):
                raise ValueError('point and other must be on different bodies')
        else:
            if other_in_body is not None:
                raise ValueError('other_in_body is given without other; remove it')
            ends.append(([-1] * 4, _three('anchor', anchor)))
        rows, arms = zip(*ends, strict=True)
        return np.array(rows), np.array(arms)

    def formulas(self, parameters: Any) -> type[Joined]:
        """Return the formulas of the ends."""
        return BodySpring if isinstance(parameters, BodyElastic) else Spring

    @staticmethod
    @inlined
    def energy(parameters: Elastic, q: np.ndarray) -> float:
        """Return V [J]."""
        first, second, anchor, stiffness, rest = parameters
        stretch = distance(first, second, anchor, q) - rest
        return 0.5 * stiffness * stretch * stretch

    @staticmethod
    @inlined
    def add_gradient(parameters: Elastic, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V' = k (1 - l / r) times the vector between the ends."""
        first, second, anchor, stiffness, rest = parameters
        r = distance(first, second, anchor, q)
        for k in range(first.size):
            along = separation(first, second, anchor, q, k)
            # At r = 0 the direction of a spring with l > 0 is undefined; the force is zero there.
            pull = stiffness * (along - (rest * along / r if r != 0.0 else 0.0))
            add_along(first, second, k, pull, dH_dq)

    @staticmethod
    @inlined
    def add_hessian_vector(parameters: Elastic, q: np.ndarray, v: np.ndarray, product: np.ndarray
                           ) -> None:
        """Add V'' v."""
        first, second, anchor, stiffness, rest = parameters
        r = distance(first, second, anchor, q)
        bend = rest / r if r != 0.0 and first.size > 1 else 0.0
        inward = 0.0
        for k in range(first.size):
            change = v[first[k]] - (v[second[k]] if second[k] >= 0 else 0.0)
            inward += separation(first, second, anchor, q, k) * change
        for k in range(first.size):
            change = v[first[k]] - (v[second[k]] if second[k] >= 0 else 0.0)
            along = separation(first, second, anchor, q, k)
            value = change - bend * change
            if bend != 0.0:
                value += bend * along * inward / (r * r)
            add_along(first, second, k, stiffness * value, product)


class BodySpring(Potential):
    """Formulas of a spring between points of bodies; never instantiated."""

    @staticmethod
    @inlined
    def energy(parameters: BodyElastic, q: np.ndarray) -> float:
        """Return V [J]."""
        s = _separation(parameters, q, q, False)
        stretch = np.sqrt(dot(s, s)) - parameters.rest_length
        return 0.5 * parameters.stiffness * stretch * stretch

    @staticmethod
    @inlined
    def add_gradient(parameters: BodyElastic, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V': the pull k (1 - l / r) s, times the derivatives of the ends' positions."""
        s = _separation(parameters, q, q, False)
        r = np.sqrt(dot(s, s))
        # At r = 0 the direction of a spring with l > 0 is undefined; the force is zero there.
        k = parameters.stiffness * (1.0 - (parameters.rest_length / r if r != 0.0 else 0.0))
        _add_pull(parameters, q, (k * s[0], k * s[1], k * s[2]), True, dH_dq)

    @staticmethod
    @inlined
    def add_hessian_vector(parameters: BodyElastic, q: np.ndarray, v: np.ndarray,
                           product: np.ndarray) -> None:
        """Add V'' v."""
        s, ds = _separation(parameters, q, q, False), _separation(parameters, q, v, True)
        r = np.sqrt(dot(s, s))
        bend = parameters.rest_length / r if r != 0.0 else 0.0
        k, inward = parameters.stiffness, bend * dot(s, ds) / (r * r) if r != 0.0 else 0.0
        straight = k * (1.0 - bend)
        _add_pull(parameters, q, (straight * ds[0] + k * inward * s[0],
                                  straight * ds[1] + k * inward * s[1],
                                  straight * ds[2] + k * inward * s[2]), True, product)
        _add_pull(parameters, v, (straight * s[0], straight * s[1], straight * s[2]), False,
                  product)


def _is_body(coordinates: Sequence[Coordinate], names: Sequence[str]) -> bool:
    return list(names) in [[c.name] for c in coordinates if c.kind != 'scalar']


def _three(name: str, values: Sequence[float] | None) -> list[float]:
    """Return three numbers, by default zeros, or raise ValueError."""
    numbers = [0.0] * 3 if values is None else [float(value) for value in values]
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise ValueError(f'{name} = {values} must be three finite numbers')
    return numbers


def _resolve_end(coordinates: Sequence[Coordinate], end: str, names: Sequence[str],
                 in_body: Sequence[float] | None) -> tuple[list[int], list[float]]:
    """Return the columns of an end on a body or in space, and its arm, or raise ValueError."""
    if not _is_body(coordinates, names):
        bodies = listed(c.name for c in coordinates if c.kind != 'scalar') or 'none'
        if in_body is not None or len(names) != 3:
            raise ValueError(f'{end} = {list(names)} must be the name of a body ({bodies})'
                             + ('' if in_body is not None else ' or names of three coordinates'))
        return [*(coordinate_index(coordinates, name) for name in names), -1], _three(end, None)
    q, (name,) = columns(coordinates)[0], names
    # A body that rotates about a fixed point has no coordinates for its position.
    position = [q.index(column) if (column := f'{name}_{axis}') in q else -1 for axis in 'xyz']
    return [*position, q.index(f'{name}_qx')], _three(f'{end}_in_body', in_body)


@inlined
def _end(parameters: BodyElastic, end: int, q: np.ndarray, v: np.ndarray, changes: bool) -> Vector:
    """Return the position of an end, v = q, or if ``changes`` its derivative by q along v."""
    at, arms = parameters.columns, parameters.arms
    arm = (arms[end, 0], arms[end, 1], arms[end, 2])
    if at[end, 3] >= 0:
        arm = rotate_tangent(q, v, at[end, 3], arm) if changes else rotate(q, at[end, 3], arm)
    elif changes:
        arm = (0.0, 0.0, 0.0)
    return (arm[0] + (v[at[end, 0]] if at[end, 0] >= 0 else 0.0),
            arm[1] + (v[at[end, 1]] if at[end, 1] >= 0 else 0.0),
            arm[2] + (v[at[end, 2]] if at[end, 2] >= 0 else 0.0))


@inlined
def _separation(parameters: BodyElastic, q: np.ndarray, v: np.ndarray, changes: bool) -> Vector:
    """Return the vector from the second end to the first, or its derivative; see _end."""
    first, second = _end(parameters, 0, q, v, changes), _end(parameters, 1, q, v, changes)
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@inlined
def _add_pull(parameters: BodyElastic, q: np.ndarray, f: Vector, moves: bool,
              target: np.ndarray) -> None:
    """Add the derivative of f . s by the quaternions at q and, if ``moves``, by the positions."""
    at, arms = parameters.columns, parameters.arms
    for end in range(2):
        pull = f if end == 0 else (-f[0], -f[1], -f[2])
        for k in range(3):
            if moves and at[end, k] >= 0:
                target[at[end, k]] += pull[k]
        if at[end, 3] >= 0:
            add_rotation_slope(q, at[end, 3], (arms[end, 0], arms[end, 1], arms[end, 2]), pull,
                               target)
