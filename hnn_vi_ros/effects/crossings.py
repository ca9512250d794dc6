# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the first time within a step at which a distance becomes negative."""

from typing import NamedTuple

from hnn_vi_ros.integrators import cubic, quintic, slope_at, value_at
from hnn_vi_ros.kernels import called
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Next actions: stop without a crossing, try another length, land on the crossing, give up.
FREE, TRY, LAND, LOST = 0, 1, 2, 3
# Number of parts of an interval in which a polynomial is examined: enough to separate the roots of
# paths that turn a few times in a step.
_PARTS = 8
_MAX_HALVINGS = 60
# Maximum number of intervals that wait for a search, and of trials for one crossing; they
# determine the size of arrays. Well-behaved paths need a few of each.
_MAX_INTERVALS = 64
_MAX_TRIALS = 300
# A distance that is below zero for less than this fraction of the step does not count as a
# crossing. Otherwise a path that only touches would divide intervals indefinitely.
_MIN_CROSSING = 1e-10


class Search(NamedTuple):
    """
    Values of a distance g(t) within a step, at the ends of intervals that are still searched.

    Parameters
    ----------
    nodes : np.ndarray, shape (66, 5)
        t, g, g' and g'' at an end, and the error bound of the polynomial to its left. Row 0 is the
        start of the first interval; then follow the right ends of the intervals, the last interval
        first.
    counts : np.ndarray, shape (2,)
        Number of intervals, and of trials so far.
    widths : np.ndarray, shape (3,)
        Widths of the interval of the crossing in the last trials, the newest first [s].

    """

    nodes: np.ndarray
    counts: np.ndarray
    widths: np.ndarray

    @classmethod
    def empty(cls) -> 'Search':
        """Return a search that has not begun."""
        return cls(np.zeros((_MAX_INTERVALS + 2, 5)), np.zeros(2, dtype=np.int64), np.zeros(3))

    @classmethod
    def several(cls, number: int) -> 'Search':
        """Return this number of searches, one in each row."""
        return cls(*(np.stack([part] * number) for part in cls.empty()))


@called
def begin_search(search: Search, distance: float, slope: float, bend: float) -> None:
    """Begin a search at t = 0."""
    nodes = search.nodes
    nodes[0, 0], nodes[0, 1], nodes[0, 2], nodes[0, 3] = 0.0, distance, slope, bend
    search.counts[0], search.counts[1] = 0, 0
    for k in range(3):
        search.widths[k] = np.inf


@called
def add_trial(search: Search, t: float, distance: float, slope: float, bend: float,
              rounding: float, high: bool) -> None:
    """
    Add the result of a trial, first at the end of the step, then at the times of TRY.

    Parameters
    ----------
    search : Search
        The search, which is changed.
    t, distance, slope, bend : float
        The time [s], and g, g' and g'' at that time.
    rounding : float
        Rounding error of g.
    high : bool
        True if g'' is known, so that polynomials are quintic instead of cubic.

    """
    nodes, counts = search.nodes, search.counts
    top = counts[0]
    if top == 0:
        # The only information on the error of the polynomial is the curvature of the path. An
        # error above half of that would require the path to turn more than once in the step.
        length, mean = t, 0.5 * (nodes[0, 2] + slope)
        margin = 0.5 * (abs(length * (slope - nodes[0, 2])) / 8.0
                        + 0.5 * abs(distance - nodes[0, 1] - length * mean))
        if high:
            margin = 0.5 * margin + length * length * (abs(bend) + abs(nodes[0, 3])) / 64.0
    else:
        length = nodes[top, 0] - nodes[0, 0]
        expected = value_at(_coefficients(search, high), (t - nodes[0, 0]) / length)
        # The observed error of the polynomial bounds the next one, which is several times smaller,
        # because its interval is shorter.
        margin = abs(distance - expected) + rounding
        if distance < 0.0:
            # Only the first crossing matters; later intervals are dropped.
            top = 0
        else:
            nodes[top, 4] = margin
    top += 1
    nodes[top, 0], nodes[top, 1], nodes[top, 2], nodes[top, 3] = t, distance, slope, bend
    nodes[top, 4] = margin
    counts[0], counts[1] = top, counts[1] + 1


