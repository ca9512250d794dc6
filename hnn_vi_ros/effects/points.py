# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of points, for what acts between two of them: springs and rods."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Elastic(NamedTuple):
    """Two points, or a point and an anchor, see resolve_pair; stiffness k and rest length l."""

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    stiffness: float
    rest_length: float


def check_pair(other: Sequence[str] | None, anchor: Sequence[float] | None) -> None:
    """Raise ValueError unless one of the two is given."""
    if (other is None) == (anchor is None):
        raise ValueError('give either other (the names of a second point) or anchor (a place)')


def resolve_pair(coordinates: Sequence[Coordinate], point: Sequence[str],
                 other: Sequence[str] | None, anchor: Sequence[float] | None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the places of a point's coordinates, those of the other point's, and an anchor.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Of the system.
    point : sequence of str
        Names of the point's coordinates.
    other : sequence of str, optional
        Names of the other point's.
    anchor : sequence of float, optional
        A fixed point in its place.

    Returns
    -------
    tuple of np.ndarray, shape (n,)
        Places of the point's n coordinates; those of the other, -1 for an anchor; the anchor,
        zeros where there is none.

    Raises
    ------
    ValueError
        Unknown coordinates, or not exactly one of ``other`` and ``anchor``, of the same length.

    """
    check_pair(other, anchor)
    second: Sequence[object] = (anchor if other is None else other) or ()
    if not point or len(second) != len(point):
        raise ValueError(f'{"anchor" if other is None else "other"} has {len(second)} entries, '
                         f'point has {len(point)}: expected the same number, at least 1')
    if len(set(point)) < len(point):
        raise ValueError(f'point = {list(point)} must name different coordinates')
    first = np.array([coordinate_index(coordinates, name) for name in point])
    if other is None:
        return first, np.full(first.size, -1), np.array(anchor, dtype=np.float64)
    places = np.array([coordinate_index(coordinates, name) for name in other])
    if set(first) & set(places) or len(set(places)) < places.size:
        raise ValueError('point and other must name different coordinates, each once')
    return first, places, np.zeros(first.size)


@inlined
def separation(first: np.ndarray, second: np.ndarray, anchor: np.ndarray, q: np.ndarray, k: int
               ) -> float:
    """Return component k of the vector from the second point to the first."""
    if second[k] < 0:
        return q[first[k]] - anchor[k]
    return q[first[k]] - q[second[k]]


@inlined
def distance(first: np.ndarray, second: np.ndarray, anchor: np.ndarray, q: np.ndarray) -> float:
    """Return the distance of the two points; signed where they have one coordinate."""
    if first.size == 1:
        return separation(first, second, anchor, q, 0)
    square = 0.0
    for k in range(first.size):
        component = separation(first, second, anchor, q, k)
        square += component * component
    return np.sqrt(square)


@inlined
def add_along(first: np.ndarray, second: np.ndarray, k: int, value: float, target: np.ndarray
              ) -> None:
    """Add a value to component k of the first point, and take it from that of the second."""
    target[first[k]] += value
    if second[k] >= 0:
        target[second[k]] -= value


@inlined
def add_curvature(parameters: Elastic, q: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
    """Add V'' v of a spring."""
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
