# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A run against the wall clock: its pace, the time of its steps, and a line that shows both."""

from collections import deque
from collections.abc import Callable
import math
import sys
import time
from typing import NamedTuple

from hnn_vi_ros.files import rewrite_line
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.simulation import Alarm, Observed, StateGuard
import numpy as np

# More debt than this is given up: the run is then slower than asked, but loses no step [s]. A
# clock that others set may be ten times as fast, so that a short stall makes more of it.
LARGEST_DEBT, LARGEST_DEBT_TO_OTHERS = 1.0, 10.0
# One timer call works at most this long: a request may wait for two of them [s].
LONGEST_CALL = 0.01
# What a stall held up is caught up with by ticks that are this share of their time apart: those
# who listen hear a faster pace for a while, and no burst. Shorter ticks [s] cannot be slept for.
_APART, _SHORTEST = 0.75, 5e-4
# Advances of a clock of others, of which the median is taken.
_ADVANCES = 100
# A clock that is set in steps of a tick is due at the tick, however its sums are rounded.
_ROUNDING = 1e-6


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
        A steady clock [s], or one that others set: that of ``/clock``.
    led : callable
        Whether others set it now.

    Attributes
    ----------
    asked : float
        The real-time factor that is asked for; 0 for as fast as possible.
    overruns : int
        Times that the debt grew beyond ``largest_debt`` and was given up.

    """

    def __init__(self, tick: float, real_time_factor: float,
                 now: Callable[[], float] = time.monotonic, led: Callable[[], bool] = bool):
        self._tick, self._now, self._led = tick, now, led
        self.overruns = 0
        self.set_pace(real_time_factor)

    def set_pace(self, real_time_factor: float) -> None:
        """Go on from now at another pace; see ``restart``."""
        self.asked = real_time_factor
        self._wall_per_tick = self._tick / real_time_factor if real_time_factor > 0.0 else 0.0
        self.restart()

    def restart(self) -> None:
        """Owe nothing as of now: what passed before, as in a pause, is not caught up with."""
        self._origin, self._done = self._now(), 0
        self._newest, self._earliest = self._origin, -math.inf
        self._advances: deque[float] = deque(maxlen=_ADVANCES)

    @property
    def timer_period(self) -> float:
        """
        Wall time from one timer call to the next [s].

        Shorter ticks are waited for within the calls, which then follow each other at once. Who
        is led is called for each message of the clock, and by the timer if steps are left then.
        """
        if self.led:
            return LONGEST_CALL
        return self._wall_per_tick if self._wall_per_tick >= LONGEST_CALL else 1e-4

    @property
    def led(self) -> bool:
        """Return whether a clock that others set is followed."""
        return self._led()

    @property
    def burst(self) -> float:
        """Return how many ticks the clock of others advances at a time, in the median."""
        return float(np.median(self._advances)) / self._wall_per_tick if self._advances else 0.0

    @property
    def largest_debt(self) -> float:
        """Return the debt beyond which it is given up [s]."""
        return LARGEST_DEBT_TO_OTHERS if self.led else LARGEST_DEBT

    @property
    def wait(self) -> float:
        """Return the wall time until the next tick is due [s]; endless if others decide that."""
        if self.led:
            return math.inf
        due = self._origin + (self._done + 1) * self._wall_per_tick
        return max(due, self._earliest) - self._now()

    def due(self) -> bool:
        """Return whether one more tick is due; if so, it counts as taken."""
        if self._wall_per_tick:
            now = self._now()
            if now < self._newest:
                # Only a clock that others set goes back: simulated time does not.
                self.restart()
            if self.led and now > self._newest:
                self._advances.append(now - self._newest)
            self._newest = now
            owed = (now - self._origin) / self._wall_per_tick - self._done
            if owed < 1.0 - _ROUNDING or now < self._earliest:
                return False
            if owed * self._wall_per_tick > self.largest_debt + self._wall_per_tick:
                self._origin += (owed - 1.0) * self._wall_per_tick
                self.overruns += 1
            if _SHORTEST <= self._wall_per_tick < LONGEST_CALL and not self.led:
                # One call takes one longer tick, and who is led follows at once.
                self._earliest = now + _APART * self._wall_per_tick
        self._done += 1
        return True


class OverrunGuard(StateGuard):
    """
    The run keeps up with the clock.

    Parameters
    ----------
    pacer : Pacer
        Which counts the overruns.

    """

    kind = 'real-time overrun'
    remedy = ('use a lower real_time_factor or publish_rate, a larger step_size or a '
              'cheaper integrator; let /clock, where it is followed, have one publisher and no '
              'jumps; results are not affected')

    def __init__(self, pacer: Pacer):
        self._pacer, self._seen = pacer, pacer.overruns

    def update(self, sample: Observed) -> Alarm | None:
        overruns = self._pacer.overruns
        if overruns == self._seen:
            return None
        self._seen = overruns
        cause = ('/clock has jumped, as with two publishers, or is faster than this machine'
                 if self._pacer.led else 'use a lower real_time_factor or publish_rate, a larger '
                 'step_size or a cheaper integrator')
        return Alarm(self.kind, sample.step, float(overruns), 0.0,
                     f'{overruns} overruns: more than {self._pacer.largest_debt:g} s behind the '
                     f'clock, which is given up; {cause}', '1')

    def renew(self, sample: Observed) -> Alarm | None:
        return None


# Batches of steps, and samples, that the figures are taken over.
WINDOW = 512
# Wall time between two evaluations of the figures [s].
_PERIOD = 0.25


class Figures(NamedTuple):
    """
    Figures measured lately; NaN where nothing was yet.

    Parameters
    ----------
    microseconds_per_step_median, microseconds_per_step_p99 : float
        Wall time of a step [us]: half and 99 % of the steps take no longer.
    gradients_per_step : float
        Gradients and Hessian-vector products in a step, on average.
    microseconds_per_sample : float
        Wall time that publishing, recording and showing a sample takes on average [us].
    largest_real_time_factor : float
        Simulated seconds per wall second that this machine could hold, steps and samples costing
        what they do; at a faster pace they often cost less.
    real_time_factor : float
        Simulated seconds per wall second since the evaluation before.

    """

    microseconds_per_step_median: float = math.nan
    microseconds_per_step_p99: float = math.nan
    gradients_per_step: float = math.nan
    microseconds_per_sample: float = math.nan
    largest_real_time_factor: float = math.nan
    real_time_factor: float = math.nan


class Timing:
    """
    Measure steps and samples over a sliding window.

    Parameters
    ----------
    every : int
        Steps from sample to sample.
    tick : float
        Simulated time from sample to sample [s].
    now : callable
        A steady clock [s].

    Attributes
    ----------
    figures : Figures
        As last evaluated.

    """

    def __init__(self, every: int, tick: float, now: Callable[[], float] = time.monotonic):
        self._every, self._tick, self._now = every, tick, now
        self._batches: deque[tuple[int, float, int]] = deque(maxlen=WINDOW)
        self._samples: deque[float] = deque(maxlen=WINDOW)
        self._count, self._last = 0, (math.nan, 0)
        self._due = -math.inf
        self.figures = Figures()

    def restart(self) -> None:
        """Measure the pace from now on: what passed before, as in a pause, does not count."""
        self._last = self._now(), self._count

    def add_batch(self, steps: int, seconds: float, gradients: int) -> None:
        """Note how long a batch of steps took, and how many gradients."""
        self._batches.append((steps, seconds, gradients))

    def add_sample(self, seconds: float) -> None:
        """Note how long it took to publish, record and show a sample."""
        self._samples.append(seconds)
        self._count += 1

    def evaluate(self) -> bool:
        """Renew the figures between two samples, if it is time to; return whether it was."""
        now = self._now()
        if now < self._due or not self._batches:
            return False
        self._due = now + _PERIOD
        then, count = self._last
        self._last = now, self._count
        pace = math.nan
        if now > then and self._count > count:
            pace = (self._count - count) * self._tick / (now - then)
        steps, seconds, gradients = np.array(self._batches).T
        median, p99 = quantiles(seconds / steps, steps, (0.5, 0.99))
        sample = sum(self._samples) / len(self._samples) if self._samples else math.nan
        self.figures = Figures(
            1e6 * median, 1e6 * p99, float(gradients.sum() / steps.sum()), 1e6 * sample,
            self._tick / (self._every * median + sample), pace)
        return True


def quantiles(values: np.ndarray, weights: np.ndarray, shares: tuple[float, ...]) -> list[float]:
    """
    Return the smallest values that are not exceeded by these shares of the weight.

    Parameters
    ----------
    values, weights : np.ndarray, shape (n,)
        One batch each: the mean over its steps, and their number.
    shares : tuple of float
        From 0 to 1.

    """
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    # A share of a sum is rounded: less than a whole step is no reason to take the next value.
    places = np.searchsorted(below, np.array(shares) * below[-1] - 1e-6)
    return values[order[np.minimum(places, values.size - 1)]].tolist()


class StatusLine:
    """
    Show time, energy and pace: rewritten in place on a terminal, else logged now and then.

    Parameters
    ----------
    log : callable
        Takes the lines when standard output is no terminal.
    now : callable
        A steady clock [s].

    """

    def __init__(self, log: Callable[[str], object], now: Callable[[], float] = time.monotonic):
        self._log, self._now = log, now
        self._terminal = sys.stdout.isatty()
        self._interval = 0.2 if self._terminal else 5.0
        self._shown = False
        self.restart(0)

    def restart(self, stamp: int) -> None:
        """Measure the pace from now and this stamp on [ns]: a pause or a reset has no pace."""
        now = self._now()
        self._last, self._next = (now, stamp), now + self._interval

    def show(self, sample: Sample, overruns: int) -> None:
        """Show a sample, if it is time to."""
        now = self._now()
        if now < self._next:
            return
        wall, stamp = self._last
        pace = (sample.stamp - stamp) * 1e-9 / (now - wall)
        self._last, self._next = (now, sample.stamp), now + self._interval
        text = (f't = {sample.stamp * 1e-9:.2f} s   H = {sample.energy:.6g} J   '
                f'energy error {sample.energy_error:+.2e}   {pace:.2f} x real time'
                + (f'   {overruns} overruns' if overruns else ''))
        if self._terminal:
            rewrite_line(sys.stdout, text)
            self._shown = True
        else:
            self._log(text)

    def close(self) -> None:
        """Leave the line on the terminal: what is printed next begins a line of its own."""
        if self._shown:
            self._shown = False
            sys.stdout.write('\n')
            sys.stdout.flush()
