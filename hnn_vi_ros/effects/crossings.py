# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The search for the first time at which a distance becomes negative within a step."""

from typing import NamedTuple

from hnn_vi_ros.integrators.dense_output import cubic, quintic
from hnn_vi_ros.kernels.marks import called
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# What is to be done next: nothing more, a trial of another length, or the crossing is there.
FREE, TRY, LAND, LOST = 0, 1, 2, 3
# Parts of an interval in each of which the polynomial is looked at.
_PARTS = 8
_HALVINGS = 60
# Intervals, at most, that wait to be looked at, and trials for one crossing.
_MOST_INTERVALS = 64
_MOST_TRIALS = 300
# Of the step: a distance that touches zero from above for a shorter time does not cross it.
_SHORTEST = 1e-10


class Search(NamedTuple):
    """
    Bounds on a distance g(t) within a step, at the ends of intervals that are not clear.

    Parameters
    ----------
    nodes : np.ndarray, shape (66, 5)
        t, g, g' and g'' there, and how far g may be from the polynomial to the left. First the
        start of the first interval, then the intervals' right ends, the last of all first.
    count : np.ndarray, shape (2,)
        Intervals, and trials so far.
    widths : np.ndarray, shape (3,)
        Of the interval of the crossing in the last trials, the newest first [s].

    """

    nodes: np.ndarray
    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    widths: np.ndarray

    @classmethod
    def empty(cls) -> 'Search':
        """Return a search that has not begun."""
        return cls(np.zeros((_MOST_INTERVALS + 2, 5)), np.zeros(2, dtype=np.int64), np.zeros(3))

    @classmethod
    def several(cls, number: int) -> 'Search':
        """Return so many that have not begun, one a row."""
        return cls(*(np.stack([part] * number) for part in cls.empty()))


@called
def begin(search: Search, distance: float, slope: float, bend: float) -> None:
    """Begin at t = 0."""
    nodes = search.nodes
    nodes[0, 0], nodes[0, 1], nodes[0, 2], nodes[0, 3] = 0.0, distance, slope, bend
    search.count[0], search.count[1] = 0, 0
    for k in range(3):
        search.widths[k] = np.inf


@called
def add(search: Search, t: float, distance: float, slope: float, bend: float, rounding: float,
        high: bool) -> None:
    """
    Take in the result of a trial: the first at the end of the step, others where TRY said.

    Parameters
    ----------
    search : Search
        Which is changed.
    t, distance, slope, bend : float
        The time [s], g, g' and g'' there.
    rounding : float
        Of g.
    high : bool
        Whether g'' is known, so that polynomials are quintic.

    """
    nodes, count = search.nodes, search.count
    top = count[0]
    if top == 0:
        # No more is known of the polynomial's error than how much the path bends. Beyond the
        # half of that it would have to turn round within the step more than once.
        length, mean = t, 0.5 * (nodes[0, 2] + slope)
        margin = 0.5 * (abs(length * (slope - nodes[0, 2])) / 8.0
                        + 0.5 * abs(distance - nodes[0, 1] - length * mean))
        if high:
            margin = 0.5 * margin + length * length * (abs(bend) + abs(nodes[0, 3])) / 64.0
    else:
        length = nodes[top, 0] - nodes[0, 0]
        expected = _value(_coefficients(search, high), (t - nodes[0, 0]) / length)
        # In a part of the interval the error is several times less.
        margin = abs(distance - expected) + rounding
        if distance < 0.0:
            # What comes after is of no interest.
            top = 0
        else:
            nodes[top, 4] = margin
    top += 1
    nodes[top, 0], nodes[top, 1], nodes[top, 2], nodes[top, 3] = t, distance, slope, bend
    nodes[top, 4] = margin
    count[0], count[1] = top, count[1] + 1


