# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find where a body without motors is held or at rest, which forces not in the log explain."""

from itertools import chain, pairwise

from hnn_vi_ros.errors import listed
from hnn_vi_ros.learning.data.sampling import noise_of
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

# Largest range of a body that is held, as a share of that of its motion, for a hand trembles; and
# of one at rest in standard deviations of the noise: a million normal numbers span ten.
_HELD, _AT_REST = 0.05, 10.0
# Shortest rest before a release, relative to the time in which the highest speed covers the range
# of the motion: half a period of a sinusoid, which stays within _HELD of its end for a seventh of
# one. A pause is twice as long, for a pendulum that turns near the top takes that time.
_REST = 1.5
# Shortest rest between a lift and a release, relative to _REST; the share of the motion that
# follows; and that by which the way of a damped body to a turn differs from that back, or on.
_SHORT, _REMAINS, _MIRRORED = 0.5, 0.7, 0.4
# Growth after a rest that no free body shows, relative to the range of a held one.
_GROWTH = 3.0
# Standard deviations of noise taken off the displacements that show the highest speed.
_SURE = 6.0


def cut_at_rest(t: np.ndarray, q: np.ndarray) -> tuple[list[np.ndarray], str]:
    """
    Cut a free motion where the body stands still: before a release, in a pause, at the end.

    A free body that loses energy stays at rest: what moves again has been held. Its motion is
    symmetric in time about a moment in which all coordinates rest: a lift and a short hold before
    a release are not. A part before such a rest that goes only one way was moved by hand, and is
    left out too.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing times [s].
    q : np.ndarray, shape (N, d)
        Coordinates with angles unwrapped.

    Returns
    -------
    list of np.ndarray of int, and str
        Indices of the samples of each part in motion, and a note on the others, '' for none.

    """
    count, size = len(t), np.ptp(q, axis=0)
    noise = noise_of(q)
    speed = _highest_speed(t, q, noise)
    moves = speed > 0.0
    held = np.maximum(_HELD * size, _AT_REST * noise)[moves]
    n = int(_REST * max(size[moves] / speed[moves], default=np.inf) / np.median(np.diff(t))
            ) + 2 if moves.any() else count
    if n >= count or (_GROWTH * held > size[moves]).any():
        return [np.arange(count)], ''
    ranges = _ranges(q[:, moves], n)
    grows = np.flatnonzero((ranges > _GROWTH * held).any(axis=1))
    rests = [(i, j) for i, j in _runs_of((ranges <= held).all(axis=1), n)
             if j < grows.max(initial=0) + n and (i == 0 or j - i >= 2 * n)]
    short = int(_SHORT * n)
    for i, j in _runs_of((_ranges(q[:, moves], short) <= held).all(axis=1), short):
        first = max((end for _, end in rests if end <= i), default=0)
        if i > first and j < grows.max(initial=0) + n and all(
                j <= one or end <= i for one, end in rests) \
                and (np.ptp(q[j:], axis=0) > _REMAINS * size)[moves].any() \
                and _goes_one_way(q[first:i, moves], held) and not _turns(q[:, moves], i, j, n):
            rests.append((i, j))
    parts = [*pairwise([0, *chain(*sorted(rests)), count])][::2]
    by_hand = [(i, j) for i, j in parts[:-1] if _goes_one_way(q[i:j, moves], held)]
    # Means of an eighth of the shortest rest show how a motion fades in the noise.
    means = uniform_filter1d(q[:, moves], few := max(n // 8, 1), axis=0)
    faded = _ranges(means, n) <= _AT_REST / few**0.5 * noise[moves]
    end = [(i, j) for i, j in _runs_of(faded.all(axis=1), n) if j == count]
    parts = [part for part in parts if part not in by_hand and part[0] < part[1]]
    if end and end[0][0] > parts[-1][0]:
        parts[-1] = parts[-1][0], end[0][0]
        rests += end
    text = '; '.join(f'{what} from {listed(f"{t[i]:.4g} to {t[j - 1]:.4g} s" for i, j in where)}'
                     for what, where in (('stands still', rests), ('moved by hand', [
                         (i, j) for i, j in by_hand if j > i])) if where)
    return [np.arange(i, j) for i, j in parts], f'{text}, left out' if text else ''


def _highest_speed(t: np.ndarray, q: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the highest speed of each coordinate that noise does not explain, shape (d,)."""
    speed, lag = np.zeros(q.shape[1]), 1
    while lag < len(t):
        moved = np.abs(q[lag:] - q[:-lag]) - _SURE * noise
        speed = np.maximum(speed, (moved / (t[lag:] - t[:-lag])[:, None]).max(axis=0))
        lag *= 2
    return speed


def _ranges(q: np.ndarray, n: int) -> np.ndarray:
    """Return the range of n successive samples from each one on, shape (N - n + 1, d)."""
    span = maximum_filter1d(q, n, axis=0) - minimum_filter1d(q, n, axis=0)
    return span[n // 2:n // 2 + len(q) - n + 1]


def _runs_of(windows: np.ndarray, n: int) -> list[tuple[int, int]]:
    """Return first and last index + 1 of the samples that such windows of n samples cover."""
    steps = np.zeros(len(windows) + n + 1, dtype=int)
    steps[1:len(windows) + 1] += windows
    steps[n + 1:] -= windows
    covered = np.cumsum(steps) > 0
    edges = np.flatnonzero(np.diff(covered.astype(int), append=0))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]


def _turns(q: np.ndarray, i: int, j: int, n: int) -> bool:
    """Return whether the motion before a rest is that after it, backward or on the other side."""
    n = min(n, i, len(q) - j)
    before, after, place = q[i - n:i][::-1], q[j:j + n], 0.5 * (q[i] + q[j - 1])
    most = _MIRRORED * np.abs(after - place).max(initial=0.0)
    return bool(min(np.abs(before - after).max(initial=0.0), np.abs(
        before + after - 2.0 * place).max(initial=0.0)) <= most)


def _goes_one_way(x: np.ndarray, band: np.ndarray) -> bool:
    """Return True if no coordinate comes back by more than a band."""
    return not len(x) or bool(all(
        (np.maximum.accumulate(sign * column) - sign * column).max() <= width
        for column, width in zip(x.T, band, strict=True)
        for sign in [1.0 if column[-1] >= column[0] else -1.0]))
