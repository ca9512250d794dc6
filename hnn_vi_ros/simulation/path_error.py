# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Path error of a run, from the distances between it and repetitions with other steps."""

from dataclasses import dataclass
import math

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import column_units
import numpy as np

# Path error over amplitude at which a path is lost, above which an alarm may be raised, and below
# which the path counts as accurate.
LOST, LIMIT, ACCURATE = 1.0, 0.1, 0.01
# The limit of a run of so few steps that a motion from rest has hardly developed.
FEW_STEPS_LIMIT = 0.25
# Smaller path errors are rounding errors.
_ROUNDING = 1e-12
# Largest error over the distance of a run with looser tolerances, measured with dry friction.
_TOLERANCE_BOUND = 3.0
# Margin of the bound of a method of order one, whose errors reach it; measured with such methods.
_FIRST_ORDER_MARGIN = 1.5
# Reason of a run whose path error nobody asked for.
OFF = 'path_error is off'
# Turns during which a path must be kept; in chaos, where it cannot be kept for long, one.
_TURNS, _CHAOTIC_TURNS = 10.0, 1.0
# Amplitudes below these shares of the largest one in the same unit, and of the largest coordinate,
# are those of a coordinate at rest, and rounding errors.
_MIN_AMPLITUDE_SHARE, _MIN_RELATIVE_AMPLITUDE = 1e-3, 1e-9
# Distances above this share of the amplitude no longer grow as those of small errors do.
_MAX_RATIO_DISTANCE = 0.2
# Growth of the error, as a logarithm, in the second half of a time, and the least share of it in
# the quarter before, for chaos. Regular motions reach log 2^3, since errors grow as t^3 at most.
_MIN_CHAOTIC_GROWTH, _MIN_EARLIER_SHARE = 5.0, 0.25
# Number of instants of a series of distances; beyond twice as many, every second is dropped.
_INSTANTS = 256


class ComparedMotion:
    """
    Coordinates of m trajectories in the form in which they are compared.

    Rotations are compared by their angles, all other coordinates by their values.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of one trajectory.
    turning : np.ndarray, shape (d,)
        Mask of the columns of q that are periodic angles.
    start : np.ndarray, shape (m, d)
        q at the start.

    """

    def __init__(self, hamiltonian: Hamiltonian, turning: np.ndarray, start: np.ndarray):
        self._rotations, self.start = hamiltonian.rotations, start
        inside = {first + i for first in self._rotations for i in range(4)}
        self._scalars = [k for k in range(hamiltonian.dimension) if k not in inside]
        units = column_units(hamiltonian.coordinates)[0]
        own = [units[k] for k in self._scalars] + ['rad'] * len(self._rotations)
        self._groups = [np.flatnonzero(np.array(own) == unit) for unit in dict.fromkeys(own)]
        self.turning = np.append(turning[self._scalars], np.ones(len(self._rotations), bool))

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return the values of q, (k, m, d), whose ranges are amplitudes; shape (k, m, f)."""
        return np.concatenate([q[..., self._scalars], *(
            2.0 * _angle(q, self.start, first) for first in self._rotations)], axis=-1)

    def distances(self, q: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return the distances of two paths, each of shape (k, m, d); shape (k, m, f)."""
        apart = np.concatenate([
            np.abs(q[..., self._scalars] - other[..., self._scalars]),
            *(_angle(q, other, first) for first in self._rotations)], axis=-1)
        # A full turn of a periodic angle is as far as its error can go.
        apart[..., self.turning] = np.minimum(apart[..., self.turning], math.pi)
        return apart

    def floor(self, amplitude: np.ndarray, largest: np.ndarray) -> np.ndarray:
        """Return the least amplitude that counts, given the largest value; shape (..., f)."""
        floor = np.empty_like(amplitude)
        for group in self._groups:
            floor[..., group] = np.maximum(
                _MIN_AMPLITUDE_SHARE * amplitude[..., group].max(axis=-1, keepdims=True),
                _MIN_RELATIVE_AMPLITUDE * largest[..., group].max(axis=-1, keepdims=True))
        return floor


