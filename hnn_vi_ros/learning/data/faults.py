# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Find the samples of a measured motion that its sensor got wrong."""

from collections.abc import Sequence

from hnn_vi_ros.errors import counted, DataError
import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

# Samples of the running median, which follows ramps and steps and ignores up to three outliers,
# and of the median step around each sample.
_MEDIAN, _AROUND = 7, 17
# Largest distance from the running median, in median steps: a sinusoid reaches 2.1 (at 6 samples
# a period), white noise 5.8 (five standard deviations). Velocities may jump in impacts.
_FAR_POSITION, _FAR_VELOCITY = 7.0, 14.0
# A step that stays is a fault if it is this many times the usual one, and larger than its
# neighbours by the second factor.
_SHIFT, _ALONE = 10.0, 3.0
# Distance from the mean of the neighbours, in usual steps, and how often a value comes that stands
# for none: at least, and relative to other values.
_OFF, _AGAIN, _OFTEN = 2.0, 3, 5.0
# Largest share of faults that is left out: with more, the usual step is no longer known.
_MAX_SHARE = 0.1
# Equal samples in a row that may be a stuck sensor; the share of other equal neighbours below
# which a sensor never repeats a value by itself; the speed, relative to the usual one, that is
# fast; that with which no rest begins or ends; and the share of values repeated equally often
# above which a sensor is slower than its log.
_EQUAL, _NEVER, _FAST, _ABRUPT, _REGULAR = 5, 0.01, 0.3, 0.6, 0.9

# Smallest time [s] that is shown as a date, that of 1 January 2000: robots have logged since then.
_SINCE_1970 = 946684800.0


def times_text(t: np.ndarray) -> str:
    """Return the first of some times for a message, such as ``' (at 0.5, 1, ... s)'``."""
    if len(t) and t[0] > _SINCE_1970:
        dates = [str(np.datetime64(round(1e3 * time), 'ms')) for time in t[:4].tolist()]
        return f' (at {", ".join(dates)}{", ..." * (len(t) > 4)})'
    return f' (at {", ".join(f"{time:.6g}" for time in t[:4])}{", ..." * (len(t) > 4)} s)'


def faults(t: np.ndarray, q: np.ndarray, v: np.ndarray | None, labels: Sequence[str], where: str,
           sticks: bool = False) -> tuple[np.ndarray, list[str]]:
    """
    Find glitches and stuck sensors.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing times [s].
    q : np.ndarray, shape (N, d)
        Coordinates; angles may be wrapped.
    v : np.ndarray, shape (N, d), or None
        Velocities.
    labels : sequence of str
        Names of the coordinates, then of the velocities, for notes and error messages.
    where : str
        File and run, for error messages.
    sticks : bool, optional
        True if joints stick and start at once, as servos do: no sensor is stuck.

    Returns
    -------
    np.ndarray of bool, shape (N,), and list of str
        Mask of wrong samples, and notes that name them.

    Raises
    ------
    DataError
        Faults are more than a tenth of the samples, or a coordinate jumps and stays there.

    """
    wrong, notes = np.zeros(len(t), dtype=bool), list[str]()
    if len(t) < _AROUND:
        return wrong, notes
    columns = [(x, _FAR_POSITION) for x in q.T]
    columns += [] if v is None else [(x, _FAR_VELOCITY) for x in v.T]
    for k, (name, (x, far)) in enumerate(zip(labels, columns, strict=False)):
        x = unwrap_beside_glitches(t, x) if far == _FAR_POSITION else x
        found = _glitches(t, x, far)
        rates = None if v is None else v[:, k % q.shape[1]]
        stuck = _stuck_samples(x, rates) if far == _FAR_POSITION and not sticks else np.zeros(
            len(t), dtype=bool)
        jumps = counted(found.sum(), 'sample') + times_text(t[found])
        text = f'{name} jumps away and back in {jumps}'
        if count := _repeat_count(x):
            notes.append(f'{name} is repeated in {count} samples, of which the first is taken')
            wrong[1:] |= np.diff(x) == 0.0
        elif stuck.any():
            text = f'{name} stands still in {stuck.sum()} samples of a motion' \
                f'{times_text(t[stuck])}' + f'; {text}' * bool(found.any())
            found |= stuck
        if found.mean() > _MAX_SHARE:
            raise DataError(f'{where}: {text}, of {len(t)}; no rate beside them explains that; '
                            'look at the sensor, or leave these samples out')
        if far == _FAR_POSITION:
            _check_shifts(t[~found & ~wrong], x[~found & ~wrong], f'{where}: {name}')
        if found.any():
            notes.append(text)
        wrong |= found
    return wrong, notes


