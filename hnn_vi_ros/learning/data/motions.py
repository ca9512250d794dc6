# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Measured motions of a mechanism, (t, q, v, tau), at even times.

Runs come from arrays, bags or logs; what is bad in them is left out, counted and reported.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Literal, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.learning.data.motion_samples import (
    clock_resets, increasing, MOST, unexplained, unwound)
import numpy as np
from pydantic import Field
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.signal import butter, sosfiltfilt

MIN_SAMPLES = 20
# Order of the low-pass; run forth and back it counts twice and shifts no phase.
_ORDER = 2
# Of the fastest motion that samples can hold: a filter of a higher cut-off takes nothing away.
_WHOLE = 0.9
# Samples further apart than this many usual intervals are a gap, over which nothing is known.
_GAP = 10.0
# With more bad samples than this share the data are not what they are taken for.
_MOST_BAD = 0.5
# Nor are rates that leave more than this share of the motion unexplained.
_UNEXPLAINED = 0.25
# Of the intervals of runs that are taken as one.
_ALIKE = 0.01
# Of a step: intervals of a log are off by what its clock is, which asks for no further step.
_CLOCK = 0.01


class MotionData(StrictModel):
    """Options of measured motions, wherever they come from."""

    smoothing: float = Field(40.0, gt=0.0, description=(
        'cut-off of the zero-phase filter from which initial states and accelerations come [Hz]; '
        'samples that come too seldom to hold so fast a motion are taken as they are'))
    on_bad: Literal['drop', 'split', 'fail'] = Field('drop', description=(
        'samples that are late, come twice or lack a number: drop, and bridge what is missing; '
        'split the motion there; or fail. At a gap of more than ten intervals a new motion '
        'begins, or it fails'))
    inputs: Literal['interpolated', 'held'] | None = Field(None, description=(
        'what forces do between samples: go over into each other, or each is held until the '
        'next; default: held for topics of commands, else interpolated'))
    test_runs: list[str] = Field([], description=(
        'runs to judge the model by; none: the last fifth of each run in time'))


class MeasuredRun(NamedTuple):
    """
    One run as it was measured.

    Parameters
    ----------
    name : str
        Of the run.
    where : str
        File and run, for messages.
    t : np.ndarray, shape (N,)
        Times [s].
    q : np.ndarray, shape (N, d)
        Coordinates; here and below, what a sample lacks is not a number.
    v : np.ndarray, shape (N, d), or None
        Velocities, None or not a number throughout where they are to be estimated.
    tau : np.ndarray, shape (N, m), or None
        Forces of m <= d motors, None for none.
    held : bool
        Whether each force acts until the next, unless the data say otherwise.
    a : np.ndarray, shape (N, d), or None
        Accelerations, None where they are to be estimated.
    notes : tuple of str
        What else the model card tells of it.

    """

    name: str
    where: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    tau: np.ndarray | None
    held: bool = False
    a: np.ndarray | None = None
    notes: tuple[str, ...] = ()


@dataclass
class Bad:
    """Number of samples that could not be used, by the reason, and where motions were cut."""

    lacking: int = 0
    late: int = 0
    short: int = 0
    cuts: int = 0
    notes: dict[str, None] = field(default_factory=dict)

    def __str__(self) -> str:
        parts = [f'{count} {what}' for count, what in (
            (self.lacking, 'that lack a number'), (self.late, 'that are late or come twice'),
            (self.short, f'in pieces of less than {MIN_SAMPLES}')) if count]
        found = [f'left out {" and ".join(parts)} of the samples'] if parts else []
        found += [f'cut at {self.cuts} places'] if self.cuts else []
        return '; '.join([*found, *self.notes])

    def note(self, *texts: str) -> None:
        """Keep what is to be told once, in order."""
        self.notes.update(dict.fromkeys(texts))


