# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Timing of a run against the wall clock: its pace, the cost of steps, and a status line."""

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

# Largest backlog; more is dropped, so that the run is slower than requested but loses no step [s].
# An external clock may run ten times as fast, so that a short stall causes a larger backlog.
LARGEST_DEBT, LARGEST_DEBT_TO_OTHERS = 1.0, 10.0
# Maximum duration of a timer call; a request may wait for two of them [s].
LONGEST_CALL = 0.01
# After a stall, ticks are spaced by this share of their time: subscribers see a faster pace for a
# while and no burst. Shorter ticks than this cannot be slept for [s].
_CATCH_UP_SPACING, _MIN_SLEEP = 0.75, 5e-4
# Number of advances of an external clock from which the median is taken.
_MEDIAN_SIZE = 100
# Tolerance on round-off [ticks]: a clock that is set in steps of a tick is due at each tick.
_TICK_TOLERANCE = 1e-6


class Pacer:
    """
    Counter of the ticks that are due, so that late or skipped timer calls lose no tick.

    Parameters
    ----------
    tick : float
        Simulated time of one tick [s].
    real_time_factor : float
        Simulated seconds per second of the clock; 0 for as fast as possible.
    now : callable
        A steady clock [s], or an external one such as ``/clock``.
    led : callable
        Returns True while the clock is external.

    Attributes
    ----------
    asked : float
        Requested real-time factor; 0 for as fast as possible.
    overruns : int
        Number of times that the backlog exceeded ``largest_debt`` and was dropped.

    """

    def __init__(self, tick: float, real_time_factor: float,
                 now: Callable[[], float] = time.monotonic, led: Callable[[], bool] = bool):
        self._tick, self._now, self._led = tick, now, led
        self.overruns = 0
        self.set_pace(real_time_factor)

    def set_pace(self, real_time_factor: float) -> None:
        """Change the pace from now on; see ``restart``."""
        self.asked = real_time_factor
        self._wall_per_tick = self._tick / real_time_factor if real_time_factor > 0.0 else 0.0
        self.restart()

    def restart(self) -> None:
        """Discard the backlog: time that has passed, as in a pause, is not caught up on."""
        self._origin, self._done = self._now(), 0
        self._newest, self._earliest = self._origin, -math.inf
        self._advances: deque[float] = deque(maxlen=_MEDIAN_SIZE)

    @property
    def timer_period(self) -> float:
        """
        Return the wall time between two timer calls [s].

        Shorter ticks are waited for within a call; calls then follow each other at once. An
        external clock triggers a call with each message, the timer one if steps are left then.
        """
        if self.led:
            return LONGEST_CALL
        return self._wall_per_tick if self._wall_per_tick >= LONGEST_CALL else 1e-4

    @property
    def led(self) -> bool:
        """Return True while an external clock is followed."""
        return self._led()

    @property
    def burst(self) -> float:
        """Return the median number of ticks per advance of the external clock."""
        return float(np.median(self._advances)) / self._wall_per_tick if self._advances else 0.0

    @property
    def largest_debt(self) -> float:
        """Return the backlog beyond which it is dropped [s]."""
        return LARGEST_DEBT_TO_OTHERS if self.led else LARGEST_DEBT

    @property
    def wait(self) -> float:
        """Return the wall time until the next tick is due [s]; inf with an external clock."""
        if self.led:
            return math.inf
        due = self._origin + (self._done + 1) * self._wall_per_tick
        return max(due, self._earliest) - self._now()

    def due(self) -> bool:
        """Return True if another tick is due, which then counts as taken."""
        if self._wall_per_tick:
            now = self._now()
            if now < self._newest:
                # Only an external clock can go back; simulated time continues.
                self.restart()
            if self.led and now > self._newest:
                self._advances.append(now - self._newest)
            self._newest = now
            owed = (now - self._origin) / self._wall_per_tick - self._done
            if owed < 1.0 - _TICK_TOLERANCE or now < self._earliest:
                return False
            if owed * self._wall_per_tick > self.largest_debt + self._wall_per_tick:
                self._origin += (owed - 1.0) * self._wall_per_tick
                self.overruns += 1
            if _MIN_SLEEP <= self._wall_per_tick < LONGEST_CALL and not self.led:
                # A call takes only one of the longer ticks; an external clock is followed at once.
                self._earliest = now + _CATCH_UP_SPACING * self._wall_per_tick
        self._done += 1
        return True


class OverrunGuard(StateGuard):
    """
    A guard that raises an alarm when the run falls behind the clock.

    Parameters
    ----------
    pacer : Pacer
        Counter of the overruns.
    slow_disk : callable, optional
        Function that describes a slow disk of the recording, '' if it is not slow.

    """

    kind = 'real-time overrun'
    remedy = ('use a lower real_time_factor or publish_rate, a larger step_size or a cheaper '
              'integrator; a /clock that is used needs one publisher and no jumps; results are '
              'not affected')

    def __init__(self, pacer: Pacer, slow_disk: Callable[[], str] = str):
        self._pacer, self._seen, self._slow_disk = pacer, pacer.overruns, slow_disk

    def update(self, sample: Observed) -> Alarm | None:
        overruns = self._pacer.overruns
        if overruns == self._seen:
            return None
        self._seen = overruns
        cause = ('/clock jumped, for example because of two publishers, or is faster than this '
                 'machine'
                 if self._pacer.led else 'use a lower real_time_factor or publish_rate, a larger '
                 'step_size or a cheaper integrator')
        if slow := self._slow_disk():
            cause = f'{slow}: record to another one'
        return Alarm(self.kind, sample.step, float(overruns), 0.0,
                     f'{overruns} overruns: fell more than {self._pacer.largest_debt:g} s behind '
                     f'the clock; the lost time is skipped; {cause}', '1')

    def renew(self, sample: Observed) -> Alarm | None:
        return None


