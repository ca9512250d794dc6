# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Measured motions: a common container for all formats and fits; cleaning, resampling, smoothing.

Arrays, bags and logs become motions; bad samples are dropped, counted and reported. Functions of
times and values alone are in sampling.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
import math
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from hnn_vi_ros.effects import OFF
from hnn_vi_ros.errors import counted, DataError, listed
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.learning.arguments import Course
from hnn_vi_ros.learning.data.faults import faults, times_text
from hnn_vi_ros.learning.data.rest import cut_at_rest
from hnn_vi_ros.learning.data.sampling import (
    Between, clock_resets, cubic, even_times, increasing_samples, interleaved, is_noise, linear,
    low_pass, repeated_text, spaced_samples, unexplained_share, unwrap_turns,
    velocity_jumps)
import numpy as np
from pydantic import Field
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly
from scipy.signal import periodogram

MIN_SAMPLES = 20
# Value of ``forces`` for no forces.
NONE = 'none'
# Largest accepted absolute value; squares of larger numbers may overflow.
MAX_VALUE = 1e100
# Largest plausible time in seconds since 1970.
_LATEST = 1e11
# Velocities are differences of positions if this share of them is, to the digits of a file.
_MOST_OF_THEM, _DIGITS = 0.9, 1e-6
# Highest automatic cut-off [Hz], and cut-off relative to the highest frequency of the motion;
# power of the motion there, relative to the noise.
_FASTEST, _ABOVE_MOTION, _SIGNAL = 40.0, 2.0, 4.0
# Gap threshold in usual intervals; nothing is interpolated over a gap.
GAP = 10.0
# Smallest distance of samples in usual intervals: between closer ones, noise looks like speed, and
# a spline without measured rates overshoots next to them.
_CLOSE = 0.5
# Largest accepted share of bad samples.
_MOST_BAD = 0.5
# Largest accepted share of the motion that the rates do not explain.
_UNEXPLAINED = 0.25
# Relative difference below which intervals of runs are regarded as equal.
_ALIKE = 0.01
# Part of a force beside a multiple of another column, relative to it, that is rounding.
_COPIED = 1e-3
OnBad = Annotated[Literal['drop', 'split', 'fail'], Field(description=(
    'treatment of samples that are late, duplicated or lack a number: drop them and interpolate, '
    'split the motion there, or fail. A gap of more than ten intervals starts a new motion, or '
    'fails'))]
TEST_RUNS: list[str] = Field([], description=(
    'runs for testing the model; none: the last fifth of each run'))

Record = TypeVar('Record', bound=Any)


class MotionData(StrictModel):
    """Options of measured motions in every format."""

    smoothing: float | None = Field(None, gt=0.0, description=(
        'cut-off frequency of the zero-phase filter for initial states and accelerations [Hz]; '
        'samples at too low a rate for it are not filtered; default: 40 Hz, or where positions '
        'alone fall below their noise'))
    on_bad: OnBad = 'drop'
    inputs: Course | None = Field(None, description=(
        'course of forces between samples: each held until the next, linear, or a cubic spline; '
        'default: held for topics of commands, else linear'))
    measured: list[str] = Field([], description=(
        'measured coordinates of a scene, in the order of the data, for identify; none: all'))
    delay: float | Literal['estimate'] = Field(0.0, description=(
        'delay of the forces in samples, possibly fractional; or estimate it by fitting rigid '
        'bodies to the training data'))
    forces: str | None = Field(None, pattern='^none$', description=(
        'none: no forces act, although there are some'))
    velocities: str | None = Field(None, pattern='^none$', description=(
        'none: positions alone are used, although there are velocities'))
    test_runs: list[str] = TEST_RUNS


