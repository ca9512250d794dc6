# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Time of steps and samples during a run, and the pace this machine could hold."""

from collections import deque
from collections.abc import Callable
import math
import time
from typing import NamedTuple

import numpy as np

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