# Number of batches of steps, and of samples, in the statistics.
WINDOW = 512
# Wall time between two evaluations of the figures [s].
_EVALUATION_INTERVAL = 0.25


class TimingFigures(NamedTuple):
    """
    Recent measurements; NaN before the first one.

    Parameters
    ----------
    microseconds_per_step_median, microseconds_per_step_p99 : float
        Median and 99 % quantile of the wall time of a step [us].
    gradients_per_step : float
        Mean number of gradients and Hessian-vector products in a step.
    microseconds_per_sample : float
        Mean wall time of publishing, recording and displaying a sample [us].
    largest_real_time_factor : float
        Simulated seconds per wall second that this machine can sustain at the current cost of
        steps and samples, which often falls at a faster pace.
    real_time_factor : float
        Simulated seconds per wall second since the previous evaluation.

    """

    microseconds_per_step_median: float = math.nan
    microseconds_per_step_p99: float = math.nan
    gradients_per_step: float = math.nan
    microseconds_per_sample: float = math.nan
    largest_real_time_factor: float = math.nan
    real_time_factor: float = math.nan


class Timing:
    """
    Statistics of the cost of steps and samples over a sliding window.

    Parameters
    ----------
    every : int
        Number of steps between two samples.
    tick : float
        Simulated time between two samples [s].
    now : callable
        A steady clock [s].

    Attributes
    ----------
    figures : Figures
        Result of the last evaluation.

    """

    def __init__(self, every: int, tick: float, now: Callable[[], float] = time.monotonic):
        self._every, self._tick, self._now = every, tick, now
        self._batches: deque[tuple[int, float, int]] = deque(maxlen=WINDOW)
        self._samples: deque[float] = deque(maxlen=WINDOW)
        self._count, self._last = 0, (math.nan, 0)
        self._due = -math.inf
        self.figures = TimingFigures()

    def restart(self) -> None:
        """Measure the pace from now on, excluding earlier time such as a pause."""
        self._last = self._now(), self._count

    def add_batch(self, steps: int, seconds: float, gradients: int) -> None:
        """Record the number of steps, the wall time [s] and the number of gradients of a batch."""
        self._batches.append((steps, seconds, gradients))

    def add_sample(self, seconds: float) -> None:
        """Record the time of publishing, recording and displaying a sample [s]."""
        self._samples.append(seconds)
        self._count += 1

    def evaluate(self) -> bool:
        """Update the figures if they are due; return True if they were."""
        now = self._now()
        if now < self._due or not self._batches:
            return False
        self._due = now + _EVALUATION_INTERVAL
        then, count = self._last
        self._last = now, self._count
        pace = math.nan
        if now > then and self._count > count:
            pace = (self._count - count) * self._tick / (now - then)
        steps, seconds, gradients = np.array(self._batches).T
        median, p99 = quantiles(seconds / steps, steps, (0.5, 0.99))
        sample = sum(self._samples) / len(self._samples) if self._samples else math.nan
        self.figures = TimingFigures(
            1e6 * median, 1e6 * p99, float(gradients.sum() / steps.sum()), 1e6 * sample,
            self._tick / (self._every * median + sample), pace)
        return True


def quantiles(values: np.ndarray, weights: np.ndarray, shares: tuple[float, ...]) -> list[float]:
    """
    Return the weighted quantiles: smallest values not exceeded by these shares of the weight.

    Parameters
    ----------
    values, weights : np.ndarray, shape (n,)
        Mean of each batch over its steps, and number of steps.
    shares : tuple of float
        Shares from 0 to 1.

    """
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    # A share is rounded: less than a whole step must not select the next value.
    places = np.searchsorted(below, np.array(shares) * below[-1] - 1e-6)
    return values[order[np.minimum(places, values.size - 1)]].tolist()


class StatusLine:
    """
    Line with time, energy and pace, rewritten in place on a terminal and else logged regularly.

    Parameters
    ----------
    log : callable
        Logs the lines if standard output is not a terminal.
    now : callable
        A steady clock [s].

    """

    def __init__(self, log: Callable[[str], object], unit: str,
                 now: Callable[[], float] = time.monotonic):
        self._log, self._unit, self._now = log, unit, now
        self._terminal = sys.stdout.isatty()
        self._interval = 0.2 if self._terminal else 5.0
        self._shown = False
        self.restart(0)

    def restart(self, stamp: int) -> None:
        """Measure the pace from now and from this stamp [ns], as after a pause or a reset."""
        now = self._now()
        self._last, self._next = (now, stamp), now + self._interval

    def show(self, sample: Sample, overruns: int, relative: bool) -> None:
        """Display a sample if the line is due; its energy error is relative to H0, or not."""
        now = self._now()
        if now < self._next:
            return
        wall, stamp = self._last
        pace = (sample.stamp - stamp) * 1e-9 / (now - wall)
        self._last, self._next = (now, sample.stamp), now + self._interval
        error = f'energy error {sample.energy_error:+.2e}'
        text = (f't = {sample.stamp * 1e-9:.2f} s   H = {sample.energy:.6g} {self._unit}   '
                + (f'relative {error}' if relative else f'{error} {self._unit}')
                + f'   {pace:.2f} x real time'
                + (f'   {overruns} overruns' if overruns else ''))
        if self._terminal:
            rewrite_line(sys.stdout, text)
            self._shown = True
        else:
            self._log(text)

    def close(self) -> None:
        """End the line on the terminal, so that later output begins a new line."""
        if self._shown:
            self._shown = False
            sys.stdout.write('\n')
            sys.stdout.flush()
