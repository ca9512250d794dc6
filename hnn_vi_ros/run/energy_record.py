# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Record of the energy of a run so far, in a fixed amount of memory."""

import math

from hnn_vi_ros.accuracy.diagnostics import secular_change
from hnn_vi_ros.accuracy.trials import InitialValueProblem, time_scale, Tolerance
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample
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
        self.largest = max(self.largest, self._error(sample))
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

    def _error(self, sample: Sample) -> float:
        """
        Return the error of a sample in the measure of the tolerance.

        With that of the energy the band of the modified energy counts, the larger of the two,
        over the energy scale of the tolerance.
        On the path, a coordinate or momentum deviates by at least what makes up for the error of
        H: that error over the sum of abs(dH_dq) and abs(dH_dp) where H is steepest. Where work is
        done these are no derivatives of H, and no such bound is known.
        """
        error = abs(sample.energy_error) * self._size
        if self.tolerance.kind == 'energy_error':
            largest = error if math.isnan(self.band) else max(error, self.band)
            return largest / (self.tolerance.energy_scale or self._size)
        if not self._conservative:
            return 0.0
        steepness = float(np.abs(sample.dH_dq).sum() + np.abs(sample.dH_dp).sum())
        self._steepest = max(self._steepest, steepness)
        return error / self._steepest if self._steepest else 0.0
