# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Times and values of samples: their order, intervals, interpolation, filters, unwrapping."""

from collections.abc import Callable
import math

from hnn_vi_ros.errors import DataError
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

# Order of the low-pass filter. It runs forward and backward: twice the order, no phase shift.
_ORDER = 2
# A low-pass filter with a cut-off above this share of the Nyquist frequency is skipped.
_MAX_CUTOFF = 0.9
MAX_ROWS = 1_000_000
# Share of times that repeat the previous one, above which they have been rounded.
_MOST_REPEATED = 0.5
# Tolerance for the resolution of a log's clock, as a share of a step; smaller excesses add no
# further step.
_CLOCK = 0.01
# Maximum number of steps between samples: logs have 0.25 to 4, and a thousand times as many if
# milliseconds are read as seconds.
_MOST_STEPS = 250
# Number of samples that tell noise from motion, and the limit of autocorrelations in standard
# deviations of those of white noise: of a thousand, one in a thousand logs exceeds it.
_LEAST, _RELATED = 50, 5.0
# Number of samples on each side that distinguish a reset clock from late samples.
_AROUND = 20
# Rates are judged only where a coordinate moves by this multiple of its noise.
_MIN_MOTION = 20.0
# Third differences of white noise, as their median relative to its standard deviation.
_THIRD = 0.6745 * math.sqrt(20.0)
# Samples on each side of a jump of the velocity; the change that may be one, relative to those
# around it; its size in standard deviations, and relative to steps around it; and the misfit of
# a parabola on one side, relative to the jump.
_SIDE, _SEEN, _SURE, _ALONE, _SMOOTH = 5, 3.0, 10.0, 4.0, 0.1
# Largest distance of impacts on one stop, relative to the range.
_STOP = 0.02
# Differences that are rounding, relative to the range.
ROUNDED = 1e-6
# Interpolation: maps new times, times t and values, shape (N, k), to values at the new times.
Between = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def clock_resets(t: np.ndarray) -> np.ndarray:
    """
    Return the indices of samples before which the clock was set back, in increasing order.

    A reset is detected if three quarters of the samples before are later than three quarters of
    those after. A single wrong stamp or a few late ones do not count.
    """
    found: list[int] = []
    for i in np.flatnonzero(np.diff(t) < 0.0) + 1:
        before, after = t[max(i - _AROUND, 0):i], t[i:i + _AROUND]
        if min(len(before), len(after)) == _AROUND and (not found or i - found[-1] >= _AROUND) \
                and np.quantile(before, 0.25) > np.quantile(after, 0.75):
            found.append(int(i))
    return np.array(found, dtype=int)


def increasing_samples(t: np.ndarray) -> np.ndarray:
    """
    Return the indices of the largest set of samples with increasing times, shape (M,).

    This is the longest increasing subsequence: a stamp far ahead costs one sample, not all that
    follow (M. Fredman, On computing the length of longest increasing subsequences, Discrete
    Mathematics 11, 1975). Times less than a picosecond apart are equal.
    """
    with np.errstate(over='ignore', invalid='ignore'):
        t = np.round(t, 12)
    if (np.diff(t) > 0.0).all():
        return np.arange(len(t))
    least: list[float] = []  # smallest final time of a subsequence of each length
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


def repeated_text(t: np.ndarray) -> str:
    """Describe times that mostly repeat the previous one, as rounded ones do; '' for others."""
    steps = np.diff(t[np.isfinite(t)])
    repeated, longer = int((steps == 0.0).sum()), steps[steps > 0.0]
    if not longer.size or repeated <= _MOST_REPEATED * len(steps):
        return ''
    return (f'{repeated} of {len(t)} times repeat the previous one, as times rounded to '
            f'{longer.min():.4g} do; log them with more digits')