@dataclass(frozen=True)
class Motion:
    """
    One run, at even times.

    Parameters
    ----------
    name : str
        Of the run.
    t : np.ndarray, shape (N,)
        Times [s].
    q, v : np.ndarray, shape (N, d)
        Coordinates and velocities, as measured.
    tau : np.ndarray, shape (N, m)
        Forces of the motors, as measured: those on the coordinates, if there are d.
    q_smooth, v_smooth, a_smooth : np.ndarray, shape (N, d)
        Coordinates, velocities and accelerations through a zero-phase low-pass filter.
    held : bool
        Whether each force acts until the next; else it goes over into it.
    accelerations : bool
        Whether they were measured; else they were estimated.

    """

    name: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    q_smooth: np.ndarray
    v_smooth: np.ndarray
    a_smooth: np.ndarray
    held: bool = False
    accelerations: bool = False

    @property
    def forces(self) -> np.ndarray:
        """Return the mean of the forces over each interval, shape (N - 1, m)."""
        return self.tau[:-1] if self.held else 0.5 * (self.tau[1:] + self.tau[:-1])

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return float(self.t[1] - self.t[0])


def as_motions(runs: Sequence[MeasuredRun], data: MotionData, name: str, digest: str = ''
               ) -> tuple[list[Motion], str]:
    """Return runs as motions at even times, and what they are and lack, for the model card."""
    bad = Bad()
    parts = [_pieces(run, data, bad) for run in runs]
    # That of most samples, for runs at different rates.
    usual = float(np.quantile(np.repeat([part.spacing for part in parts], [
        sum(map(len, part.rows)) for part in parts]), 0.5, method='lower'))
    motions = [motion for part in parts for motion in _motions(part, usual, data, bad)]
    if not motions:
        raise DataError(f'{runs[0].where}: no {MIN_SAMPLES} samples in a row every {usual:.4g} s, '
                        'the interval of most runs; give runs that last longer')
    counts = f'; {bad}' if str(bad) else ''
    samples = sum(len(motion.t) for motion in motions)
    known = f', sha256 {digest}' if digest else ''
    return motions, f'{name} ({samples} samples{known}{counts})'


class _Pieces(NamedTuple):
    """A run, which of its samples are those of one motion each, and their interval [s]."""

    run: MeasuredRun
    rows: list[np.ndarray]
    spacing: float


def _pieces(run: MeasuredRun, data: MotionData, bad: Bad) -> _Pieces:
    """Return a run without what is bad in it, or DataError: on_bad is fail, or it is too much."""
    if not len(run.t):
        raise DataError(f'{run.where}: no samples, expected at least {MIN_SAMPLES}; record for '
                        'longer')
    if run.v is not None and not np.isfinite(run.v).any(axis=0).all():
        run = run._replace(v=None)
    bad.note(*run.notes, *['velocities estimated'] * (run.v is None))
    kept = _kept(run, data, bad)
    intervals = np.diff(run.t[kept])
    spacing = float(np.median(intervals[intervals > 0.0]))
    gap = intervals > _GAP * spacing
    if gap.any() and data.on_bad == 'fail':
        raise DataError(f'{run.where}: {intervals.max():.3g} s without a sample, {spacing:.3g} s '
                        'as a rule; cut the run in two there, or take data.on_bad: split')
    gap |= intervals <= 0.0  # the clock was set back
    if data.on_bad == 'split':
        gap |= np.diff(kept) > 1
    pieces = np.split(kept, np.flatnonzero(gap) + 1)
    bad.cuts += len(pieces) - 1
    long = [piece for piece in pieces if len(piece) >= MIN_SAMPLES]
    bad.short += len(kept) - sum(map(len, long))
    if not long:
        bridge = '' if data.on_bad == 'drop' else ', or take data.on_bad: drop'
        raise DataError(f'{run.where}: no {MIN_SAMPLES} samples in a row without a gap; record '
                        f'for longer{bridge}')
    return _Pieces(run, long, spacing)