@dataclass(frozen=True)
class Motion:
    """
    One measured motion; unmeasured channels are None, missing numbers are NaN.

    Parameters
    ----------
    name : str
        Name of the run.
    where : str
        File and run, for error messages.
    t : np.ndarray, shape (N,)
        Times [s], not necessarily evenly spaced.
    q : np.ndarray, shape (N, d)
        Coordinates.
    v, a : np.ndarray, shape (N, d), or None
        Velocities and accelerations.
    tau : np.ndarray, shape (N, m), or None
        Forces of m motors.
    p, dp_dt : np.ndarray, shape (N, d), or None
        Momenta, and their rates.
    inputs : str
        Course of the forces between samples: held, linear or spline.
    notes : tuple of str
        Further notes for the model card.
    q_alone : np.ndarray, shape (N, d), or None
        Coordinates interpolated without velocities, where v has been used for q.
    names : tuple of str
        Names of coordinates, then of velocities, in the log, for messages; empty for numbers.
    commanded : bool
        True if tau are positions commanded to servos, or OFF.
    logged : Motion, optional
        A commanded motion with the time stamps of the log, before it was resampled.

    """

    name: str
    where: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray | None = None
    tau: np.ndarray | None = None
    a: np.ndarray | None = None
    p: np.ndarray | None = None
    dp_dt: np.ndarray | None = None
    inputs: Course = 'linear'
    notes: tuple[str, ...] = ()
    q_alone: np.ndarray | None = None
    names: tuple[str, ...] = ()
    commanded: bool = False
    logged: 'Motion | None' = None

    @property
    def held(self) -> bool:
        """Return True if each force is held until the next sample."""
        return self.inputs == 'held'

    @property
    def labels(self) -> list[str]:
        """Return the names of the coordinates and of their velocities for messages."""
        return [*map(repr, self.names)] or [
            f'{what} {k + 1}' for what in ('coordinate', 'velocity')
            for k in range(self.q.shape[1])]

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """Return the measured channels by name."""
        return {name: values for name, values in vars(self).items()
                if isinstance(values, np.ndarray)}


class Recording(NamedTuple):
    """Motions returned by a reader, with the names of their files and runs, and digests."""

    motions: list[Motion]
    name: str
    digest: str


@dataclass(frozen=True, kw_only=True)
class EvenMotion(Motion):
    """
    A motion without gaps, or a piece of one, at even times and with smoothed states.

    Parameters
    ----------
    tau : np.ndarray, shape (N, m)
        Forces of the motors as measured; if there are d, those on the coordinates.
    q_smooth, v_smooth, a_smooth : np.ndarray, shape (N, d)
        Coordinates, velocities and accelerations after a zero-phase low-pass filter; estimated
        if they were not measured.
    idle : bool
        True if no force acted before the first sample; otherwise the first force did.
    cutoff, cutoff_alone : float
        Cut-off of the filter [Hz], and of one for positions alone if it is known.

    """

    tau: np.ndarray
    q_smooth: np.ndarray
    v_smooth: np.ndarray
    a_smooth: np.ndarray
    idle: bool = False
    cutoff: float = _FASTEST
    cutoff_alone: float | None = None

    @property
    def forces(self) -> np.ndarray:
        """Return the mean of the forces over each interval, shape (N - 1, m)."""
        if self.inputs == 'spline':
            integral = self.course.antiderivative()(self.spacing * np.arange(len(self.tau)))
            return np.diff(integral, axis=0) / self.spacing
        return self.tau[:-1] if self.held else 0.5 * (self.tau[1:] + self.tau[:-1])

    @property
    def course(self) -> PPoly:
        """Return the forces as a function of the time since the first sample [s]."""
        t = self.spacing * np.arange(len(self.tau))
        if self.inputs == 'spline':
            return CubicSpline(t, self.tau)
        slope = (not self.held) * np.diff(self.tau, axis=0) / self.spacing
        return PPoly(np.stack([slope, self.tau[:-1]]), t)

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def measured(self) -> np.ndarray:
        """Return coordinates and, if measured, velocities, shape (N, d) or (N, 2 d)."""
        return self.q if self.v is None else np.hstack([self.q, self.v])


@dataclass
class ReadingReport:
    """Counts of dropped samples by reason, places where runs were cut, and runs of differences."""

    least: int = MIN_SAMPLES
    lacking: int = 0
    late: int = 0
    close: int = 0
    short: int = 0
    cuts: int = 0
    differences: dict[str, None] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)

    def __str__(self) -> str:
        parts = [f'{count} {what}' for count, what in (
            (self.lacking, 'that lack a number'), (self.late, 'that are late or duplicated'),
            (self.close, 'less than half an interval after another'),
            (self.short, f'in pieces of fewer than {self.least}')) if count]
        found = [f'left out {" and ".join(parts)} of the samples'] if parts else []
        found += [f'cut at {counted(self.cuts, "place")}'] if self.cuts else []
        found += [f'velocities of {listed(self.differences)} are differences of the positions, '
                  'and not used'] if self.differences else []
        return '; '.join([*found, *self.notes])

    def note(self, *texts: str) -> None:
        """Keep notes in order, without duplicates."""
        self.notes.update(dict.fromkeys(texts))

    def described(self, recording: Recording, samples: int) -> str:
        """Describe the data for the model card."""
        digest = f', sha256 {recording.digest}' if recording.digest else ''
        counts = f'; {self}' if str(self) else ''
        return f'{recording.name} ({samples} samples{digest}{counts})'


