# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of a run: its timing, the record of its energy, its tolerance, guards."""

from collections.abc import Callable, Iterable
from functools import partial
import math
import time

from hnn_vi_ros.recording import Sample
from hnn_vi_ros.run.timing import Timing
from hnn_vi_ros.simulation import (
    Alarm, BlockGuard, Guard, InitialValueProblem, judge, SampledScale, secular_change, Simulation,
    StateGuard, time_scale, Tolerance, Waiting)
import numpy as np

# A drift is a slope over so many blocks at least, and so many times in which the state changes
# by its size: some three periods of an oscillation.
_BLOCKS, _TIMES = 100, 20.0
_HOUR = 3600.0


class EnergyRecord:
    """
    Follow the energy error, its drift, the band of the modified energy, and a tolerance.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    tick : float
        Simulated time from sample to sample [s].
    tolerance : Tolerance, optional
        The scene's tolerance, if it has one.

    Attributes
    ----------
    band : float
        Largest abs(H~ - H~0) so far [J]; NaN where no modified energy is known or work is done.
    drift_per_hour : float
        Slope of the energy error, as last evaluated [1/h] or [J/h]; NaN until it is known.
    unit : str
        Of the energy error: ``'1'``, or ``'J'`` where H0 is zero.
    tolerance : Tolerance or None
        The scene's tolerance.
    largest : float
        The largest error so far, in the measure of the tolerance; see ``_error``.

    """

    def __init__(self, simulation: Simulation, tick: float, tolerance: Tolerance | None = None):
        self.tolerance, self.largest = tolerance, 0.0
        modified = simulation.modified_energy if simulation.conservative else None
        self._conservative = simulation.conservative
        self._modified0 = math.nan if modified is None else modified
        self.band = math.nan if modified is None else 0.0
        self.drift_per_hour = math.nan
        self.unit = '1' if simulation.energy else 'J'
        self._size, self._steepest = abs(simulation.energy) or 1.0, 0.0
        self._tick, self._samples = tick, 0
        self._least = _TIMES * time_scale(
            InitialValueProblem(simulation.hamiltonian, (), simulation.q, simulation.p))
        # Lowest and highest error of each block of so many samples, and of the one that is open.
        self._low: list[float] = []
        self._high: list[float] = []
        self._length, self._open = 1, (math.inf, -math.inf)

    def add(self, sample: Sample) -> bool:
        """Take the next sample; return whether it is beyond the tolerance, up to its horizon."""
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
        """Renew the drift."""
        middle = 0.5 * (np.array(self._low) + np.array(self._high))
        run = (middle.size - 1) * self._length * self._tick
        if middle.size >= _BLOCKS and run >= self._least:
            self.drift_per_hour = secular_change(middle) / run * _HOUR

    def _end_block(self) -> None:
        self._low.append(self._open[0])
        self._high.append(self._open[1])
        self._open = (math.inf, -math.inf)
        if len(self._low) == 2 * _BLOCKS:
            # Twice as long from now on: the memory does not grow.
            self._low = list(map(min, self._low[::2], self._low[1::2]))
            self._high = list(map(max, self._high[::2], self._high[1::2]))
            self._length *= 2

    def _error(self, sample: Sample, tolerance: Tolerance) -> float:
        """
        Return the error of a sample in the measure of the tolerance.

        With that of the energy the band of the modified energy counts, the larger of the two,
        over the energy scale of the tolerance.
        On the path, a coordinate or momentum deviates by at least what makes up for the error of
        H: that error over the sum of abs(dH_dq) and abs(dH_dp) where H is steepest. Where work is
        done these are no derivatives of H, and no such bound is known.
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


# Samples that guards look at together, at most: more would cost little less for each.
_MOST = 256
# Wall time between two warnings of the same thing [s].
_REPEATED = 10.0


class Monitor:
    """
    Measure a run, and watch it.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    every : int
        Steps from sample to sample.
    tick : float
        Simulated time from sample to sample [s].
    tolerance : Tolerance, optional
        The scene's tolerance, if it has one.
    warn : callable
        Told when the tolerance is exceeded, now and then while it is: the text, and whether it is
        the first time.
    guards : iterable of Guard, optional
        What must hold.
    scale : SampledScale, optional
        By which those measure energies; NaN is told where none does.

    Attributes
    ----------
    guards : list of Guard
        What must hold; more can be appended.
    timing : Timing
        What steps and samples cost.
    energy : EnergyRecord
        Record of the energy.
    newest : Sample or None
        The newest one.

    """

    def __init__(self, simulation: Simulation, every: int, tick: float,
                 tolerance: Tolerance | None, warn: Callable[[str, bool], None],
                 guards: Iterable[Guard] = (), scale: SampledScale | None = None):
        self.timing = Timing(every, tick)
        self.energy = EnergyRecord(simulation, tick, tolerance)
        self.newest: Sample | None = None
        self._scale = scale
        self.guards = list(guards)
        # Samples that the guards have not looked at, and what they have found meanwhile.
        self._room = partial(Waiting, _MOST * simulation.q.size)
        self._waiting = self._room()
        self._queued: Sample | None = None
        self._accounted = math.nan
        self._found: list[tuple[Alarm, int]] = []
        # Those that must be asked at each sample.
        self._each: list[StateGuard] = []
        # Accounted energies between which a sample can wait.
        self._lowest, self._highest = math.inf, -math.inf
        self._simulation, self._warn = simulation, warn
        self._warned, self._due = False, 0.0

    def advance(self, n: int, most: float = math.inf) -> tuple[int, float]:
        """
        Take n steps of the simulation, with its errors, or fewer where they take longer [s].

        Returns
        -------
        tuple of (int, float)
            How many were taken, and the wall time that this took [s].

        """
        simulation = self._simulation
        gradients, begin = simulation.gradients, time.perf_counter()
        taken = simulation.advance(n, begin + most)
        seconds = time.perf_counter() - begin
        self.timing.add_batch(taken, seconds, simulation.gradients - gradients)
        return taken, seconds

    def watch(self, sample: Sample, at_once: bool = True) -> list[tuple[Alarm, int]]:
        """
        Let the guards look at the next sample, the initial one first.

        Looking at many samples together costs a fraction for each, and finds the same. So a
        sample waits for others, unless the energy has jumped or a guard must look at each.

        Parameters
        ----------
        sample : Sample
            The next one.
        at_once : bool, optional
            Whether it, and what waits, is looked at now.

        Returns
        -------
        list of (Alarm, int)
            What was found, and in the sample after how many steps.

        """
        self._queue(sample)
        # Written so that NaN is looked at.
        if at_once or self._found or self._waiting.full or not (
                self._lowest <= self._accounted <= self._highest):
            return self.look()
        return []

    def _queue(self, sample: Sample) -> None:
        if sample is not self._queued:
            self.newest = self._queued = sample
            self._accounted = self._waiting.add(sample)
            if self._each:
                self._found += _ask(self._each, sample)

    def look(self) -> list[tuple[Alarm, int]]:
        """Let the guards look at all samples so far; return what they have found."""
        found, self._found = self._found, []
        waiting, self._waiting = self._waiting, self._room()
        of_blocks = [guard for guard in self.guards if isinstance(guard, BlockGuard)]
        of_states = [guard for guard in self.guards if isinstance(guard, StateGuard)]
        found += [(alarm, alarm.step) for alarm in judge(of_blocks, waiting.block())]
        if waiting and self._queued is not None:
            found += _ask((guard for guard in of_states if not guard.each), self._queued)
        self._each = [guard for guard in of_states if guard.each]
        calm = [guard.calm for guard in of_blocks]
        self._lowest = max((low for low, _ in calm), default=-math.inf)
        self._highest = min((high for _, high in calm), default=math.inf)
        return found

    @property
    def energy_scale(self) -> float:
        """Return the size of the energies in play as of the newest sample, NaN before it [J]."""
        if self.newest is not None:
            self._queue(self.newest)
        return math.nan if self._scale is None else self._scale.ahead(self._waiting)

    def add(self, sample: Sample) -> None:
        """Look at the next sample."""
        self.newest = sample
        if self.energy.add(sample) and time.monotonic() >= self._due:
            self._due = time.monotonic() + _REPEATED
            self._warn(self.over_tolerance(), not self._warned)
            self._warned = True

    def evaluate(self) -> bool:
        """
        Renew the figures if they are due; return whether they were.

        Takes half of a tick at 1 kHz: to be called where nobody waits for a message.
        """
        evaluated = self.timing.evaluate()
        if evaluated:
            self.energy.evaluate()
        return evaluated

    def over_tolerance(self) -> str:
        """Say by how much the tolerance is exceeded, and what to do about it."""
        tolerance = self.energy.tolerance
        assert tolerance is not None, 'it is exceeded'
        least = 'at least ' if tolerance.kind == 'path_error' else ''
        return (f'the tolerance is exceeded: {tolerance.kind} {least}{self.energy.largest:.3g}, '
                f'allowed is {tolerance.error:g} up to {tolerance.horizon:g} s; use a smaller '
                'step_size, or ask for a smaller error or a longer horizon')


def _ask(guards: Iterable[StateGuard], sample: Sample) -> list[tuple[Alarm, int]]:
    found = ((guard.update(sample), sample.step) for guard in guards)
    return [(alarm, step) for alarm, step in found if alarm is not None]