def _angle(q: np.ndarray, other: np.ndarray, first: int) -> np.ndarray:
    """Return the angle between two rotations, given by four columns from `first` on."""
    product = np.abs((q[..., first:first + 4] * other[..., first:first + 4]).sum(
        axis=-1, keepdims=True))
    return 2.0 * np.arccos(np.minimum(product, 1.0))


class Range:
    """Lowest and highest values of a path so far, each of shape (m, f)."""

    def __init__(self, start: np.ndarray):
        self._low = self._high = start

    def add(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return amplitude and largest magnitude up to each of the next instants, (k, m, f)."""
        low = np.minimum.accumulate(np.concatenate([self._low[None], values]))[1:]
        high = np.maximum.accumulate(np.concatenate([self._high[None], values]))[1:]
        if len(values):
            self._low, self._high = low[-1], high[-1]
        return 0.5 * (high - low), np.maximum(np.abs(low), np.abs(high))


class Separation:
    """
    Largest distance so far of two paths over their amplitude so far, at instants.

    The amplitude of a coordinate is half of its range, of the path where it is smaller. The first
    instants are compared with the amplitude after them, since a motion from rest has hardly any at
    first.

    Parameters
    ----------
    motion : ComparedMotion
        Form of the comparison.
    first : int
        Number of the first instants.

    Attributes
    ----------
    steps : list of int
        Steps of the instants since the start.
    values : list of np.ndarray, shape (m,)
        Largest of the coordinates at each instant.
    last : np.ndarray, shape (m,)
        The last of them.
    apart : np.ndarray, shape (m, f)
        Largest distance of each coordinate.

    """

    def __init__(self, motion: ComparedMotion, first: int):
        self._motion, self._first = motion, first
        start = motion.values(motion.start[None])[0]
        self._ranges, self.apart = (Range(start), Range(start)), np.zeros_like(start)
        self._amplitude = np.ones_like(start)
        self.steps, self.values = list[int](), list[np.ndarray]()
        self.last = np.zeros(len(start))
        self._waiting: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._spacing, self._seen = 1, 0

    def add(self, steps: np.ndarray, q: np.ndarray, other: np.ndarray, end: bool = False) -> None:
        """Add the next instants of both paths, (k, m, d); `end` if no others follow."""
        self._waiting.append((steps, q, other))
        if self._first and not end and sum(
                len(part) for part, _, _ in self._waiting) < self._first:
            return
        steps, q, other = (np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        self._waiting = []
        if not len(steps):
            return
        amplitude, largest = self._ranges[0].add(self._motion.values(q))
        second, _ = self._ranges[1].add(self._motion.values(other))
        amplitude = np.minimum(amplitude, second)
        for part in (amplitude, largest):
            part[:self._first] = part[min(self._first, len(part)) - 1]
        self._first = 0
        turning = self._motion.turning
        amplitude[..., turning] = np.minimum(amplitude[..., turning], math.pi)
        amplitude = np.maximum(amplitude, self._motion.floor(amplitude, largest))
        apart = np.maximum.accumulate(np.concatenate([
            self.apart[None], self._motion.distances(q, other)]))[1:]
        self.apart, self._amplitude = apart[-1], amplitude[-1]
        with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
            found = np.where(apart > 0.0, apart / amplitude, 0.0).max(axis=-1)
        # Not a number: a path has diverged.
        found = np.where(np.isnan(found), np.inf, found)
        self.last = found[-1]
        for step, value in zip(steps.tolist(), found, strict=True):
            if self._seen % self._spacing == 0:
                self.steps.append(step)
                self.values.append(value)
            self._seen += 1
        while len(self.steps) > 2 * _INSTANTS:
            self.steps, self.values = self.steps[1::2], self.values[1::2]
            self._spacing *= 2

    def share(self, apart: np.ndarray) -> np.ndarray:
        """Return the largest of other distances, (m, f), over the last amplitude, shape (m,)."""
        with np.errstate(invalid='ignore', divide='ignore'):
            return np.where(apart > 0.0, apart / self._amplitude, 0.0).max(axis=-1)

    def finish(self) -> None:
        """Compare the instants that still wait for others."""
        d = self._motion.start.shape
        self.add(np.empty(0, int), np.empty((0, *d)), np.empty((0, *d)), end=True)

    @property
    def course(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps, (k,), and the shares there, (k, m)."""
        rows = len(self._motion.start)
        return np.array(self.steps, int), np.array(self.values).reshape(-1, rows)


class Turns:
    """
    Number of turns of m trajectories: length of the path over four amplitudes.

    Attributes
    ----------
    ends : np.ndarray, shape (2, m)
        First step at which a coordinate has made one turn, and at which all that have made one
        have made ten; inf before.

    """

    def __init__(self, motion: ComparedMotion):
        self._motion = motion
        start = motion.values(motion.start[None])
        self._range, self._last, self._length = Range(start[0]), start, np.zeros_like(start)
        self.ends = np.full((2, start.shape[1]), np.inf)

    @property
    def counted(self) -> bool:
        """Return whether all trajectories have made their turns."""
        return bool(np.isfinite(self.ends[1]).all())

    def add(self, step: int, q: np.ndarray) -> None:
        """Add the states after the next steps, (n, m, d), of which `step` is the first."""
        values = self._motion.values(q)
        path = np.concatenate([self._last, values])
        length = self._length + np.abs(np.diff(path, axis=0)).cumsum(axis=0)
        self._last, self._length = values[-1:], length[-1:]
        amplitude, largest = self._range.add(values)
        moves = amplitude >= self._motion.floor(amplitude, largest)
        # A quarter turn of an angle that goes around.
        around = self._motion.turning & (amplitude > math.pi)
        with np.errstate(invalid='ignore', divide='ignore'):
            turns = length / (4.0 * np.where(around, 0.5 * math.pi, amplitude))
        oscillates = moves & (turns >= _CHAOTIC_TURNS)
        slowest = np.where(oscillates, turns, np.inf).min(axis=-1)
        for ends, least in zip(self.ends, (_CHAOTIC_TURNS, _TURNS), strict=True):
            made = (slowest >= least) & oscillates.any(axis=-1)
            first = np.where(made.any(axis=0), step + made.argmax(axis=0), np.inf)
            np.copyto(ends, np.minimum(ends, first))


@dataclass(frozen=True)
class Repetition:
    """
    Steps or tolerances with which a run is repeated, and the errors that the distances show.

    Parameters
    ----------
    factors : tuple of float
        Step sizes, or tolerances, of the second and the third run, relative to those of the run.
    strides : tuple of (int, int)
        Steps of the run between common instants with each of them.
    own : tuple of (int, int)
        Steps of each of them between these.
    exponents : tuple of (float, float)
        Least and largest exponent of the factors in the error: the order of the method, seen.
    adaptive : bool
        The factors are those of tolerances.

    """

    factors: tuple[float, float]
    strides: tuple[int, int]
    own: tuple[int, int]
    exponents: tuple[float, float]
    adaptive: bool = False

    @property
    def bound(self) -> float:
        """Return the largest error over the distance of the second run: that of order one."""
        margin = _FIRST_ORDER_MARGIN if self.exponents[1] == 1.0 else 1.0
        return _TOLERANCE_BOUND if self.adaptive else margin / abs(self.factors[0] - 1.0)

    @property
    def _ratio(self) -> float:
        """Return the smaller of two successive factors over the larger."""
        return self.factors[0] if self.factors[0] < 1.0 else 1.0 / self.factors[0]

    def exponent(self, second: np.ndarray, third: np.ndarray) -> np.ndarray:
        """
        Return the exponents seen in the distances D, G of a run from the second and third one.

        With errors C f^a of runs with the factors 1, f > 1 and 1 / f:

            D = C (f^a - 1),  G = C (1 - f^-a),  D / G = f^a,

        and with the factors 1, 1 / 2 and 1 / 4: G / D = 1 + 2^-a.
        """
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            power = second / third if self.factors[0] > 1.0 else 1.0 / np.maximum(
                third / second - 1.0, 0.0)
            seen = np.log(power) / -math.log(self._ratio)
        low, high = self.exponents
        return np.clip(np.where(np.isnan(seen), high, seen), low, high)

    def error(self, second: np.ndarray, third: np.ndarray, exponent: np.ndarray) -> np.ndarray:
        """
        Return the errors: G / (1 - f^-a), or D / (1 - 2^-a); see ``exponent``.

        Both are at least G. Where D / (1 - 2^-a) is not, h / 2 is as wrong as h.
        """
        nearer = third if self.factors[0] > 1.0 else second
        return np.maximum(nearer / (1.0 - self._ratio ** exponent), third)


@dataclass(frozen=True, repr=False)
class PathError:
    """
    Error of the path of a run, relative to the amplitude of its coordinates.

    The run was taken again with other steps (see SecondRun). The error at a time is the largest so
    far of a coordinate q over half of the range of that coordinate so far.

    Parameters
    ----------
    t : np.ndarray, shape (k,)
        Times [s].
    value : np.ndarray, shape (k,)
        Error up to each time [1]: a bound, or an estimate, right within a factor of about two.
    estimated : bool
        True for an estimate.
    chaotic : float
        Time in which the error doubles, if the motion is chaotic [s]; NaN if not.
    limit : float
        Error that is an alarm before the time `needed`.
    needed : float
        Time until which the path must be kept for the run to be called right [s]: that of the
        scene, or ten turns of the slowest coordinate that oscillates, one in chaos; inf before.
    exponent : float
        Exponent of the step size, or of the tolerance, in the error; NaN for a bound.
    reason : str
        Reason that it was not measured; then there are no times.

    """

    t: np.ndarray
    value: np.ndarray
    estimated: bool = False
    chaotic: float = math.nan
    limit: float = LIMIT
    needed: float = math.inf
    exponent: float = math.nan
    reason: str = ''

    @classmethod
    def unmeasured(cls, reason: str) -> 'PathError':
        """Return the path error of a run in which it was not measured."""
        return cls(np.empty(0), np.empty(0), reason=reason)

    @property
    def numbers(self) -> tuple[object, ...]:
        """Return the other arguments than t and value, in their order."""
        return (self.estimated, self.chaotic, self.limit, self.needed, self.exponent, self.reason)

    @property
    def largest(self) -> float:
        """Return the error at the end, or where the comparison ended; NaN if not measured."""
        return float(self.value[-1]) if len(self.value) else math.nan

    def until(self, error: float) -> float:
        """Return the time until which the error stays below a value [s]; inf if to the end."""
        beyond = self.value > error
        return float(self.t[beyond.argmax()]) if beyond.any() else math.inf

    @property
    def lost(self) -> float:
        """Return the time [s] at which the error exceeds its limit too early; NaN if none."""
        time = self.until(self.limit)
        return time if self.estimated and time < self.needed else math.nan

    def __repr__(self) -> str:
        return f'PathError({self})'

    def __str__(self) -> str:
        if self.reason or not len(self.value):
            return f'path error not measured: {self.reason or "too few steps were taken"}'
        if not self.estimated:
            return f'path error below {_share(self.largest)} of the amplitude'
        accurate = self.until(ACCURATE)
        # An amplitude that grows may make an earlier error small.
        since = '' if math.isinf(accurate) or self.largest < ACCURATE else (
            f', below 1 % until {accurate:.3g} s')
        if not math.isnan(self.chaotic):
            return (f'chaotic: the path error doubles every {self.chaotic:.2g} s'
                    f'{since.replace(", below", " and is below")}')
        if self.largest >= LOST:
            return f'the path is lost at {self.until(LOST * (1.0 - 1e-9)):.3g} s{since}'
        return (f'path error {_share(self.largest)} of the amplitude at {self.t[-1]:.3g} s'
                f'{since}')


def _share(share: float) -> str:
    """Return a share rounded up to one digit, or in per cent."""
    if share >= ACCURATE:
        return f'{100.0 * share:.2g} %'
    return f'{max(share, _ROUNDING):.1g}'


def path_errors_of(repetition: Repetition, step_size: float, origin: int, early: np.ndarray,
                   second: Separation, third: Separation | None, turns: Turns,
                   needed: float | None = None, limit: float = LIMIT) -> list[PathError]:
    """
    Return the path errors of m trajectories from their distances.

    Parameters
    ----------
    repetition : Repetition
        How the run was repeated.
    step_size : float
        Step size of the run [s].
    origin : int
        Steps of the run before the start of the comparison.
    early : np.ndarray, shape (m,)
        Distance from a run with h / 2 in the first steps, over the amplitude.
    second, third : Separation
        Distances from the second and from the third run, if there was one.
    turns : Turns
        Turns of the run.
    needed : float, optional
        Time until which the path must be kept [s]; by default for ten turns, one in chaos.
    limit : float, optional
        Error that is an alarm.

    """
    steps, value = second.course
    one, ten = (origin + turns.ends) * step_size if needed is None else np.full(
        turns.ends.shape, needed)
    if third is None:
        t, bounds = (origin + steps) * step_size, np.maximum(
            repetition.bound * value, 2.0 * early)
        return [PathError(t, bound, limit=limit, needed=float(end))
                for bound, end in zip(bounds.T.copy(), ten, strict=True)]
    at, finer = third.course
    # Behind a lost path, where the comparisons end, nothing is known.
    known = np.minimum((np.searchsorted(steps, at, side='right') - 1)[:, None],
                       _until_lost(value) - 1)
    coarser = np.take_along_axis(value, np.maximum(known, 0), axis=0) if len(
        value) else np.full(finer.shape, math.inf)
    exponents, small = repetition.exponent(coarser, finer), coarser <= _MAX_RATIO_DISTANCE
    # Large distances no longer grow as the errors do: the exponent is the last one seen before.
    ends = _until_lost(finer)
    compared = np.arange(len(at))[:, None] < ends
    last = np.where(small & compared, np.arange(len(at))[:, None], -1).max(axis=0, initial=-1)
    seen = np.where(last < 0, repetition.exponents[0], exponents[
        last, np.arange(last.size)] if len(at) else math.nan)
    exponents = np.where(small, exponents, seen)
    error = np.maximum(repetition.error(coarser, finer, exponents),
                       early / (1.0 - 0.5 ** repetition.exponents[1]))
    ends = np.minimum(ends, _until_lost(error))
    found = list[PathError]()
    for row, end in enumerate(ends):
        own = error[:end, row].copy()
        doubling = _doubling(at[:end], own)
        exponent = exponents[end - 1, row] if last[row] >= 0 else repetition.exponents[1]
        found.append(PathError(
            (origin + at[:end]) * step_size, own, True, doubling * step_size, limit,
            float(ten[row] if math.isnan(doubling) else one[row]), float(exponent)))
    return found


def _until_lost(errors: np.ndarray) -> np.ndarray:
    """Return the numbers of the first errors, (k, m), up to those at which paths are lost."""
    lost = errors >= LOST
    return np.where(lost.any(axis=0), lost.argmax(axis=0) + 1, len(errors)) if len(
        errors) else np.zeros(errors.shape[1], int)


def _doubling(steps: np.ndarray, error: np.ndarray) -> float:
    """Return the number of steps in which an error that grows exponentially doubles, or NaN."""
    if not len(error) or error[-1] <= ACCURATE:
        return math.nan
    end = steps[int((error > LIMIT).argmax())] if error[-1] > LIMIT else steps[-1]
    logs = [math.log(max(float(error[max(np.searchsorted(steps, time, side='right') - 1, 0)]),
                         1e-300)) for time in (0.25 * end, 0.5 * end, end)]
    earlier, growth = np.diff(logs)
    if growth > _MIN_CHAOTIC_GROWTH and earlier > _MIN_EARLIER_SHARE * growth:
        return float(0.5 * end * math.log(2.0) / growth)
    return math.nan