def even_motions(recording: Recording, data: MotionData) -> tuple[list[EvenMotion], str]:
    """Return the pieces of motions at even times, and their description for the model card."""
    report = ReadingReport()
    motions = [replace(motion, tau=None if data.forces == NONE else motion.tau,
                       v=None if data.velocities == NONE else motion.v)
               for motion in recording.motions]
    # One that is alone is refused below.
    long = [motion for motion in motions if len(motion.t) >= MIN_SAMPLES] or motions
    report.short += sum(len(motion.t) for motion in motions) - sum(len(one.t) for one in long)
    for motion in long:
        _check_copies(motion, report)
    cut = [pieces_of(motion, data.on_bad, report) for motion in long]
    _check_motions(cut)
    # The interval of most samples is used for motions at different rates.
    usual = float(np.quantile(np.repeat([one.spacing for one in cut], [
        sum(map(len, one.rows)) for one in cut]), 0.5, method='lower'))
    even = [piece for one in cut for piece in _even_pieces(one, usual, data, report)]
    if not even:
        raise DataError(f'{recording.motions[0].where}: no {MIN_SAMPLES} successive samples at '
                        f'{usual:.4g} s, the interval of most runs; use longer runs')
    alone = data.smoothing or cutoff_of([_positions_alone(piece) for piece in even], usual)
    cutoff = data.smoothing or (_FASTEST if all(piece.v is not None for piece in even) else
                                cutoff_of(even, usual))
    found = [replace(smoothed(
        piece.name, piece.t, piece.q, piece.v,
        np.zeros_like(piece.q) if piece.tau is None else piece.tau, cutoff, piece.a),
        where=piece.where, inputs=piece.inputs, q_alone=piece.q_alone, cutoff_alone=alone,
        commanded=piece.commanded, logged=piece.logged)
        for piece in even]
    if len({one.v is None for one in found}) > 1:
        # Fits compare the same channels of all runs; the states keep the velocities of theirs.
        report.note('fits use positions alone, since not all runs have velocities')
        found = [_positions_alone(one) for one in found]
    return found, report.described(recording, sum(len(motion.t) for motion in found))


def cutoff_of(motions: Sequence[Motion], spacing: float) -> float:
    """
    Return the cut-off at which the spectrum of motions sinks into their noise, at most 40 Hz.

    The noise is the median of the periodogram in the upper third of the frequencies, and the
    motion ends at the highest frequency with _SIGNAL times as much, averaged over bands of equal
    width in the logarithm. The cut-off is _ABOVE_MOTION of it.

    Parameters
    ----------
    motions : sequence of Motion
        Motions at even times.
    spacing : float
        Time between samples [s].

    """
    highest, nyquist = 0.0, 0.5 / spacing
    for channel in [part for motion in motions for part in (motion.q, motion.v)
                    if part is not None]:
        f, power = periodogram(channel, 1.0 / spacing, 'hann', detrend='linear', axis=0)
        bands = np.geomspace(f[1], nyquist, 1 + max(8, round(10.0 * math.log2(nyquist / f[1]))))
        place = np.searchsorted(bands, f[1:], side='right')
        for column in power[1:].T:
            noise = float(np.median(column[f[1:] > 2.0 * nyquist / 3.0])) / math.log(2.0)
            count, total = np.bincount(place), np.bincount(place, column)
            seen = np.flatnonzero((count > 0) & (total > _SIGNAL * noise * count))
            if seen.size:
                highest = max(highest, float(bands[min(seen[-1], len(bands) - 1)]))
    return min(_FASTEST, _ABOVE_MOTION * highest) if highest else _FASTEST


class Pieces(NamedTuple):
    """A motion, its samples in pieces without gaps, and the sampling interval [s]."""

    motion: Motion
    rows: list[np.ndarray]
    spacing: float


