# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of a run: timing, energy record, tolerance and guards."""

from collections.abc import Callable, Iterable
from functools import partial
import math
import time

from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.run.timing import Timing
from hnn_vi_ros.simulation import (
    Alarm, BlockGuard, Guard, judge_block, SampleBuffer, SampledScale, secular_change, Simulation,
    StateGuard, time_scale, Tolerance)
import numpy as np

# A drift is a slope over at least this many blocks, and over this many times in which the state
# changes by its size: about three periods of an oscillation.
_MIN_DRIFT_BLOCKS, _MIN_DRIFT_TIMES = 100, 20.0
_HOUR = 3600.0


class EnergyRecord:
    """
    Record of the energy error, its drift, the band of the modified energy, and the tolerance.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    tick : float
        Simulated time between two samples [s].
    tolerance : Tolerance, optional
        The scene's tolerance, if it has one.

    Attributes
    ----------
    band : float
        Largest abs(H~ - H~0) so far [J]; NaN if no modified energy is known or work is done.
    drift_per_hour : float
        Slope of the energy error at the last evaluation, per hour; NaN until it is known.
    unit : str
        Unit of the energy error: ``'1'``, or that of H if H0 is zero.
    energy_unit : str
        Unit of H.
    tolerance : Tolerance or None
        The scene's tolerance.
    largest : float
        Largest error so far, in the measure of the tolerance; see ``_error``.

    """

    def __init__(self, simulation: Simulation, tick: float, tolerance: Tolerance | None = None):
        self.tolerance, self.largest = tolerance, 0.0
        modified = simulation.modified_energy if simulation.conservative else None
        self._conservative = simulation.conservative
        self._modified0 = math.nan if modified is None else modified
        self.band = math.nan if modified is None else 0.0
        self.drift_per_hour = math.nan
        self.energy_unit = energy_unit(simulation.hamiltonian.coordinates)
        self.unit = '1' if simulation.energy else self.energy_unit
        self._size, self._steepest = abs(simulation.energy) or 1.0, 0.0
        self._tick, self._samples = tick, 0
        self._least = _MIN_DRIFT_TIMES * time_scale(
            simulation.hamiltonian, simulation.q, simulation.p, simulation.time)
        # Lowest and highest error of each block of _length samples, and of the unfinished block.
        self._low: list[float] = []
        self._high: list[float] = []
        self._length, self._open = 1, (math.inf, -math.inf)

    def add(self, sample: Sample) -> bool:
        """Add the next sample; return True if the tolerance is exceeded within its horizon."""
        error = sample.energy_error
        deviation = abs(sample.modified_energy - self._modified0)
        if deviation > self.band:
            self.band = deviation
        low, high = self._open
        self._open = (error if error < low else low, error if error > high else high)
        self._samples += 1
        if self._samples % self._length == 0:
            self._end_block()
        if self.tolerance is None or self._samples * self._tick > self.tolerance.horizon:
            return False
        self.largest = max(self.largest, self._error(sample, self.tolerance))
        return self.largest > self.tolerance.error

    def evaluate(self) -> None:
        """Update the drift."""
        middle = 0.5 * (np.array(self._low) + np.array(self._high))
        run = (middle.size - 1) * self._length * self._tick
        if middle.size >= _MIN_DRIFT_BLOCKS and run >= self._least:
            self.drift_per_hour = secular_change(middle) / run * _HOUR

    def _end_block(self) -> None:
        self._low.append(self._open[0])
        self._high.append(self._open[1])
        self._open = (math.inf, -math.inf)
        if len(self._low) == 2 * _MIN_DRIFT_BLOCKS:
            # Double the block length, so that the memory does not grow.
            self._low = list(map(min, self._low[::2], self._low[1::2]))
            self._high = list(map(max, self._high[::2], self._high[1::2]))
            self._length *= 2

    def _error(self, sample: Sample, tolerance: Tolerance) -> float:
        """
        Return the error of a sample in the measure of the tolerance.

        For energy_error, it is the energy error or the band of the modified energy, whichever is
        larger, relative to the energy scale of the tolerance.
        For path_error, it is a lower bound on the deviation of a coordinate or momentum: the error
        of H over the largest sum of abs(dH_dq) and abs(dH_dp) so far. If work is done, these are
        not derivatives of H; the bound is then unknown, and the error is 0.
        """
        error = abs(sample.energy_error) * self._size
        if tolerance.kind == 'energy_error':
            largest = error if math.isnan(self.band) else max(error, self.band)
            return largest / (tolerance.energy_scale or self._size)
        if not self._conservative:
            return 0.0
        steepness = float(np.abs(sample.dH_dq).sum() + np.abs(sample.dH_dp).sum())
        self._steepest = max(self._steepest, steepness)
        return error / self._steepest if self._steepest else 0.0


# Most samples that guards process together: the cost per sample hardly falls beyond that.
_MAX_GUARDED_SAMPLES = 256
# Wall time between two warnings that the tolerance is exceeded [s].
_WARNING_INTERVAL = 10.0