def is_noise(x: np.ndarray) -> bool:
    """Return True if no autocorrelation of samples differs from that of white noise."""
    x = x - x.mean()
    if len(x) < _LEAST or not x.any():
        return not x.any()
    spectrum = np.abs(np.fft.rfft(x, 2 * len(x)))**2
    correlation = np.fft.irfft(spectrum)[1:len(x) // 4]
    return bool(np.abs(correlation).max() < _RELATED / math.sqrt(len(x)) * (x @ x))


def resolution(x: np.ndarray) -> float:
    """Return the step between values of a sensor, shape (N,); that of noise is small."""
    steps = np.diff(np.unique(x))
    steps = steps[steps > ROUNDED * np.ptp(x)]
    return float(np.quantile(steps, 0.05)) if steps.size else 0.0


def interleaved(x: np.ndarray) -> bool:
    """Return True if samples alternate between two smooth curves."""
    # A sinusoid of 2.4 samples a period or less looks alike.
    rough, *parts = (np.median(np.abs(np.diff(part, 3))) for part in (x, x[::2], x[1::2]))
    return len(x) >= 2 * _LEAST and bool(rough > _RELATED * max(parts))


def spaced_samples(t: np.ndarray, least: float) -> np.ndarray:
    """Return the indices of samples at least this time [s] apart, each as early as possible."""
    kept = [0]
    if (np.diff(t) >= least).all():
        return np.arange(len(t))
    for i, time in enumerate(t):
        if time - t[kept[-1]] >= least:
            kept.append(i)
    return np.array(kept)


def noise_of(x: np.ndarray) -> np.ndarray:
    """Return the standard deviations of the noise of coordinates at even times, shape (d,)."""
    quanta = [resolution(column) / math.sqrt(12.0) for column in x.T]
    return np.maximum(np.median(np.abs(np.diff(x, 3, axis=0)), axis=0) / _THIRD, quanta)


def velocity_jumps(t: np.ndarray, q: np.ndarray, v: np.ndarray | None) -> np.ndarray:
    """
    Return the indices of samples before which the velocity of a coordinate jumps.

    Parabolas through the samples on both sides differ in their slopes, or in the velocities. An
    impact on a stop, which reverses the velocity at one place more than once, does not count.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing times [s].
    q : np.ndarray, shape (N,)
        Coordinate.
    v : np.ndarray, shape (N,), or None
        Velocities, if they were measured.

    """
    x, order = (q, 1) if v is None else (v, 0)
    if len(x) < 4 * _SIDE or not np.ptp(x):
        return np.empty(0, dtype=int)
    noise, spacing = _rounded_noise(x), np.diff(t)
    changes = np.abs(np.diff(x if order == 0 else np.diff(x) / spacing))
    usual = median_filter(changes, 4 * _SIDE, mode='reflect')
    least = noise if order == 0 else noise / float(np.median(spacing))
    at = np.flatnonzero(changes > _SEEN * np.maximum(usual, least)) + 1
    at = np.unique([at, at + 1])
    at = at[(at >= _SIDE) & (at <= len(x) - _SIDE)]
    steps, errors, misfits, _ = _steps_of(t, x, at, order)
    size = np.abs(steps) * (spacing[at - 1] if order else 1.0)
    sure = (np.abs(steps) > _SURE * noise * errors) & (
        misfits < np.maximum(_SMOOTH * size, _RELATED * noise))
    if v is not None:
        # Positions that do not follow show a glitch.
        slopes, errors, _, _ = _steps_of(t, q, at, 1)
        sure &= np.abs(slopes - steps) < 0.5 * np.abs(steps) + 3.0 * _rounded_noise(q) * errors
    at = at[sure]
    found, reversals = list[int](), list[float]()
    for i in at:
        near = np.arange(max(i - 4 * _SIDE, _SIDE), min(i + 4 * _SIDE, len(x) - _SIDE) + 1)
        steps, _, _, rates = _steps_of(t, x, near, order)
        steps, own = np.abs(steps), int(np.flatnonzero(near == i)[0])
        if steps[own] == steps.max() and steps[own] > _ALONE * steps[
                np.abs(near - i) >= _SIDE].max(initial=0.0):
            found.append(int(i))
            reversals.append(float(q[i]) if rates[own].prod() < 0.0 else np.inf)
    places = np.array(reversals)
    return np.array([i for i, place in zip(found, places, strict=True) if place == np.inf or (
        np.abs(places - place) <= _STOP * np.ptp(q)).sum() == 1], dtype=int)


def _rounded_noise(x: np.ndarray) -> float:
    return max(float(noise_of(x[:, None])[0]), ROUNDED * float(np.ptp(x)))


def _steps_of(t: np.ndarray, x: np.ndarray, at: np.ndarray, order: int
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Compare parabolas through the samples before and after some indices.

    Returns
    -------
    np.ndarray, shape (M,), three times, and shape (M, 2)
        Steps of the derivative of this order, their errors for a noise of 1, the largest misfits
        of the parabolas, and the derivatives before and after.

    """
    values, errors, misfits = [], [], []
    middle = 0.5 * (t[at - 1] + t[at])
    for first in (-_SIDE, 0):
        rows = at[:, None] + np.arange(first, first + _SIDE)
        powers = (t[rows] - middle[:, None])[..., None]**np.arange(3)
        inverse = np.linalg.pinv(powers)
        numbers = np.einsum('mij,mj->mi', inverse, x[rows])
        values.append(numbers[:, order])
        errors.append((inverse[:, order]**2).sum(axis=-1))
        misfits.append(np.abs(x[rows] - np.einsum('mij,mj->mi', powers, numbers)).max(axis=1))
    return (values[1] - values[0], np.sqrt(errors[0] + errors[1]), np.maximum(*misfits),
            np.stack(values, axis=-1))


def even_times(t: np.ndarray, spacing: float) -> np.ndarray:
    """Return evenly spaced times [s] from the first time on, none after the last."""
    count = int((t[-1] - t[0]) / spacing * (1.0 + 1e-12)) + 1
    if count > MAX_ROWS:
        raise DataError(f'data.spacing = {spacing:g} s makes more than {MAX_ROWS} rows; increase '
                        'it')
    return np.minimum(t[0] + spacing * np.arange(count), t[-1])


def steps_between(spacing: float, step_size: float) -> int:
    """Return the number of steps of about `step_size` or less in an interval [s], or DataError."""
    count = max(1, math.ceil(spacing / step_size - _CLOCK))
    if count > _MOST_STEPS:
        raise DataError(f'samples lie {count} steps of {step_size:g} s apart; are the times in s? '
                        'Write their unit in the header, such as t [ms], or take a larger '
                        'step_size in the scene')
    return count


def linear(times: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values of shape (N, k) linearly at other times."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def cubic(times: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values of shape (N, k) with a cubic spline at other times."""
    return CubicSpline(t, values)(times)


def low_pass(name: str, values: np.ndarray, spacing: float, cutoff: float) -> np.ndarray:
    """Apply a zero-phase low-pass filter with this cut-off [Hz] along axis 0 (even times)."""
    share = 2.0 * spacing * cutoff
    if share > _MAX_CUTOFF:
        return values
    try:
        return np.ascontiguousarray(
            sosfiltfilt(butter(_ORDER, share, output='sos'), values, axis=0))
    except np.linalg.LinAlgError as problem:
        raise DataError(f'{name}: a smoothing of {cutoff:g} Hz is too low for a sampling interval '
                        f'of {spacing:.4g} s; increase it') from problem


def unwrap_turns(t: np.ndarray, q: np.ndarray, v: np.ndarray | None
                 ) -> tuple[np.ndarray, list[int]]:
    """
    Unwrap angles that jump by a turn; return the coordinates and the indices of those unwrapped.

    A wrapped angle jumps by more than half a turn between samples, and its range is within 2 pi.
    Rates, if given, determine the number of turns between two samples; otherwise the smallest
    possible number is taken.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Times [s].
    q : np.ndarray, shape (N, d)
        Coordinates.
    v : np.ndarray, shape (N, d), or None
        Rates of the coordinates.

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


def unexplained_share(t: np.ndarray, x: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """
    Return the share of the motion of each coordinate not explained by its rates, shape (d,).

    This is the minimum over lags 1, 2, 4, ... of the mean squared change of x minus the integral
    of the rates, divided by that of x: 0 for exact rates, 1 for zero rates, NaN for a coordinate
    that hardly moves.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Times [s].
    x, rate : np.ndarray, shape (N, d)
        Coordinates and their supposed rates.

    """
    rest = x - cumulative_trapezoid(rate, t, axis=0, initial=0.0)
    return np.array([_least_unexplained(*columns) for columns in zip(x.T, rest.T, strict=True)])


def _least_unexplained(x: np.ndarray, rest: np.ndarray) -> float:
    changes = np.abs(np.diff(x))
    steps = changes[changes > 0.0]
    if not len(steps):
        return np.nan
    # Sensor noise is at least the quantum and at least the median second difference.
    noise = max(float(steps.min()), float(np.median(np.abs(np.diff(x, 2)))))
    shares, apart = [], 1
    while apart <= len(x) // 2:
        moved, left = (float(np.mean((part[apart:] - part[:-apart])**2)) for part in (x, rest))
        if moved > (_MIN_MOTION * noise)**2:
            shares.append(left / moved)
        apart *= 2
    return min(shares, default=np.nan)