def _check_copies(motion: Motion, report: ReadingReport) -> None:
    """
    Raise DataError if a coordinate or a force is a copy of a coordinate.

    Forces in other units are scaled copies. Opposite ones may be those of a controller.
    """
    what, d = 'command' if motion.commanded else 'force', motion.q.shape[1]
    forces = () if motion.tau is None else motion.tau.T
    columns = [*zip(motion.labels, motion.q.T, strict=False),
               *((f'{what} {k + 1}', x) for k, x in enumerate(forces))]
    for k, (label, x) in enumerate(columns):
        # Several motors may have one command.
        for other, y in columns[:min(k, d)]:
            if x.size and np.ptp(x) > 0.0 and np.array_equal(x, y):
                raise DataError(f'{motion.where}: {label} has the numbers of {other}: one column '
                                'is a copy of the other; check the columns or topics')
    if motion.commanded:
        return
    measured = [*motion.q.T, *(() if motion.v is None else motion.v.T)]
    for (k, x), (label, y) in product(enumerate(forces), zip(
            motion.labels, measured, strict=False)):
        there = np.isfinite(x) & np.isfinite(y)
        (own, both), (_, other) = np.cov(x[there], y[there])
        if own > 0.0 and both**2 > (1.0 - _COPIED**2) * own * other:
            said = f'force {k + 1} is {both / other:.4g} times {label}, up to a constant'
            if both > 0.0:
                raise DataError(f'{motion.where}: {said}: one column is a scaled copy of the '
                                'other; check the columns or topics, or set data.forces: none')
            report.note(f'{said}: the log does not tell it from a spring or friction')


def _check_motions(cut: Sequence[Pieces]) -> None:
    """Raise DataError if positions of bodies alternate, or all of them are noise."""
    runs = [(one.motion, unwrap_turns(one.motion.t[rows], one.motion.q[rows], None)[0])
            for one in cut for rows in one.rows]
    for motion, q in runs:
        for label, x in zip(motion.labels, q.T, strict=False):
            if interleaved(x):
                raise DataError(f'{motion.where}: {label} goes to and fro between two motions, as '
                                'of two bodies in one column; give each a log of its own')
    # Noise of angles that is unwrapped is a random walk.
    if all(is_noise(x) for one in cut for rows in one.rows for x in one.motion.q[rows].T):
        raise DataError(f'{motion.where}: no sample of {listed(motion.labels[:q.shape[1]])} is '
                        'related to those before it: it is noise, at rest, or sampled less than '
                        'twice a period; measure a motion')


def pieces_of(motion: Motion, on_bad: str, report: ReadingReport) -> Pieces:
    """Drop bad samples of a motion; raise DataError if most are bad or on_bad is fail."""
    if not len(motion.t):
        raise DataError(f'{motion.where}: no samples, expected at least {report.least}; record '
                        'for longer')
    latest = float(np.nanmax(motion.t, initial=0.0))
    if latest > _LATEST:
        raise DataError(f'{motion.where}: a time of {latest:.4g} s is after the year 5000: times '
                        'must be in seconds; convert them from ms, us or ns')
    if motion.v is not None and not np.isfinite(motion.v).any(axis=0).all():
        motion = replace(motion, v=None)
    report.note(*motion.notes, *['velocities estimated'] * (motion.v is None))
    kept = _usable_samples(motion, on_bad, report)
    intervals = np.diff(motion.t[kept])
    spacing = float(np.median(intervals[intervals > 0.0])) if len(kept) > 1 else 0.0
    gap = intervals > GAP * spacing
    if gap.any() and on_bad == 'fail':
        raise DataError(f'{motion.where}: a gap of {intervals.max():.3g} s between samples, '
                        f'usually {spacing:.3g} s apart; split the run there, or use data.on_bad: '
                        'split')
    gap |= intervals <= 0.0  # the clock was set back
    if on_bad == 'split':
        gap |= np.diff(kept) > 1
    if report.least > 1 and not motion.commanded:
        whole = np.split(kept, np.flatnonzero(gap) + 1)
        gap[_velocity_jumps(motion, whole, on_bad, report)] = True
    pieces = np.split(kept, np.flatnonzero(gap) + 1)
    report.cuts += len(pieces) - 1
    long = [piece for piece in pieces if len(piece) >= report.least]
    report.short += len(kept) - sum(map(len, long))
    if not long:
        bridge = '' if on_bad == 'drop' else ', or use data.on_bad: drop'
        raise DataError(f'{motion.where}: no {report.least} successive samples without a gap; '
                        f'record for longer{bridge}')
    return Pieces(motion, long, spacing)


