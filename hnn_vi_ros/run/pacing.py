# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pace of a run: how many ticks it owes to the wall clock, and when it cannot pay them."""

from collections.abc import Callable
import time

from hnn_vi_ros.guards.base import Alarm, Guard, Observed

# More debt than this is given up: the run is then slower than asked, but loses no step.
LARGEST_DEBT = 1.0
# One timer call works at most this long: a request may wait for two of them [s].
LONGEST_CALL = 0.01


class Pacer:
    """
    Count the ticks that are due, so that a timer call that came late or never costs none.

    Parameters
    ----------
    tick : float
        Simulated time of one tick [s].
    real_time_factor : float
        Simulated seconds per wall second; 0 for as fast as possible.
    now : callable
        A steady clock [s].

    Attributes
    ----------
    overruns : int
        Times that the debt grew beyond one second of wall time and was given up.

    """

    def __init__(self, tick: float, real_time_factor: float,
                 now: Callable[[], float] = time.monotonic):
        self._tick, self._now = tick, now
        self.overruns = 0
        self.set_pace(real_time_factor)

    def set_pace(self, real_time_factor: float) -> None:
        """Go on from now at another pace; see ``restart``."""
        self._wall_per_tick = self._tick / real_time_factor if real_time_factor > 0.0 else 0.0
        self.restart()

    def restart(self) -> None:
        """Owe nothing as of now: what passed before, as in a pause, is not caught up with."""
        self._origin, self._done = self._now(), 0

    @property
    def timer_period(self) -> float:
        """
        Wall time from one timer call to the next [s].

        Shorter ticks are waited for within the calls, which then follow each other at once.
        """
        return self._wall_per_tick if self._wall_per_tick >= LONGEST_CALL else 1e-4

    @property
    def paced(self) -> bool:
        """Return whether the wall clock sets the pace."""
        return self._wall_per_tick > 0.0

    @property
    def wait(self) -> float:
        """Return the wall time until the next tick is due [s]."""
        return self._origin + (self._done + 1) * self._wall_per_tick - self._now()

    def due(self) -> bool:
        """Return whether one more tick is due; if so, it counts as taken."""
        if self._wall_per_tick:
            owed = (self._now() - self._origin) / self._wall_per_tick - self._done
            if owed < 1.0:
                return False
            if owed * self._wall_per_tick > LARGEST_DEBT + self._wall_per_tick:
                self._origin += (owed - 1.0) * self._wall_per_tick
                self.overruns += 1
        self._done += 1
        return True


class OverrunGuard(Guard):
    """
    The run keeps up with the clock.

    Parameters
    ----------
    pacer : Pacer
        Which counts the overruns.

    """

    kind = 'real-time overrun'
    remedy = ('use a lower real_time_factor or publish_rate, a larger step_size or a '
              'cheaper integrator; results are not affected')

    def __init__(self, pacer: Pacer):
        self._pacer, self._seen = pacer, pacer.overruns

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        overruns = self._pacer.overruns
        if overruns == self._seen:
            return None
        self._seen = overruns
        return Alarm(self.kind, sample.step, float(overruns), 0.0,
                     f'{overruns} overruns: more than {LARGEST_DEBT:g} s behind the clock, which '
                     'is given up; use a lower real_time_factor or publish_rate, a larger '
                     'step_size or a cheaper integrator', '1')

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        return None