def unwrap_beside_glitches(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a coordinate, unwrapped if it is an angle that jumps by a turn, glitches aside."""
    good = ~_glitches(t, x, _FAR_POSITION)
    inside = x[good]
    if np.ptp(inside) > 2.0 * np.pi * (1.0 + 1e-6) or np.abs(np.diff(inside)).max(
            initial=0.0) <= np.pi:
        return x
    x = x.copy()
    x[good] = np.unwrap(inside)
    # Samples that flicker between both ends are near their neighbours in some turn.
    near = np.interp(t[~good], t[good], x[good])
    x[~good] += 2.0 * np.pi * np.round((near - x[~good]) / (2.0 * np.pi))
    return x


def _usual_steps(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the usual size of each step of a coordinate, shape (N - 1,)."""
    steps, intervals = np.abs(np.diff(x)), np.diff(t) / np.median(np.diff(t))
    each = steps / intervals
    least = max(np.median(each), np.median(each[each > 0.0]))
    return np.maximum(median_filter(each, _AROUND, mode='reflect'), least) * intervals


def _glitches(t: np.ndarray, x: np.ndarray, far: float) -> np.ndarray:
    """Return the mask of samples that are away from those before and after."""
    if not np.ptp(x):
        return np.zeros(len(x), dtype=bool)
    usual = maximum_filter1d(_usual_steps(t, x), _MEDIAN)
    usual = np.append(usual, usual[-1])
    found = _abrupt_samples(x, np.abs(x - median_filter(x, _MEDIAN, mode='reflect')) > far * usual)
    # A placeholder for a missing value repeats, mostly off the line of its neighbours.
    _, value, count = np.unique(x, return_inverse=True, return_counts=True)
    off = np.zeros(len(x), dtype=bool)
    off[1:-1] = np.abs(x[1:-1] - 0.5 * (x[2:] + x[:-2])) > _OFF * usual[1:-1]
    often = count >= max(_AGAIN, _OFTEN * len(x) / len(count))
    return found | (often & (np.bincount(value, off | found) >= 0.5 * count))[value]


def _abrupt_samples(x: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the mask of those samples that a step leads to or from which no other announces."""
    steps = np.pad(np.abs(np.diff(x)), 3)
    kept = np.zeros(len(x), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]])))
    for i, j in edges.reshape(-1, 2):
        # Steps are shifted by 3: steps[i + 2] leads to sample i.
        if steps[i + 2] > _ALONE * steps[i:i + 2].max() or \
                steps[j + 2] > _ALONE * steps[j + 3:j + 5].max():
            kept[i:j] = True
    return kept


def _repeat_count(x: np.ndarray) -> int:
    """Return the repetitions of each value by a sensor slower than its log, 0 for none."""
    between = np.diff(np.flatnonzero(np.diff(x)))
    count = int(np.median(between)) if between.size else 1
    regular = np.abs(between - count) <= count // 4
    return count if count > 1 and regular.mean() >= _REGULAR else 0


def _stuck_samples(x: np.ndarray, rates: np.ndarray | None) -> np.ndarray:
    """Return the mask of samples that repeat the one before while the motion continues."""
    found, steps = np.zeros(len(x), dtype=bool), np.abs(np.diff(x))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steps == 0.0, [False]])))
    runs = [(i, j) for i, j in edges.reshape(-1, 2) if j - i >= _EQUAL - 1]
    moving = steps[steps > 0.0]
    if not runs or not moving.size:
        return found
    usual = np.quantile(moving, 0.75)
    rests = _places_of_rest(x[[i for i, _ in runs]], moving.min())
    speed = 0.0 if rates is None or not rates.any() else _FAST * np.quantile(
        np.abs(rates[rates != 0.0]), 0.75)
    repeats = (len(steps) - len(moving) - sum(j - i for i, j in runs)) / len(steps)
    for i, j in runs:
        moves = repeats < _NEVER and x[i] not in rests and (
            rates is None or np.median(np.abs(rates[i:j + 1])) >= speed)
        if i == 0 or j == len(steps):
            # A body at rest starts slowly, and noise moves what is measured of it.
            beside = steps[j if i == 0 else i - 1:][:1]
            found[i + (i > 0):j + 1] = moves and (beside > _ABRUPT * usual).any()
            continue
        before, after = steps[max(i - 3, 0):i].mean(), steps[j + 1:j + 4].mean(
            ) if j + 1 < len(steps) else 0.0
        # The first step after it makes up for the gap; or both sides are fast.
        if steps[j] > _ALONE * max(before, after, usual) or (
                moves and min(before, after) > _FAST * usual):
            found[i + 1:j + 1] = True
    return found


def _places_of_rest(places: np.ndarray, count: float) -> np.ndarray:
    """Return the places at which a joint stands more than once, to a count of its sensor."""
    places = np.sort(places)
    near = np.diff(places) <= 1.5 * count
    return places[np.append(near, False) | np.append(False, near)]


def _check_shifts(t: np.ndarray, x: np.ndarray, where: str) -> None:
    """Raise DataError if a coordinate jumps and stays there."""
    steps = np.abs(np.diff(x))
    if not steps.any():
        return
    padded = np.pad(steps, 2)
    beside = np.max([padded[k:k + len(steps)] for k in (0, 1, 3, 4)], axis=0)
    at = np.flatnonzero((steps > _SHIFT * _usual_steps(t, x)) & (steps > _ALONE * beside))
    if at.size:
        raise DataError(f'{where} jumps by {steps[at[0]]:.4g} and stays there'
                        f'{times_text(t[at + 1])}; no motion does; cut the log there, number its '
                        'runs in a column (data.trial), or look at the sensor')