def _velocity_jumps(motion: Motion, pieces: Sequence[np.ndarray], on_bad: str,
                    report: ReadingReport) -> list[int]:
    """Return the numbers of samples in pieces behind which a velocity jumps: motions joined."""
    found, first = list[int](), 0
    for rows in pieces:
        t, v = motion.t[rows], motion.v
        q, _ = unwrap_turns(t, motion.q[rows], None if v is None else v[rows])
        for k, label in enumerate(motion.labels[:q.shape[1]]):
            at = velocity_jumps(t, q[:, k], None if v is None else v[rows, k])
            if not at.size:
                continue
            said = f'the velocity of {label} jumps in a sample{times_text(t[at])}'
            if on_bad == 'fail':
                raise DataError(f'{motion.where}: {said}: number its runs in a column '
                                '(data.trial), or use data.on_bad: drop')
            report.note(f'{said}, where another motion begins')
            found += (first + at - 1).tolist()
        first += len(rows)
    return found


def _usable_samples(motion: Motion, on_bad: str, report: ReadingReport) -> np.ndarray:
    """Return the indices of usable samples; time decreases between two at a reset."""
    lacks = {name: ~(np.abs(part) <= MAX_VALUE).reshape(len(motion.t), -1).all(axis=1)
             for name, part in motion.channels.items()}
    lacking = np.any([*lacks.values()], axis=0)
    there = np.flatnonzero(~lacking)
    resets = clock_resets(motion.t[there])
    parts = [part[increasing_samples(motion.t[part])]
             for part in np.split(there, resets) if len(part)]
    kept = np.concatenate([*parts, there[:0]])
    late = ~lacking
    late[kept] = False
    wrong = np.flatnonzero(lacking | late)
    if on_bad == 'fail' and (wrong.size or resets.size):
        at = min([*wrong[:1], *there[resets[:1]]])
        what = 'lacks a number' if lacking[at] else \
            'is not later than the previous one, or that one is wrong'
        raise DataError(f'{motion.where}: sample {at + 1} {what}; remove it, or use data.on_bad: '
                        'drop or split')
    if wrong.size > _MOST_BAD * len(motion.t):
        counts = ', '.join(f'{part.sum()} lack a number of '
                           f'{"the commands" if name == "tau" and motion.commanded else name}'
                           for name, part in lacks.items() if part.any())
        raise DataError(f'{motion.where}: ' + (repeated_text(motion.t) or (
            f'of {len(motion.t)} samples {counts or "none lacks a number"}, and {late.sum()} are '
            'not later than the previous one: they are not states of one motion; check the '
            'columns or topics')))
    report.lacking += int(lacking.sum())
    report.late += int(late.sum())
    if len(kept) < report.least:
        raise DataError(f'{motion.where}: {counted(len(kept), "sample")}, expected at least '
                        f'{report.least}; record for longer')
    return _without_faults(motion, parts, on_bad, report) if report.least > 1 else kept


def _without_faults(motion: Motion, parts: Sequence[np.ndarray], on_bad: str,
                    report: ReadingReport) -> np.ndarray:
    """Return the samples of the parts of a motion that its sensor got right."""
    good = []
    for part in parts:
        wrong, notes = faults(motion.t[part], motion.q[part],
                              None if motion.v is None else motion.v[part], motion.labels,
                              motion.where, motion.commanded)
        if notes and on_bad == 'fail':
            raise DataError(f'{motion.where}: {notes[0]}; leave them out, or take data.on_bad: '
                            'drop or split')
        report.note(*notes)
        good.append(part[~wrong])
    return np.concatenate(good)


def _even_pieces(pieces: Pieces, usual: float, data: MotionData, report: ReadingReport
                 ) -> Iterator[Motion]:
    """Resample each piece of a motion; `usual` is the interval of most samples [s]."""
    motion, pieces_rows, spacing = pieces
    # Jittering clocks make one rate look like several.
    if abs(spacing - usual) > _ALIKE * usual:
        report.note(f'{motion.name} resampled from {spacing:.4g} s to {usual:.4g} s')
    driven = motion.tau is not None and np.nan_to_num(motion.tau).any()
    moving = pieces_rows if driven else [
        part for rows in pieces_rows for part in _in_motion(motion, rows, spacing, report)]
    long = [rows for rows in moving
            if motion.t[rows[-1]] - motion.t[rows[0]] > (MIN_SAMPLES - 1.5) * usual]
    report.short += sum(map(len, moving)) - sum(map(len, long))
    for number, rows in enumerate(long):
        piece = unwrapped_piece(motion, rows, report)
        check_rates(piece)
        if are_differences(piece):
            report.differences[motion.name] = None
            piece = replace(piece, v=None)
        logged = piece if motion.commanded else None
        alone = part_of(piece, spaced_samples(piece.t, _CLOSE * spacing))
        if piece.v is None:
            report.close += len(piece.t) - len(alone.t)
            piece = alone
        name = motion.name if len(long) == 1 else f'{motion.name}#{number}'
        even = resampled(replace(piece, inputs=data.inputs or motion.inputs), usual)
        yield replace(even, name=name, logged=logged, q_alone=None if piece.v is None else cubic(
            even.t, alone.t, alone.q))