def _kept(run: MeasuredRun, data: MotionData, bad: Bad) -> np.ndarray:
    """Return the samples of a run that can be used; between two, time goes back at a reset."""
    lacks = {name: ~(np.abs(part) <= MOST).reshape(len(run.t), -1).all(axis=1)
             for name, part in run._asdict().items() if isinstance(part, np.ndarray)}
    lacking = np.any([*lacks.values()], axis=0)
    there = np.flatnonzero(~lacking)
    resets = clock_resets(run.t[there])
    parts = [part[increasing(run.t[part])] for part in np.split(there, resets) if len(part)]
    kept = np.concatenate(parts) if parts else there
    late = ~lacking
    late[kept] = False
    wrong = np.flatnonzero(lacking | late)
    if data.on_bad == 'fail' and (wrong.size or resets.size):
        at = min([*wrong[:1], *there[resets[:1]]])
        what = 'lacks a number' if lacking[at] else \
            'is not after the one before, or that one is wrong'
        raise DataError(f'{run.where}: sample {at + 1} {what}; leave it out, or take '
                        'data.on_bad: drop or split')
    if wrong.size > _MOST_BAD * len(run.t):
        counts = ', '.join(f'{part.sum()} lack a number of {name}'
                           for name, part in lacks.items() if part.any())
        raise DataError(f'{run.where}: of {len(run.t)} samples {counts or "none lacks a number"}, '
                        f'and {late.sum()} are not after the one before: these are no states of '
                        'one motion; look at what is taken for them')
    bad.lacking, bad.late = bad.lacking + int(lacking.sum()), bad.late + int(late.sum())
    if len(kept) < MIN_SAMPLES:
        raise DataError(f'{run.where}: {len(kept)} samples, expected at least {MIN_SAMPLES}; '
                        'record for longer')
    return kept


def _motions(part: _Pieces, usual: float, data: MotionData, bad: Bad) -> Iterator[Motion]:
    """Yield the pieces of a run at even times, by the interval of most samples [s]."""
    run, rows, spacing = part
    # Clocks that jitter make one rate look like several.
    if abs(spacing - usual) > _ALIKE * usual:
        bad.note(f'{run.name} put from every {spacing:.4g} s on every {usual:.4g} s')
    long = [piece for piece in rows
            if run.t[piece[-1]] - run.t[piece[0]] > (MIN_SAMPLES - 1.5) * usual]
    bad.short += sum(map(len, rows)) - sum(map(len, long))
    for number, piece in enumerate(long):
        name = run.name if len(long) == 1 else f'{run.name}#{number}'
        yield _motion(name, run, piece, usual, data, bad)


def run_of(motion: 'Motion') -> str:
    """Return the name of the run that a motion is a piece of."""
    return motion.name.rpartition('#')[0] or motion.name


def _check_rates(run: MeasuredRun, t: np.ndarray, q: np.ndarray, v: np.ndarray | None,
                 a: np.ndarray | None) -> None:
    """Refuse velocities and accelerations that are not the rates of what they belong to."""
    for name, of, x, rate, remedy in (
            ('velocities', 'positions', q, v, 'have them estimated, by data.estimate_velocity: '
             'true of bags or without v in arrays and logs'),
            ('accelerations', 'velocities', v, a, 'leave out a')):
        if x is None or rate is None:
            continue
        shares = unexplained(t, x, rate)
        if (shares > _UNEXPLAINED).any():
            worst = int(np.nanargmax(shares))
            raise DataError(
                f'{run.where}: the {name} of coordinate {worst + 1} are not the rates of its {of}:'
                f' {100.0 * min(shares[worst], 1.0):.0f} % of how it moves is not in them; look '
                f'for other units, another sign, zeros or outliers in either, or {remedy}')


