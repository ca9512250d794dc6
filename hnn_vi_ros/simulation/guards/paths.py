# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the path error, estimated by trials with half the step size."""

from collections.abc import Iterator
import math
from typing import NamedTuple

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.integrators import Dop853
from hnn_vi_ros.phase_space import column_units
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Guard, StateGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed, SampleBlock
from hnn_vi_ros.simulation.guards.scale import Scale
from hnn_vi_ros.simulation.simulation import RescuePending, Simulation
import numpy as np

# Maximum number of turns and of steps of a trial; minimum number of steps.
_MAX_TURNS, _MAX_STEPS, _MIN_STEPS = 3, 128, 8
# Number of steps of a trial of `taylor`, whose steps are long, and are taken in Python.
_SERIES_STEPS = 16
# A derivative of H beyond this multiple of its maximum so far triggers another trial.
_MIN_RATE_RATIO = 2.0
# Coordinates whose range is less than this share of the largest range are ignored.
_MIN_RANGE_SHARE = 1e-3
# Largest path error over path length: a quarter of a turn in a hundred turns.
_MAX_PATH_ERROR = 0.5 * math.pi / 400.0
# Maximum number of steps between samples for a trial to start at the earlier one.
_MAX_SAMPLE_STEPS = 16
# Steps at which trials of conservative runs start, relative to the trial before.
_TIMES_APART = 4
# Largest estimated error of a coordinate over its amplitude so far. Estimates are right within a
# factor of about five: runs that are off by 1 % of the amplitude pass, by 30 % do not.
_MAX_ESTIMATE = 0.06
# Trials of forced runs: number of steps, times between them as a multiple of that before, and
# distance of the neighbour relative to the motion.
_FORCED_STEPS, _FORCED_APART, _NEIGHBOUR = 48, 2.5, 1e-6
# Length of the first of them relative to the others, for the amplitude.
_FIRST_LOOK = 4
# Factor of their length for methods whose states are displaced.
_DISPLACED = 4
# Steps over which errors add up where no contraction limits it: about a hundred turns.
_MEMORY = 1e4
# Minimum energy error over the energy scale, times the number of internal steps, that is examined
# for its shift of the phase; size of the neighbour's displacement, relative to the motion.
_MIN_DRIFT, _ENERGY_STEP = 0.02, 1e-3
# Ranges below this share of a coordinate are rounding errors.
_MIN_RELATIVE_RANGE = 1e-9


class _Window(NamedTuple):
    """First step of a trial, error per step of each coordinate, and contraction rate per step."""

    step: int
    rate: np.ndarray
    contraction: np.ndarray


class PathEstimate:
    """
    Estimate of the path error of a run from the errors of some of its windows.

    A window of n steps errs by e, so that errors grow by e / n in each step; they decay at the
    rate lambda at which neighbouring motions approach each other: E' = e / n - lambda E.

    Attributes
    ----------
    value : float
        The largest estimate of abs(E) over the amplitude of its coordinate so far [1].

    """

    def __init__(self, simulation: Simulation):
        self.value, self._turning = 0.0, simulation.system.turning
        units = np.array(column_units(simulation.hamiltonian.coordinates)[0])
        # Ranges in different units cannot be compared.
        self._alike = units[:, None] == units
        self._low, self._high = np.array(math.inf), np.array(-math.inf)
        self._error, self._last = np.zeros(1), _Window(0, np.zeros(1), np.zeros(1))

    def add(self, step: int, paths: np.ndarray, error: np.ndarray, rate: np.ndarray,
            contraction: np.ndarray | float, ahead: int) -> None:
        """
        Add a window.

        Parameters
        ----------
        step : int
            First step of the window.
        paths : np.ndarray, shape (N, ..., d)
            Coordinates in the window.
        error : np.ndarray, shape (..., d)
            Largest error of each coordinate in the window.
        rate : np.ndarray, shape (..., d)
            The part of it that grows, per step.
        contraction : np.ndarray, shape (..., 1), or float
            Rate at which neighbouring motions approach each other, per step.
        ahead : int
            Number of steps until the next window, through which the error is extrapolated.

        """
        self._low = np.minimum(self._low, paths.min(axis=0))
        self._high = np.maximum(self._high, paths.max(axis=0))
        amplitude = 0.5 * (self._high - self._low)
        # A full turn of a periodic angle is as far as its error can go.
        amplitude[..., self._turning] = np.minimum(amplitude[..., self._turning], math.pi)
        rounding = np.maximum(self._largest(np.maximum(np.abs(self._low), np.abs(self._high))),
                              amplitude.max(axis=-1, keepdims=True))
        amplitude = np.maximum(_MIN_RANGE_SHARE * self._largest(amplitude), np.maximum(
            amplitude, _MIN_RELATIVE_RANGE * rounding))
        now, last = _Window(step, rate, np.asarray(contraction) + 1.0 / _MEMORY), self._last
        mean = _Window(step, 0.5 * (now.rate + last.rate),
                       0.5 * (now.contraction + last.contraction))
        self._error = _after(step - last.step, mean, self._error)
        self._last = now
        estimate = np.maximum(_after(ahead, now, self._error), error)
        with np.errstate(invalid='ignore'):
            share = np.where(amplitude > 0.0, estimate / amplitude, 0.0)
        # Not finite: the trial has diverged.
        self.value = max(self.value, float(share.max()) if np.isfinite(share).all() else math.inf)

    def _largest(self, sizes: np.ndarray) -> np.ndarray:
        """Return for each coordinate the largest of the sizes in its unit, shape (..., d)."""
        return np.where(self._alike, sizes[..., None, :], 0.0).max(axis=-1)