def _in_motion(motion: Motion, rows: np.ndarray, spacing: float, report: ReadingReport
               ) -> list[np.ndarray]:
    """Return the parts of some samples of a free motion in which it moves."""
    piece = part_of(motion, rows)
    # Between crowded stamps, noise looks like speed.
    kept = spaced_samples(piece.t, _CLOSE * spacing)
    parts, note = cut_at_rest(piece.t[kept], unwrap_turns(piece.t, piece.q, piece.v)[0][kept])
    report.note(*[f'{motion.name} {note}'] * bool(note))
    return [rows[kept[part[0]]:kept[part[-1]] + 1] for part in parts]


def unwrapped_piece(motion: Motion, rows: np.ndarray, report: ReadingReport) -> Motion:
    """Return some samples of a motion with angles unwrapped."""
    piece = part_of(motion, rows)
    q, turning = unwrap_turns(piece.t, piece.q, piece.v)
    report.note(*(f'{motion.labels[k]} unwrapped' for k in turning))
    return replace(piece, q=q)


def resampled(motion: Motion, spacing: float, between: Between = linear) -> Motion:
    """
    Resample a motion at even times.

    Parameters
    ----------
    motion : Motion
        Motion without missing numbers and gaps.
    spacing : float
        Time between samples [s].
    between : callable
        Interpolation of channels with unmeasured rates: ``linear`` does not overshoot on noise,
        ``cubic`` is more accurate for slow motions.

    """
    t, times = motion.t, even_times(motion.t, spacing)
    q, v, a, tau = motion.q, motion.v, motion.a, motion.tau
    if tau is not None:
        # If each force is held until the next, the latest one applies.
        tau = tau[np.searchsorted(t, times + 1e-9 * spacing, side='right') - 1] \
            if motion.held else (cubic if motion.inputs == 'spline' else linear)(times, t, tau)
    # The slope v improves the interpolation of q: driver clocks jitter by much of an interval.
    q = cubic(times, t, q) if v is None else CubicHermiteSpline(t, q, v)(times)
    if v is not None:
        v = between(times, t, v) if a is None else CubicHermiteSpline(t, v, a)(times)
    a, p, dp_dt = (None if part is None else between(times, t, part)
                   for part in (a, motion.p, motion.dp_dt))
    return replace(motion, t=times, q=q, v=v, a=a, p=p, dp_dt=dp_dt, tau=tau)


def check_rates(motion: Motion) -> None:
    """Raise DataError if velocities or accelerations contradict the measured changes."""
    for name, of, x, rate, remedy in (
            ('velocities', 'positions', motion.q, motion.v,
             'have them estimated (data.velocities: none)'),
            ('accelerations', 'velocities', motion.v, motion.a, 'remove a')):
        if x is None or rate is None:
            continue
        shares = unexplained_share(motion.t, x, rate)
        if (shares > _UNEXPLAINED).any():
            worst = int(np.nanargmax(shares))
            raise DataError(
                f'{motion.where}: the {name} of {motion.labels[worst]} are not the rates of its '
                f'{of}: {100.0 * min(shares[worst], 1.0):.0f} % of its motion is not in them; '
                f'check both for other units, another sign, zeros or outliers, or {remedy}')


def are_differences(motion: Motion) -> bool:
    """
    Return True if velocities are differences of successive positions, as of an encoder.

    They add nothing to the positions, and are those of half an interval before or after.
    """
    if motion.v is None:
        return False
    slopes = np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None]
    bound = _DIGITS * np.abs(motion.v).max(axis=0)
    return bool((bound > 0.0).any()) and any(
        (np.abs(rates - slopes) <= bound).mean() > _MOST_OF_THEM
        for rates in (motion.v[1:], motion.v[:-1]))


