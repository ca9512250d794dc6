# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a simulation, a whole number of steps apart."""

from fractions import Fraction
from functools import cache
import math

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.simulation import Simulation

_MAX_STEPS_PER_SAMPLE = 1e9
# The last second that a ROS time stamp can hold.
_LAST_SECOND = 2**31 - 1


@cache
def nanoseconds_of(step_size: float) -> Fraction:
    """Convert a step size from its decimal form, not its rounded binary one, to nanoseconds."""
    return Fraction(repr(step_size)) * 10**9


def stamp_of(step: int, step_size: float, origin: int = 0) -> int:
    """Return the stamp of a step [ns], from the number of steps and not from a sum of times."""
    return origin + round(step * nanoseconds_of(step_size))


def steps_between(rate: float, step_size: float) -> int:
    """Return the number of steps between samples at a rate [Hz] and a step size [s]."""
    return max(1, round(1.0 / (rate * step_size)))


class Sampler:
    """
    Sampler of a simulation.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    rate : float
        Requested samples per simulated second [Hz].
    origin : int
        Stamp of the initial state [ns].

    Attributes
    ----------
    every : int
        Number of steps between two samples.
    tick : float
        Simulated time between two samples [s].
    deviation : str
        Warning if the step size does not allow the requested rate; else empty.

    Raises
    ------
    ParameterError
        There are too many steps between two samples.

    """

    def __init__(self, simulation: Simulation, rate: float, origin: int = 0):
        self._simulation, self._energy0 = simulation, simulation.initial_energy
        self._origin = origin
        h = simulation.step_size
        # The product underflows to zero for a tiny step.
        exact = 1.0 / (rate * h) if rate * h else math.inf
        if exact > _MAX_STEPS_PER_SAMPLE:
            raise ParameterError(
                f'parameter step_size: {exact:.3g} steps per sample, more than '
                f'{_MAX_STEPS_PER_SAMPLE:.0e}; use a larger step_size or publish_rate')
        self.every = steps_between(rate, h)
        self.tick = self.every * h
        self.deviation = '' if abs(exact - self.every) <= 1e-9 * exact else (
            f'publish_rate {rate:g} Hz is not a whole number of steps of {h:g} s: publishing '
            f'every {self.every} steps, {1.0 / self.tick:g} Hz')

    def count(self, duration: float) -> float:
        """Return the number of samples in a duration [s], limited by stamps; 0 means no end."""
        left = self._left()
        samples = min(round(duration / self.tick), left) if duration else left
        if samples == 0:
            raise ParameterError(f'parameter duration = {duration:g} s: expected at least the '
                                 f'sample interval, {self.tick:g} s, and an end before '
                                 f'{_LAST_SECOND} s')
        return samples

    @property
    def end(self) -> str:
        """Return the reason that no more samples follow the counted ones."""
        return 'the duration is over' if self._left() else (
            f'the next time stamp would be beyond {_LAST_SECOND} s, the latest time in ROS '
            'messages; reset with reset_time, or start again')

    def _left(self) -> int:
        """Return the number of samples that can still be stamped."""
        step = self._simulation.steps
        left = _LAST_SECOND * 10**9 - self._origin
        return max(0, (left // nanoseconds_of(self._simulation.step_size) - step) // self.every)

    @property
    def stamp(self) -> int:
        """Return the stamp of the state [ns]."""
        return self.stamp_at(self._simulation.steps)

    @property
    def time(self) -> float:
        """Return the stamp of the state [s], which is the time for all reports."""
        return self.stamp / 1e9

    def stamp_at(self, step: int) -> int:
        """Return the stamp of a step [ns]."""
        return stamp_of(step, self._simulation.step_size, self._origin)

    def place_of(self, time: float) -> tuple[int, int]:
        """Return the stamp [ns] of a time since step 0 [s], and the step before it."""
        return (self._origin + round(time * 1e9), math.floor(time / self._simulation.step_size))

    def sample(self) -> Sample:
        """Return a sample of the state with its energies."""
        simulation = self._simulation
        (energy, modified), work = simulation.energies, simulation.work
        balance = energy - self._energy0 - work
        return Sample(
            step=simulation.steps, stamp=self.stamp,
            q=simulation.q.copy(), p=simulation.p.copy(),
            dH_dq=simulation.dH_dq.copy(), dH_dp=simulation.dH_dp.copy(), energy=energy,
            modified_energy=math.nan if modified is None else modified,
            energy_error=balance / abs(self._energy0) if self._energy0 else balance,
            work=work, causes=simulation.causes, motors=simulation.motors.forces(
                simulation.time, simulation.q, simulation.p, simulation.dH_dp))