def _after(steps: int, window: _Window, error: np.ndarray) -> np.ndarray:
    """Return the error after a number of steps at the rates of a window."""
    last = window.rate / window.contraction
    return last + (error - last) * np.exp(-window.contraction * steps)


class PathGuard(BlockGuard):
    """
    Path error: it stays below 0.4 % of the path length, so that 100 turns are counted correctly.

    Trials start at the initial state, where a derivative of H has doubled, and at times that grow
    in proportion; they take up to three turns and 128 steps of h, and the same with h / 2. The
    paths differ by (1 - 2^-p) times the error of the former, with p the order of the method. Each
    coordinate and momentum is compared with the length of its own path. For an oscillator with
    relative frequency error s, error over length is pi s / 2; it loses a quarter of a turn in a
    hundred turns at s = 1 / 400. A path error below 1 % of the size of the path raises no alarm,
    since the length of three turns is at least twelve times that size. The errors of the trials
    also add up to an estimate of the error so far; see PathEstimate.

    With order 1 there is only the trial at the initial state: H~ - H changes along the path, so a
    trial from a later state would follow a different motion.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4.

    """

    kind = 'path not resolved'
    remedy = ('use a smaller step_size or a method of higher order; the energy may still be '
              'accurate')

    def __init__(self, simulation: Simulation):
        self._simulation, self.raised, self._error = simulation, False, 0.0
        self._estimate, self._next = PathEstimate(simulation), math.inf
        # Largest derivatives so far, and the previous sample.
        self._largest = np.zeros(0)
        self._before: tuple[int, np.ndarray, np.ndarray] | None = None

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        # An H learned through a scheme is valid at its own step size only, not at half of it.
        if (run.hamiltonian.scheme is None and run.conservative
                and run.simulation.q.size == run.hamiltonian.dimension):
            yield cls(run.simulation)

    def take(self, block: SampleBlock) -> list[Alarm]:
        alarms, at = [], 0
        slopes = np.abs(np.hstack([block.dH_dq, block.dH_dp]))
        later = self._simulation.integrator.order > 1
        while not self.raised and at < len(slopes):
            if self._before is not None:
                beyond = later & ((slopes[at:] > _MIN_RATE_RATIO * self._largest).any(axis=1)
                                  | (block.step[at:] >= self._next))
                at = at + int(beyond.argmax()) if beyond.any() else len(slopes)
            if at < len(slopes):
                if self._begin(block, at, slopes[at]):
                    self.raised = True
                    alarms.append(self._alarm(int(block.step[at])))
                self._before, at = self._sample(block, at), at + 1
        self._before = self._sample(block, -1)
        return alarms

    def _sample(self, block: SampleBlock, i: int) -> tuple[int, np.ndarray, np.ndarray]:
        return int(block.step[i]), block.q[i].copy(), block.p[i].copy()

    def _begin(self, block: SampleBlock, i: int, slopes: np.ndarray) -> bool:
        """Run a trial from just before a sample; return whether the path error is too large."""
        start = self._sample(block, i)
        before = self._sample(block, i - 1) if i > 0 else self._before
        if before is not None and start[0] - before[0] <= _MAX_SAMPLE_STEPS:
            start = before
        self._error, largest = self._try(*start)
        if not self._largest.size:
            self._largest = np.zeros_like(slopes)
        self._largest = np.maximum(np.maximum(self._largest, slopes), largest)
        for half in np.split(self._largest, [block.q.shape[1]]):
            half[:] = np.maximum(half, _MIN_RANGE_SHARE * half.max())
        return not (self._error <= _MAX_PATH_ERROR and self._estimate.value <= _MAX_ESTIMATE)

    def _try(self, step: int, q: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the path error over the path length, and the largest derivatives of H."""
        simulation, h, start = self._simulation, self._simulation.path_step, np.append(q, p)
        method = simulation.integrator
        steps = _MAX_STEPS if method.compiled or not method.tolerances else _SERIES_STEPS
        self._next = max(step + steps, _TIMES_APART * step)
        try:
            row, = simulation.rows(start[None])
            path, better = (np.vstack([start, np.hstack([
                part.reshape(steps, -1) for part in simulation.trial(
                    row, h / parts, steps, parts)])]) for parts in (1, 2))
        except (StepFailure, RescuePending):
            # A failing step is reported by the run itself.
            return 0.0, np.zeros(start.size)
        lengths = np.vstack([np.zeros(start.size), np.cumsum(
            np.abs(np.diff(better, axis=0)), axis=0)])
        ranges = np.maximum.accumulate(better) - np.minimum.accumulate(better)
        counts = np.hstack([half > _MIN_RANGE_SHARE * half.max(axis=1, keepdims=True)
                            for half in np.split(ranges, [q.size], axis=1)])
        turned = ((lengths > 2.0 * _MAX_TURNS * ranges) & counts).any(axis=1)
        turned[:_MIN_STEPS] = False
        end = int(turned.argmax()) if turned.any() else steps
        part, counted = np.s_[:end + 1], counts[end]
        order, begin = simulation.integrator.order, 0
        errors = np.abs(path - better) / (1.0 - 0.5 ** order)
        worst = errors[part].max(axis=0)
        if order == 1:
            # A method of order 1 may be conjugate to one of order 2 in states displaced by part
            # of a step. This displacement does not grow after the first turn: subtract it.
            begin = end // _MAX_TURNS
            worst -= errors[:begin + 1].max(axis=0)
            counted = counted & turned.any()
        self._estimate.add(step, better[part, :q.size], worst[:q.size],
                           worst[:q.size] / (end - begin) * (simulation.step_size / h), 0.0,
                           (self._next - step) // 2)
        slopes = np.hstack(simulation.hamiltonian.gradient(
            better[part, :q.size], better[part, q.size:]))
        return (float((worst / (lengths[end] - lengths[begin]))[counted].max(initial=0.0)),
                np.abs(slopes).max(axis=0))

    def _alarm(self, step: int) -> Alarm:
        if self._error <= _MAX_PATH_ERROR:
            return _estimate_alarm(step, self._estimate.value, self.smaller)
        return Alarm(self.kind, step, self._error, _MAX_PATH_ERROR,
                     f'the path error is {100.0 * self._error:.2g} % of the path length: the '
                     f'number of turns is wrong; use {self.smaller}, or a method of higher order',
                     '1')


def _estimate_alarm(step: int, value: float, smaller: str) -> Alarm:
    return Alarm(PathGuard.kind, step, value, _MAX_ESTIMATE,
                 f'a repetition of some steps with half the step size shows that the path is off '
                 f'{_share(value)} its amplitude; use {smaller}, or a method of higher order',
                 '1')


def _share(value: float) -> str:
    return f'by about {100.0 * value:.2g} % of' if value < 1.0 else 'by more than'


class PhaseGuard(BlockGuard):
    """
    Phase of conservative runs of `dop853`: the drift of the energy shifts it by 6 % at most.

    If the period depends on the energy, motions of other energies part in proportion to time.
    An energy error that grows as t then shifts the motion, relative to the amplitude, by

        E(t) = s abs(H - H0) t / 2,

    with s the rate at which two motions part, per difference of their energies [1/(J s)]. It is
    measured once the energy error may matter, over at most 128 internal steps. In chaos, where
    motions part faster than in proportion to time, E is too small.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory.
    scale : callable
        Returns the energy scale at each sample of a block [J]; see SampledScale.

    """

    kind = 'phase not resolved'
    remedy = 'use smaller tolerances, or a symplectic method'

    def __init__(self, simulation: Simulation, scale: Scale):
        self._simulation, self._scale, self._raised = simulation, scale, False
        self._first, self._rate, self._shift = math.nan, math.nan, 0.0

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if (isinstance(run.simulation.integrator, Dop853) and run.conservative
                and not run.hamiltonian.rotations
                and run.simulation.q.size == run.hamiltonian.dimension):
            yield cls(run.simulation, run.scale)

    def take(self, block: SampleBlock) -> list[Alarm]:
        scales, time = self._scale(block), block.step * self._simulation.step_size
        if math.isnan(self._first):
            self._first = float(block.energy[0])
        errors = np.abs(block.energy - self._first)
        relevant = np.flatnonzero(self._simulation.internal_steps[0] * errors
                                  > _MIN_DRIFT * scales)
        if self._raised or not relevant.size:
            return []
        if math.isnan(self._rate):
            self._rate = self._parting(np.append(block.q[relevant[0]], block.p[relevant[0]]))
        shifts = 0.5 * self._rate * errors * time
        self._shift = max(self._shift, float(shifts.max()))
        beyond = np.flatnonzero(shifts > _MAX_ESTIMATE)
        self._raised = beyond.size > 0
        return [self._alarm(int(block.step[beyond[0]]))] if self._raised else []

    def _parting(self, start: np.ndarray) -> float:
        """Return the rate at which motions of other energies part [1/(J s)]."""
        simulation, d = self._simulation, start.size // 2
        hamiltonian, taken = simulation.hamiltonian, int(simulation.internal_steps[0])
        h, steps = simulation.time / taken, max(_MIN_STEPS, min(taken, _MAX_STEPS))
        try:
            path = self._path(start, h, steps)
            sizes = 0.5 * np.ptp(path, axis=0)
            slopes = np.concatenate(hamiltonian.gradient(start[:d], start[d:]))
            other = start + _ENERGY_STEP * sizes * np.sign(slopes)
            apart = self._path(other, h, steps) - path
        except (StepFailure, RescuePending):
            # A failing step is reported by the run itself.
            return 0.0
        energies = hamiltonian.energy(*np.split(np.array([start, other]), 2, axis=1))
        kept = np.concatenate([half > _MIN_RANGE_SHARE * half.max()
                               for half in np.split(sizes, [d])])
        # This distance is constant in an oscillator, whose phase no energy shifts.
        distance = np.linalg.norm(apart[:, kept] / sizes[kept], axis=1)
        early, late = (float(half.mean()) for half in np.array_split(distance, 2))
        return max(late - early, 0.0) / (0.5 * steps * h * abs(energies[1] - energies[0]))

    def _path(self, start: np.ndarray, h: float, steps: int) -> np.ndarray:
        row, = self._simulation.rows(start[None])
        return np.hstack(self._simulation.trial(row, 0.25 * h, steps, 4))

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self._shift, _MAX_ESTIMATE, (
            'the drift of the energy has shifted the phase: the path is off '
            f'{_share(self._shift)} its amplitude; {self.remedy}'), '1')


class ForcedPathGuard(StateGuard):
    """
    Path error of runs with forces: it stays below some per cent of the amplitude of the path.

    The balance of energy and work does not show it, since the work is that along the wrong path.
    Trials of 48 steps of h, with the current commands held, or of fewer if they fail, are repeated
    with h / 2: at the first state, whenever the run is 2.5 times as long as at the last trial, and
    where forces or velocities have doubled. A neighbouring motion shows how fast errors decay; see
    PathEstimate. Symplectic methods of order 1 take four times as many.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory, or of several that step together.
    rows : np.ndarray, shape (m, R), optional
        Rows of trajectories with individual commands, kept up to date by the caller.

    """

    each = True
    kind, remedy = PathGuard.kind, PathGuard.remedy

    def __init__(self, simulation: Simulation, rows: np.ndarray | None = None):
        self._simulation, self._estimate = simulation, PathEstimate(simulation)
        self._rows, method = rows, simulation.integrator
        self._displaced = method.order == 1 and method.requirements.symplectic
        self._first, self._next, self._raised = -1, 0, False
        # Largest force and velocity so far.
        self._force = self._speed = 0.0

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        # Random effects draw other numbers at half of the step size; for schemes see PathGuard.
        if run.hamiltonian.scheme is None and not run.conservative and not any(
                effect.random for effect in run.simulation.effects):
            yield cls(run.simulation, run.rows)

    def update(self, sample: Observed) -> Alarm | None:
        if self._raised or not (
                sample.step >= self._next
                or _largest(sample.dH_dq) > _MIN_RATE_RATIO * self._force
                or _largest(sample.dH_dp) > _MIN_RATE_RATIO * self._speed):
            return None
        if self._first < 0:
            self._first = sample.step
        self._force = max(self._force, _largest(sample.dH_dq))
        self._speed = max(self._speed, _largest(sample.dH_dp))
        self._try(sample, _FORCED_STEPS * (_DISPLACED if self._displaced else 1))
        self._raised = not self._estimate.value <= _MAX_ESTIMATE
        return self.renew(sample) if self._raised else None

    def renew(self, sample: Observed) -> Alarm:
        return _estimate_alarm(sample.step, self._estimate.value, self.smaller)

    def _try(self, sample: Observed, n: int) -> None:
        """Run a trial of n steps from the current state."""
        simulation, h, step = self._simulation, self._simulation.path_step, sample.step
        parts = simulation.step_size / h
        rows, elapsed = simulation.row if self._rows is None else self._rows, step - self._first
        self._next = self._first + max(elapsed + n, int(_FORCED_APART * elapsed))
        start = sample.q, sample.p
        try:
            # Later amplitudes count: a run that starts at rest has hardly moved after n steps.
            path = simulation.trial(rows, h, n if elapsed else _FIRST_LOOK * n)[0]
            finer = simulation.trial(rows, 0.5 * h, n, 2)
            sizes = [_ranges(one, part) for one, part in zip(start, finer, strict=True)]
            near = simulation.trial(simulation.neighbour(
                rows, *(_NEIGHBOUR * size for size in sizes)), 0.5 * h, n, 2)
        except (StepFailure, RescuePending):
            # A failing step is reported by the run itself, unless its commands change before.
            if n > 1:
                self._try(sample, n // 2)
            return
        self._speed, self._force = (max(old, 2.0 * _largest(np.diff(part, axis=0)) / h)
                                    for old, part in zip(
                                        (self._speed, self._force), finer, strict=True))
        apart = sum(np.square((one[-1] - other[-1]) / np.where(size > 0.0, size, math.inf)).sum(
            axis=-1, keepdims=True) for one, other, size in zip(near, finer, sizes, strict=True))
        begun = sum((size > 0.0).sum(axis=-1, keepdims=True) for size in sizes)
        kept = np.sqrt(apart / np.maximum(begun, 1)) / _NEIGHBOUR
        errors = np.abs(path[:n] - finer[0]) / (1.0 - 0.5 ** simulation.integrator.order)
        worst = grown = errors.max(axis=0)
        early = n // _MAX_TURNS if self._displaced else 0
        if early:
            # A part is the displacement of the states; see PathGuard. It does not add up, and
            # cannot be told from what does before the motion has turned.
            turned = np.abs(np.diff(finer[0], axis=0)).sum(axis=0) > _MAX_TURNS * np.ptp(
                finer[0], axis=0)
            grown = np.where(turned, worst - errors[:early].max(axis=0), 0.0)
        # A path that diverges has no amplitude; from rest, it grows as the square of the time.
        reach = _FIRST_LOOK ** 2 * sizes[0]
        path = np.clip(path, start[0] - reach, start[0] + reach)
        self._estimate.add(
            step, np.concatenate([start[0][None], path, finer[0]]), worst,
            parts * grown / (n - early), -parts * np.log(np.clip(kept, _NEIGHBOUR, 1.0)) / n,
            (self._next - step) // 2)


def _largest(values: np.ndarray) -> float:
    """Return the largest magnitude; faster than numpy for few values."""
    return max(map(abs, values.ravel().tolist()), default=0.0)


def _ranges(start: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return the range of each column of a path and its start; 0 for a rounding error."""
    ranges = np.maximum(path.max(axis=0), start) - np.minimum(path.min(axis=0), start)
    return np.where(ranges > _MIN_RELATIVE_RANGE * ranges.max(axis=-1, keepdims=True), ranges, 0.0)
