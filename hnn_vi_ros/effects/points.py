# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of points in coordinates, for springs and rods."""

from collections.abc import Sequence

from hnn_vi_ros.effects.base import coordinate_index
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


def check_pair(other: Sequence[str] | None, anchor: Sequence[float] | None) -> None:
    """Raise ValueError unless exactly one of the two is given."""
    if (other is None) == (anchor is None):
        raise ValueError('give either other (the names of a second point) or anchor (a position)')


def resolve_pair(coordinates: Sequence[Coordinate], point: Sequence[str],
                 other: Sequence[str] | None, anchor: Sequence[float] | None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the columns of the coordinates of two points, and an anchor.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        The coordinates of the system.
    point : sequence of str
        Names of the n coordinates of the first point.
    other : sequence of str, optional
        Names of the coordinates of the second point, or
    anchor : sequence of float, optional
        its fixed position.

    Returns
    -------
    first, second, anchor : np.ndarray, shape (n,)
        Columns of the first point; columns of the second, -1 for an anchor; the anchor, zeros for
        a second point.

    Raises
    ------
    ValueError
        A coordinate is unknown, or not exactly one of ``other`` and ``anchor`` is given with n
        entries.

    """
    check_pair(other, anchor)
    second: Sequence[object] = (anchor if other is None else other) or ()
    if not point or len(second) != len(point):
        raise ValueError(f'{"anchor" if other is None else "other"} has {len(second)} entries '
                         f'but point has {len(point)}, expected the same number, at least 1')
    if len(set(point)) < len(point):
        raise ValueError(f'point = {list(point)} must name different coordinates')
    first = np.array([coordinate_index(coordinates, name) for name in point])
    if other is None:
        return first, np.full(first.size, -1), np.array(anchor, dtype=np.float64)
    second_columns = np.array([coordinate_index(coordinates, name) for name in other])
    if set(first) & set(second_columns) or len(set(second_columns)) < second_columns.size:
        raise ValueError('point and other must name different coordinates, each once')
    return first, second_columns, np.zeros(first.size)


@inlined
def separation(first: np.ndarray, second: np.ndarray, anchor: np.ndarray, q: np.ndarray, k: int
               ) -> float:
    """Return component k of the vector from the second point to the first."""
    if second[k] < 0:
        return q[first[k]] - anchor[k]
    return q[first[k]] - q[second[k]]


@inlined
def distance(first: np.ndarray, second: np.ndarray, anchor: np.ndarray, q: np.ndarray) -> float:
    """Return the distance of the two points, with a sign if they have one coordinate."""
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
    """Add a value to component k of the first point, and subtract it from the second's."""
    target[first[k]] += value
    if second[k] >= 0:
        target[second[k]] -= value
