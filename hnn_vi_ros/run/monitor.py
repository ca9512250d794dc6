# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of a run: its timing, its energy, its tolerance, guards."""

from collections.abc import Callable, Iterable
import math
import time

from hnn_vi_ros.accuracy.trials import Tolerance
from hnn_vi_ros.guards.base import Alarm, Guard
from hnn_vi_ros.guards.watch import SampledScale
from hnn_vi_ros.run.energy_record import EnergyRecord
from hnn_vi_ros.run.timing import Timing
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample

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
        By which those measure energies.

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
        self._scale = scale or SampledScale(simulation.hamiltonian)
        self.guards = list(guards)
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

    def watch(self, sample: Sample) -> list[Alarm]:
        """Let the guards look at the next sample, the initial one first; return alarms."""
        alarms = []
        # No comprehension, which costs as much as one of the guards.
        for guard in self.guards:
            alarm = guard.update(sample)
            if alarm is not None:
                alarms.append(alarm)
        return alarms

    @property
    def energy_scale(self) -> float:
        """Return the size of the energies in play as of the newest sample [J]."""
        return math.nan if self.newest is None else self._scale(self.newest)

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
        least = 'at least ' if tolerance.kind == 'path_error' else ''
        return (f'the tolerance is exceeded: {tolerance.kind} {least}{self.energy.largest:.3g}, '
                f'allowed is {tolerance.error:g} up to {tolerance.horizon:g} s; use a smaller '
                'step_size, or ask for a smaller error or a longer horizon')