class Monitor:
    """
    Monitor that measures a run and applies its guards.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    every : int
        Number of steps between two samples.
    tick : float
        Simulated time between two samples [s].
    tolerance : Tolerance, optional
        The scene's tolerance, if it has one.
    warn : callable
        Called when the tolerance is exceeded, and repeatedly while it stays so, with the text and
        with True the first time.
    guards : iterable of Guard, optional
        Conditions that must hold.
    scale : SampledScale, optional
        Energy scale of the guards; without it, energy_scale is NaN.

    Attributes
    ----------
    guards : list of Guard
        Conditions that must hold; more can be appended.
    timing : Timing
        Cost of steps and samples.
    energy : EnergyRecord
        Record of the energy and its errors.
    newest : Sample or None
        The newest sample.

    """

    def __init__(self, simulation: Simulation, every: int, tick: float,
                 tolerance: Tolerance | None, warn: Callable[[str, bool], None],
                 guards: Iterable[Guard] = (), scale: SampledScale | None = None):
        self.timing = Timing(every, tick)
        self.energy = EnergyRecord(simulation, tick, tolerance)
        self.newest: Sample | None = None
        self._scale = scale
        self.guards = list(guards)
        # Samples that the guards have not processed, and alarms that were found in the meantime.
        self._room = partial(SampleBuffer, _MAX_GUARDED_SAMPLES * simulation.q.size)
        self._waiting = self._room()
        self._queued: Sample | None = None
        self._accounted = math.nan
        self._found: list[tuple[Alarm, int]] = []
        # Guards that must be evaluated at each sample.
        self._each: list[StateGuard] = []
        # Range of accounted energies in which a sample may wait.
        self._lowest, self._highest = math.inf, -math.inf
        self._simulation, self._warn = simulation, warn
        self._warned, self._due = False, 0.0

    def advance(self, n: int, most: float = math.inf) -> tuple[int, float]:
        """
        Advance the simulation by n steps, or by fewer if they take longer than `most` [s].

        Returns
        -------
        tuple of (int, float)
            Number of steps taken, and their wall time [s].

        """
        simulation = self._simulation
        gradients, begin = simulation.gradients, time.perf_counter()
        taken = simulation.advance(n, begin + most)
        seconds = time.perf_counter() - begin
        self.timing.add_batch(taken, seconds, simulation.gradients - gradients)
        return taken, seconds

    def watch(self, sample: Sample, at_once: bool = True) -> list[tuple[Alarm, int]]:
        """
        Pass the next sample to the guards, beginning with the initial one.

        Many samples together cost a fraction of the time per sample and give the same alarms. A
        sample therefore waits for others, unless the energy jumps or a guard needs each sample.

        Parameters
        ----------
        sample : Sample
            The next sample.
        at_once : bool, optional
            True to process this sample and all waiting ones now.

        Returns
        -------
        list of (Alarm, int)
            Alarms, each with the step of the sample that raised it.

        """
        self._queue(sample)
        # The negated comparison is also true for NaN.
        if at_once or self._found or self._waiting.full or not (
                self._lowest <= self._accounted <= self._highest):
            return self.look()
        return []

    def _queue(self, sample: Sample) -> None:
        if sample is not self._queued:
            self.newest = self._queued = sample
            self._accounted = self._waiting.add(sample)
            if self._each:
                self._found += _alarms_at(self._each, sample)

    def look(self) -> list[tuple[Alarm, int]]:
        """Apply the guards to all samples so far; return their alarms."""
        found, self._found = self._found, []
        waiting, self._waiting = self._waiting, self._room()
        of_blocks = [guard for guard in self.guards if isinstance(guard, BlockGuard)]
        of_states = [guard for guard in self.guards if isinstance(guard, StateGuard)]
        found += [(alarm, alarm.step) for alarm in judge_block(of_blocks, waiting.block())]
        if waiting and self._queued is not None:
            found += _alarms_at((guard for guard in of_states if not guard.each), self._queued)
        self._each = [guard for guard in of_states if guard.each]
        calm = [guard.calm for guard in of_blocks]
        self._lowest = max((low for low, _ in calm), default=-math.inf)
        self._highest = min((high for _, high in calm), default=math.inf)
        return found

    @property
    def energy_scale(self) -> float:
        """Return the energy scale up to the newest sample [J]; NaN if there is none."""
        if self.newest is not None:
            self._queue(self.newest)
        return math.nan if self._scale is None else self._scale.ahead(self._waiting)

    def add(self, sample: Sample) -> None:
        """Add the next sample to the energy record, and warn if the tolerance is exceeded."""
        self.newest = sample
        if self.energy.add(sample) and time.monotonic() >= self._due:
            self._due = time.monotonic() + _WARNING_INTERVAL
            self._warn(self.over_tolerance(), not self._warned)
            self._warned = True

    def evaluate(self) -> bool:
        """
        Update the figures if they are due; return True if they were.

        Takes half of a tick at 1 kHz, so call it only after a sample's messages are sent.
        """
        evaluated = self.timing.evaluate()
        if evaluated:
            self.energy.evaluate()
        return evaluated

    def over_tolerance(self) -> str:
        """Return a message on the exceeded tolerance, with the remedy."""
        tolerance = self.energy.tolerance
        assert tolerance is not None, 'it is exceeded'
        least = 'at least ' if tolerance.kind == 'path_error' else ''
        return (f'the tolerance is exceeded: {tolerance.kind} {least}{self.energy.largest:.3g}, '
                f'the limit is {tolerance.error:g} up to {tolerance.horizon:g} s; use a smaller '
                'step_size, or request a smaller error or a longer horizon')


def _alarms_at(guards: Iterable[StateGuard], sample: Sample) -> list[tuple[Alarm, int]]:
    found = ((guard.update(sample), sample.step) for guard in guards)
    return [(alarm, step) for alarm, step in found if alarm is not None]