def smoothed(name: str, t: np.ndarray, q: np.ndarray, v: np.ndarray | None, tau: np.ndarray,
             cutoff: float, a: np.ndarray | None = None) -> EvenMotion:
    """Return a smoothed motion at even times, with missing rates estimated."""
    def smooth(values: np.ndarray) -> np.ndarray:
        return low_pass(name, values, float(t[1] - t[0]), cutoff)

    def rate(values: np.ndarray) -> np.ndarray:
        return CubicSpline(t, values)(t, 1)

    q_smooth = smooth(q)
    v_smooth = rate(q_smooth) if v is None else smooth(v)
    return EvenMotion(
        name=name, where=name, t=t, q=q, v=v, tau=tau, a=a, q_smooth=q_smooth, v_smooth=v_smooth,
        a_smooth=rate(v_smooth) if a is None else smooth(a), cutoff=cutoff)


def _positions_alone(motion: Record) -> Record:
    return replace(motion, v=None, q=motion.q if motion.q_alone is None else motion.q_alone)


def of_positions(motions: Sequence[EvenMotion]) -> list[EvenMotion]:
    """Return motions as if velocities had not been measured."""
    bare, cutoff = [_positions_alone(motion) for motion in motions], motions[0].cutoff_alone
    cutoff = cutoff_of(bare, motions[0].spacing) if cutoff is None else cutoff
    return [replace(smoothed(one.name, one.t, one.q, None, one.tau, cutoff, one.a),
                    where=one.where, inputs=one.inputs, idle=one.idle, cutoff_alone=cutoff,
                    commanded=one.commanded, logged=one.logged)
            for one in bare]


def delayed(motion: EvenMotion, samples: float) -> EvenMotion:
    """Delay the forces by a number of samples; the first and last forces are held."""
    at = np.arange(len(motion.t), dtype=np.float64)
    between = cubic if motion.inputs == 'spline' else linear
    return replace(motion, tau=between(np.clip(at - samples, 0.0, at[-1]), at, motion.tau))


def with_commands(motion: Motion, command: np.ndarray | None, enabled: np.ndarray | None
                  ) -> Motion:
    """Return a motion with commanded positions, (N, m), and OFF where motors are not enabled."""
    if command is None:
        return motion
    on = np.ones((len(command), 1)) if enabled is None else enabled.reshape(enabled.shape[0], -1)
    if on.shape not in ((len(command), 1), command.shape):
        raise DataError(f'{motion.where}: enabled has shape {on.shape}, expected one column, or '
                        f'one for each command, of {len(command)} samples')
    # Unknown is neither on nor off.
    tau = np.where(np.isnan(on), np.nan, np.where(on != 0.0, command, OFF))
    return replace(motion, tau=tau, inputs='held', commanded=True)


def run_of(motion: Motion) -> str:
    """Return the name of the run that a piece was cut from."""
    return motion.name.rpartition('#')[0] or motion.name


def joined(motions: Sequence[Motion], *channels: str) -> Iterator[np.ndarray]:
    """Yield channels of all motions, one after another."""
    return (np.concatenate([getattr(motion, name) for motion in motions]) for name in channels)


def train_and_test(runs: Sequence[Record], test_runs: Sequence[str]
                   ) -> tuple[list[Record], list[Record]]:
    """
    Split runs into training and test runs: the named ones, or the last fifth of each run.

    Raises
    ------
    DataError
        A named run is missing.

    """
    names = list(dict.fromkeys(run_of(run) for run in runs))
    for name in test_runs:
        if name not in names:
            raise DataError(f'data.test_runs: no run {name!r} among {listed(names)}')
    if test_runs:
        return ([run for run in runs if run_of(run) not in test_runs],
                [run for run in runs if run_of(run) in test_runs])
    ends = [4 * len(run.t) // 5 for run in runs]
    return ([part_of(run, slice(None, end)) for run, end in zip(runs, ends, strict=True)],
            [part_of(run, slice(end, None)) for run, end in zip(runs, ends, strict=True)])


def part_of(record: Record, rows: slice | np.ndarray) -> Record:
    """Return a run, or another dataclass, with some rows of each of its arrays."""
    parts: dict[str, Any] = {name: values[rows] for name, values in vars(record).items()
                             if isinstance(values, np.ndarray)}
    return replace(record, **parts)