def _motion(name: str, run: MeasuredRun, rows: np.ndarray, spacing: float, data: MotionData,
            bad: Bad) -> Motion:
    t, q = run.t[rows], run.q[rows]
    v, a = (None if part is None else part[rows] for part in (run.v, run.a))
    q, turning = unwound(t, q, v)
    for k in turning:
        bad.note(f'turns of coordinate {k + 1} counted')
    _check_rates(run, t, q, v, a)
    tau = np.zeros_like(q) if run.tau is None else run.tau[rows]
    times = t[0] + spacing * np.arange(int((t[-1] - t[0]) / spacing * (1.0 + 1e-12)) + 1)
    times = np.minimum(times, t[-1])
    held = run.held if data.inputs is None else data.inputs == 'held'
    # Where each force acts until the next, the last one counts.
    tau = tau[np.searchsorted(t, times + 1e-9 * spacing, side='right') - 1] if held else \
        _linear(times, t, tau)
    # q by its slope v as well: clocks of drivers jitter by a large part of the interval.
    q = CubicSpline(t, q)(times) if v is None else CubicHermiteSpline(t, q, v)(times)
    if v is not None:
        v = _linear(times, t, v) if a is None else CubicHermiteSpline(t, v, a)(times)
    a = None if a is None else _linear(times, t, a)
    return replace(smoothed(name, times, q, v, tau, data.smoothing, a), held=held)


def _linear(times: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def low_pass(name: str, values: np.ndarray, spacing: float, cutoff: float) -> np.ndarray:
    """Return values, at times along axis 0, through a zero-phase filter of a cut-off [Hz]."""
    share = 2.0 * spacing * cutoff
    # What is faster than the samples can hold is not there to be taken away.
    if share > _WHOLE:
        return values
    try:
        return np.ascontiguousarray(
            sosfiltfilt(butter(_ORDER, share, output='sos'), values, axis=0))
    except np.linalg.LinAlgError as problem:
        raise DataError(f'{name}: a smoothing of {cutoff:g} Hz is too low for samples every '
                        f'{spacing:.4g} s; give a higher one') from problem


def smoothed(name: str, t: np.ndarray, q: np.ndarray, v: np.ndarray | None, tau: np.ndarray,
             cutoff: float, a: np.ndarray | None = None) -> Motion:
    """Return a motion at even times, smoothed, with what it lacks of velocities and more."""
    def smooth(values: np.ndarray) -> np.ndarray:
        return low_pass(name, values, float(t[1] - t[0]), cutoff)

    def rate(values: np.ndarray) -> np.ndarray:
        return CubicSpline(t, values)(t, 1)

    q_smooth = smooth(q)
    v_smooth = rate(q_smooth) if v is None else smooth(v)
    return Motion(name, t, q, v_smooth if v is None else v, tau, q_smooth, v_smooth,
                  rate(v_smooth) if a is None else smooth(a), accelerations=a is not None)


def steps_between(spacing: float, step_size: float) -> int:
    """Return how many steps of about a size [s], or less, make the interval of samples [s]."""
    return max(1, math.ceil(spacing / step_size - _CLOCK))


def split_motions(motions: Sequence[Motion], test_runs: Sequence[str]
                  ) -> tuple[list[Motion], list[Motion]]:
    """Return what to learn from, and what to judge by: runs, or the last fifth of each."""
    if test_runs:
        return ([motion for motion in motions if run_of(motion) not in test_runs],
                [motion for motion in motions if run_of(motion) in test_runs])
    ends = [4 * len(motion.t) // 5 for motion in motions]
    return ([part_of(motion, slice(None, end)) for motion, end in zip(motions, ends, strict=True)],
            [part_of(motion, slice(end, None)) for motion, end in zip(motions, ends, strict=True)])


def part_of(motion: Motion, rows: slice) -> Motion:
    """Return some samples of a motion."""
    return replace(motion, **{name: values[rows] for name, values in vars(motion).items()
                              if isinstance(values, np.ndarray)})
