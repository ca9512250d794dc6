# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a measured run that belong to one motion: by their times and their numbers."""

from collections.abc import Iterator

import numpy as np

# Larger numbers are no measurements, and their squares no numbers.
MOST = 1e100
# Samples before and after that tell a clock which was set back from samples that are late.
_AROUND = 20
# Least of how a coordinate moves, beyond its noise, for its rates to be judged by it.
_SEEN = 20.0


def clock_resets(t: np.ndarray) -> np.ndarray:
    """
    Return the indices of samples before which the clock was set back, in increasing order.

    Three quarters of those before are then later than three quarters of those after. One stamp
    that is wrong, or some that are late, are no reset.
    """
    found: list[int] = []
    for i in np.flatnonzero(np.diff(t) < 0.0) + 1:
        before, after = t[max(i - _AROUND, 0):i], t[i:i + _AROUND]
        if min(len(before), len(after)) == _AROUND and (not found or i - found[-1] >= _AROUND) \
                and np.quantile(before, 0.25) > np.quantile(after, 0.75):
            found.append(int(i))
    return np.array(found, dtype=int)


def increasing(t: np.ndarray) -> np.ndarray:
    """
    Return the indices of the most samples whose times increase, shape (M,).

    The longest increasing subsequence: a stamp that is far ahead costs one sample, not all that
    follow (M. Fredman, On computing the length of longest increasing subsequences, Discrete
    Mathematics 11, 1975).
    """
    if (np.diff(t) > 0.0).all():
        return np.arange(len(t))
    least: list[float] = []  # the smallest time that ends a subsequence of each length
    ends: list[int] = []
    before = np.full(len(t), -1)
    for i, time in enumerate(t):
        length = int(np.searchsorted(least, time)) if least and time <= least[-1] else len(least)
        before[i] = ends[length - 1] if length else -1
        least[length:length + 1], ends[length:length + 1] = [time], [i]
    chain, at = [], ends[-1]
    while at >= 0:
        chain.append(at)
        at = int(before[at])
    return np.array(chain[::-1])


def unwound(t: np.ndarray, q: np.ndarray, v: np.ndarray | None) -> tuple[np.ndarray, list[int]]:
    """
    Return coordinates that go on where angles jumped by a turn, and which of them did.

    An angle that is kept within one turn jumps by more than half of one from sample to sample,
    and never leaves 2 pi. Rates, where there are some, say how many turns there are between two
    samples; else there are as few as can be.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Times [s].
    q : np.ndarray, shape (N, d)
        Coordinates.
    v : np.ndarray, shape (N, d), or None
        Their rates.

    """
    steps = np.diff(q, axis=0)
    turning = [k for k in range(q.shape[1]) if np.abs(steps[:, k]).max(initial=0.0) > np.pi
               and np.ptp(q[:, k]) <= 2.0 * np.pi * (1.0 + 1e-6)]
    q = q.copy()
    for k in turning:
        expected = 0.0 if v is None else 0.5 * (v[1:, k] + v[:-1, k]) * np.diff(t)
        turns = np.round((expected - steps[:, k]) / (2.0 * np.pi))
        q[1:, k] += 2.0 * np.pi * np.cumsum(turns)
    return q, turning


def unexplained(t: np.ndarray, x: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """
    Return the share of how each coordinate moves that its rates do not tell, shape (d,).

    Of the squares of the changes of x over 1, 2, 4, ... samples, the least share that is left
    when the integral of the rates is taken off: 0 for rates without noise, 1 for rates that are
    zero. Not a number for a coordinate that hardly moves.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Times [s].
    x, rate : np.ndarray, shape (N, d)
        Coordinates, and what is taken for their rates.

    """
    integral = np.zeros_like(x)
    integral[1:] = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None], axis=0)
    return np.array([_share(x[:, k], x[:, k] - integral[:, k]) for k in range(x.shape[1])])


def _share(x: np.ndarray, rest: np.ndarray) -> float:
    changes = np.abs(np.diff(x))
    steps = changes[changes > 0.0]
    if not len(steps):
        return np.nan
    # A sensor tells no less than its quantum, nor than what it jumps by from sample to sample.
    noise = max(float(steps.min()), float(np.median(np.abs(np.diff(x, 2)))))
    shares = [left / moved for moved, left in _squares(x, rest) if moved > (_SEEN * noise)**2]
    return min(shares, default=np.nan)


def _squares(x: np.ndarray, rest: np.ndarray) -> Iterator[tuple[float, float]]:
    """Yield the mean squares of the changes of two signals over 1, 2, 4, ... samples."""
    apart = 1
    while apart <= len(x) // 2:
        yield tuple(float(np.mean((part[apart:] - part[:-apart])**2)) for part in (x, rest))
        apart *= 2