@called
def next_trial(search: Search, h: float, rounding: float, high: bool) -> tuple[int, float]:
    """
    Return the next action and its time.

    FREE: g does not become negative. LAND: it first does at this time, to the resolution of
    rounding and of time itself. TRY: g must be evaluated at this time. LOST: the search does not
    terminate.
    """
    nodes, counts, widths = search.nodes, search.counts, search.widths
    while counts[0] > 0:
        if nodes[0, 1] <= rounding and nodes[0, 2] < 0.0:
            return LAND, nodes[0, 0]
        top = counts[0]
        start, end = nodes[0, 0], nodes[top, 0]
        if counts[1] > _MAX_TRIALS or top >= _MAX_INTERVALS:
            return LOST, end
        theta = _first_crossing(search, high)
        if nodes[top, 1] < 0.0:
            if (-nodes[top, 1] <= rounding and nodes[top, 2] < 0.0) or end - start <= _EPS * h:
                return LAND, end
            if theta == 0.0 and nodes[0, 1] <= rounding:
                # g is at rest at the start and accelerates downwards.
                return LAND, start
            if end - start > 0.5 * widths[2]:
                # Three trials have not halved the interval. Interpolation may approach the
                # crossing from one side only, so bisect.
                theta = 0.5
            widths[2], widths[1], widths[0] = widths[1], widths[0], end - start
            middle = start + theta * (end - start)
            if not start < middle < end:
                middle = 0.5 * (start + end)
            return (TRY, middle) if start < middle < end else (LAND, end)
        # A path that rises at both ends, known to rounding, has no crossing that can be resolved.
        if theta < 0.0 or end - start <= _MIN_CROSSING * h or (
                nodes[top, 4] <= 2.0 * rounding and nodes[0, 2] > 0.0 and nodes[top, 2] > 0.0):
            for k in range(5):
                nodes[0, k] = nodes[top, k]
            counts[0] -= 1
        else:
            # A trial close to an end of the interval would add no information.
            return TRY, start + (theta if 0.05 < theta < 0.95 else 0.5) * (end - start)
    return FREE, 0.0


@called
def _coefficients(search: Search, high: bool) -> tuple[float, ...]:
    """Return the coefficients of the polynomial of the first interval, scaled to [0, 1]."""
    nodes, top = search.nodes, search.counts[0]
    h = nodes[top, 0] - nodes[0, 0]
    if high:
        return quintic(h, nodes[0, 1], nodes[0, 2], nodes[0, 3],
                       nodes[top, 1], nodes[top, 2], nodes[top, 3])
    return cubic(h, nodes[0, 1], nodes[0, 2], nodes[top, 1], nodes[top, 2])


@called
def _first_crossing(search: Search, high: bool) -> float:
    """
    Return the fraction of the first interval where g first crosses zero, or is nearest to it.

    If g is not negative at the end, the result is -1 if g stays above zero by more than the error
    of the polynomial. The bound of that error vanishes quadratically at both ends, like the error
    of Hermite interpolation.
    """
    c = _coefficients(search, high)
    top = search.counts[0]
    margin, crosses = search.nodes[top, 4], search.nodes[top, 1] < 0.0
    lowest, place = np.inf, -1.0
    left = 0.0
    for k in range(_PARTS):
        right = (k + 1.0) / _PARTS
        if slope_at(c, left) < 0.0 < slope_at(c, right):
            dip = _last(c, True, left, right)
        else:
            dip = right
        for x in (dip, right):
            value = value_at(c, x)
            if value < 0.0 and (crosses or x < 1.0):
                return _last(c, False, left, x)
            excess = value - 16.0 * margin * (x * (1.0 - x)) ** 2
            if x < 1.0 and excess < 0.0 and value < lowest:
                lowest, place = value, x
        left = right
    # A polynomial that is negative at the end has a crossing, even if rounding hides it.
    return 0.5 if crosses and place < 0.0 else place


@called
def _last(c: tuple[float, ...], falling: bool, low: float, high: float) -> float:
    """Return by bisection the end of the falling part of a polynomial, or of the positive part."""
    for _ in range(_MAX_HALVINGS):
        middle = 0.5 * (low + high)
        if (slope_at(c, middle) < 0.0) if falling else (value_at(c, middle) >= 0.0):
            low = middle
        else:
            high = middle
    return low
