# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A spring whose ends are fixed to bodies that turn."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.attitudes import add_turned_slope, dot, turned, turned_change, Vector
from hnn_vi_ros.effects.base import coordinate_index, EffectState, Potential
from hnn_vi_ros.effects.points import check_pair
from hnn_vi_ros.errors import listed
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import columns, Coordinate
import numpy as np


class BodyElastic(NamedTuple):
    """
    Two ends in space; stiffness k and rest length l.

    Parameters
    ----------
    columns : np.ndarray of int, shape (2, 4)
        Of each end the columns in q of its place, and of the quaternion that turns its arm; -1
        where there is none.
    arms : np.ndarray, shape (2, 3)
        What is added to the place, or the place where there is no other: of a body in its frame.
    stiffness, rest_length : float
        See Spring.

    """

    columns: np.ndarray
    arms: np.ndarray
    stiffness: float
    rest_length: float


class BodySpring(Potential):
    """
    The potential of Spring between points of bodies.

    Parameters
    ----------
    ends, in_body : tuple
        The parameters point, other and anchor of Spring; and where on their bodies they are.
    stiffness, rest_length : float
        See Spring.

    """

    turns = True

    def __init__(self, ends: tuple[Sequence[str], Sequence[str] | None, Sequence[float] | None],
                 in_body: tuple[Sequence[float] | None, Sequence[float] | None],
                 stiffness: float, rest_length: float):
        self._ends, self._in_body = ends, in_body
        self._stiffness, self._rest_length = stiffness, rest_length

    def applies(self, coordinates: Sequence[Coordinate]) -> bool:
        """Return whether an end is on a body, or said to be."""
        point, other, _ = self._ends
        return any(place is not None for place in self._in_body) or any(
            _is_body(coordinates, names) for names in (point, other or ()))

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> BodyElastic:
        """Return the ends, the stiffness [N/m] and the length at rest [m]."""
        point, other, anchor = self._ends
        check_pair(other, anchor)
        ends = [_resolve_end(coordinates, 'point', point, self._in_body[0])]
        if other is not None:
            ends.append(_resolve_end(coordinates, 'other', other, self._in_body[1]))
            if list(point) == list(other):
                raise ValueError('point and other must be of different bodies')
        else:
            if self._in_body[1] is not None:
                raise ValueError('other_in_body is given without other; leave it out')
            ends.append(([-1] * 4, _three('anchor', anchor)))
        places, arms = zip(*ends, strict=True)
        return BodyElastic(np.array(places), np.array(arms), self._stiffness, self._rest_length)

    @staticmethod
    @inlined
    def energy(parameters: BodyElastic, q: np.ndarray) -> float:
        """Return V [J]."""
        s = _separation(parameters, q)
        stretch = np.sqrt(dot(s, s)) - parameters.rest_length
        return 0.5 * parameters.stiffness * stretch * stretch

    @staticmethod
    @inlined
    def add_gradient(parameters: BodyElastic, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V', the pull k (1 - l / r) s along each end's ways to move."""
        s = _separation(parameters, q)
        r = np.sqrt(dot(s, s))
        # At r = 0 the direction of a spring at rest length l > 0 is undefined: no force.
        k = parameters.stiffness * (1.0 - (parameters.rest_length / r if r != 0.0 else 0.0))
        _add_pull(parameters, q, (k * s[0], k * s[1], k * s[2]), True, dH_dq)

    @staticmethod
    @inlined
    def add_hessian_vector(parameters: BodyElastic, q: np.ndarray, v: np.ndarray,
                           product: np.ndarray) -> None:
        """Add V'' v."""
        s, ds = _separation(parameters, q), _separation_change(parameters, q, v)
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
    """Return three numbers, zeros for none, or raise ValueError."""
    numbers = [0.0] * 3 if values is None else [float(value) for value in values]
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise ValueError(f'{name} = {values} must be three finite numbers')
    return numbers


def _resolve_end(coordinates: Sequence[Coordinate], end: str, names: Sequence[str],
                 in_body: Sequence[float] | None) -> tuple[list[int], list[float]]:
    """Return the columns of an end, and its arm, or raise ValueError."""
    if not _is_body(coordinates, names):
        bodies = listed(c.name for c in coordinates if c.kind != 'scalar') or 'none'
        if in_body is not None or len(names) != 3:
            raise ValueError(f'{end} = {list(names)} must be the name of a body ({bodies})'
                             + ('' if in_body is not None else ', or of three coordinates'))
        return [*(coordinate_index(coordinates, name) for name in names), -1], _three(end, None)
    q, (name,) = columns(coordinates)[0], names
    # A body that turns about a point has no place of its own.
    place = [q.index(column) if (column := f'{name}_{axis}') in q else -1 for axis in 'xyz']
    return [*place, q.index(f'{name}_qx')], _three(f'{end}_in_body', in_body)


@inlined
def _end(parameters: BodyElastic, end: int, q: np.ndarray) -> Vector:
    """Return the place of an end."""
    at, arms = parameters.columns, parameters.arms
    arm = (arms[end, 0], arms[end, 1], arms[end, 2])
    if at[end, 3] >= 0:
        arm = turned(q, at[end, 3], arm)
    return (arm[0] + (q[at[end, 0]] if at[end, 0] >= 0 else 0.0),
            arm[1] + (q[at[end, 1]] if at[end, 1] >= 0 else 0.0),
            arm[2] + (q[at[end, 2]] if at[end, 2] >= 0 else 0.0))


@inlined
def _separation(parameters: BodyElastic, q: np.ndarray) -> Vector:
    """Return the vector from the second end to the first."""
    first, second = _end(parameters, 0, q), _end(parameters, 1, q)
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@inlined
def _end_change(parameters: BodyElastic, end: int, q: np.ndarray, v: np.ndarray) -> Vector:
    """Return how an end moves as q does along v."""
    at, arms, arm = parameters.columns, parameters.arms, (0.0, 0.0, 0.0)
    if at[end, 3] >= 0:
        arm = turned_change(q, v, at[end, 3], (arms[end, 0], arms[end, 1], arms[end, 2]))
    return (arm[0] + (v[at[end, 0]] if at[end, 0] >= 0 else 0.0),
            arm[1] + (v[at[end, 1]] if at[end, 1] >= 0 else 0.0),
            arm[2] + (v[at[end, 2]] if at[end, 2] >= 0 else 0.0))


@inlined
def _separation_change(parameters: BodyElastic, q: np.ndarray, v: np.ndarray) -> Vector:
    """Return how the vector between the ends changes as q does along v."""
    first, second = _end_change(parameters, 0, q, v), _end_change(parameters, 1, q, v)
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@inlined
def _add_pull(parameters: BodyElastic, q: np.ndarray, f: Vector, moves: bool,
              target: np.ndarray) -> None:
    """Add f . s's derivative by the quaternions at q; and, if it moves, by the places."""
    at, arms = parameters.columns, parameters.arms
    for end in range(2):
        pull = f if end == 0 else (-f[0], -f[1], -f[2])
        for k in range(3):
            if moves and at[end, k] >= 0:
                target[at[end, k]] += pull[k]
        if at[end, 3] >= 0:
            add_turned_slope(q, at[end, 3], (arms[end, 0], arms[end, 1], arms[end, 2]), pull,
                             target)
