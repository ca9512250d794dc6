# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A search for jumps of H and its gradient, where functions such as abs switch."""

from collections.abc import Callable

import numpy as np

# Crossings examined of each switch and of all; halvings of the line up to a crossing.
_PER_SWITCH, _MAX_CROSSINGS, _HALVINGS = 16, 256, 45
# Two distances from a crossing, and a distance that shows the size of the values, as fractions of
# the line. Between the first two, |x|^(1 + a) with a > 0.1 changes its slope by a factor above 2.
_NEAR, _FURTHER, _AROUND = 2.0**-42, 2.0**-32, 2.0**-10
# Smallest jump, relative to the values around; terms that cancel round to 1e-9 of these.
_MIN_JUMP = 1e-6


def is_continuous(values: Callable[[np.ndarray], np.ndarray], count: int, lines: np.ndarray
                  ) -> bool:
    """
    Return whether H and its gradient are continuous where switches change their sign along lines.

    Each crossing is found by bisection. A jump is a change across it that stays as large as the
    crossing is approached; near a switch that composes to a smooth function, as in abs(x)^3, the
    change tends to zero.

    Parameters
    ----------
    values : callable
        Returns rows of values of states, shape (m, n): H, its gradient, then the switches, numbers
        at whose zeros H may have a kink.
    count : int
        Number of values before the switches.
    lines : np.ndarray, shape (2, lines, n)
        Both ends of random lines.

    """
    with np.errstate(all='ignore'):
        first, last = (np.sign(values(ends)[:, count:]) for ends in lines)
        pairs = [(row, k) for k, crossed in enumerate((first * last < 0.0).T)
                 for row in np.flatnonzero(crossed)[:_PER_SWITCH]]
        if not pairs:
            return True
        rows, columns = np.array(pairs[::-(-len(pairs) // _MAX_CROSSINGS)]).T
        start, way = lines[0, rows], lines[1, rows] - lines[0, rows]
        low, high = np.zeros((len(rows), 1)), np.ones((len(rows), 1))
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            now = np.sign(values(start + middle * way)[np.arange(len(rows)), count + columns])
            before = (now == first[rows, columns])[:, None]
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        near, further, around = (
            np.array([values(start + (low - w) * way), values(start + (high + w) * way)])
            for w in (_NEAR, _FURTHER, _AROUND))
        jump, change = (np.abs(both[1] - both[0])[:, :count] for both in (near, further))
        size = np.abs(around).max(axis=0)[:, :count]
        # Entries of the gradient are compared with the largest of them.
        size[:, 1:] = size[:, 1:].max(axis=1, keepdims=True)
        return not ((jump > 0.5 * change) & (jump > _MIN_JUMP * size)).any()