@called
def seek(search: Search, h: float, rounding: float, high: bool) -> tuple[int, float]:
    """
    Return what is to be done next, and at what time.

    FREE: g does not become negative. LAND: it does, first at this time, as near as rounding and
    time itself resolve. TRY: what g is at this time must be known. LOST: no end is in sight.
    """
    nodes, count, widths = search.nodes, search.count, search.widths
    while count[0] > 0:
        if nodes[0, 1] <= rounding and nodes[0, 2] < 0.0:
            return LAND, nodes[0, 0]
        top = count[0]
        start, end = nodes[0, 0], nodes[top, 0]
        if count[1] > _MOST_TRIALS or top >= _MOST_INTERVALS:
            return LOST, end
        theta = _look(search, high)
        if nodes[top, 1] < 0.0:
            if (-nodes[top, 1] <= rounding and nodes[top, 2] < 0.0) or end - start <= _EPS * h:
                return LAND, end
            if theta == 0.0 and nodes[0, 1] <= rounding:
                # It is at rest there, and pulled.
                return LAND, start
            if end - start > 0.5 * widths[2]:
                # Three trials have not halved the interval.
                theta = 0.5
            widths[2], widths[1], widths[0] = widths[1], widths[0], end - start
            middle = start + theta * (end - start)
            if not start < middle < end:
                middle = 0.5 * (start + end)
            return (TRY, middle) if start < middle < end else (LAND, end)
        if theta < 0.0 or end - start <= _SHORTEST * h:
            for k in range(5):
                nodes[0, k] = nodes[top, k]
            count[0] -= 1
        else:
            # At a minimum that lies at an end of the interval nothing new would be learned.
            return TRY, start + (theta if 0.05 < theta < 0.95 else 0.5) * (end - start)
    return FREE, 0.0


@called
def _coefficients(search: Search, high: bool) -> tuple[float, ...]:
    """Return those of the polynomial of the first interval, in shares of it."""
    nodes, top = search.nodes, search.count[0]
    h = nodes[top, 0] - nodes[0, 0]
    if high:
        return quintic(h, nodes[0, 1], nodes[0, 2], nodes[0, 3],
                       nodes[top, 1], nodes[top, 2], nodes[top, 3])
    return cubic(h, nodes[0, 1], nodes[0, 2], nodes[top, 1], nodes[top, 2])


@called
def _value(c: tuple[float, ...], x: float) -> float:
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


@called
def _slope(c: tuple[float, ...], x: float) -> float:
    return c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * (4.0 * c[4] + x * 5.0 * c[5])))


@called
def _look(search: Search, high: bool) -> float:
    """
    Return where in the first interval g crosses zero first, or is nearest to it.

    -1 if g stays above zero there by more than the polynomial's error, which vanishes with its
    square at both ends; only where g is not negative at the end.
    """
    c = _coefficients(search, high)
    top = search.count[0]
    margin, crosses = search.nodes[top, 4], search.nodes[top, 1] < 0.0
    lowest, place = np.inf, -1.0
    left = 0.0
    for k in range(_PARTS):
        right = (k + 1.0) / _PARTS
        if _slope(c, left) < 0.0 < _slope(c, right):
            dip = _last(c, True, left, right)
        else:
            dip = right
        for x in (dip, right):
            value = _value(c, x)
            if value < 0.0 and (crosses or x < 1.0):
                return _last(c, False, left, x)
            excess = value - 16.0 * margin * (x * (1.0 - x)) ** 2
            if x < 1.0 and excess < 0.0 and value < lowest:
                lowest, place = value, x
        left = right
    # A polynomial that ends below zero crosses it, whatever rounding says.
    return 0.5 if crosses and place < 0.0 else place


@called
def _last(c: tuple[float, ...], falling: bool, low: float, high: float) -> float:
    """Return, by bisection, until where the polynomial falls, or else is not negative."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (_slope(c, middle) < 0.0) if falling else (_value(c, middle) >= 0.0):
            low = middle
        else:
            high = middle
    return low
