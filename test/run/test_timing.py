# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of the cost of steps and samples is what was measured."""

import math

from hnn_vi_ros.run.timing import quantiles, Timing, WINDOW
from hypothesis import given, strategies
import numpy as np
import pytest

BATCHES = strategies.lists(
    strategies.tuples(strategies.integers(1, 50), strategies.floats(1e-9, 1.0)), min_size=1,
    max_size=100)


class Clock:
    """A clock that is put forward by hand."""

    def __init__(self):
        self.time = 0.0

    def __call__(self) -> float:
        return self.time


@given(BATCHES, strategies.floats(0.01, 1.0))
def test_quantile_of_batches_is_that_of_their_steps(batches, share):
    weights, values = (np.array(column) for column in zip(*batches, strict=True))
    found, = quantiles(values, weights, (share,))
    steps = np.sort(np.repeat(values, weights))
    assert found in values
    # Up to a step, which rounding of the share may add or take away.
    place = share * steps.size
    assert steps[max(math.ceil(place - 1e-6) - 1, 0)] == found


def test_figures_are_weighted_by_steps_and_count_what_a_sample_costs():
    clock = Clock()
    timing = Timing(every=100, tick=0.1, now=clock)
    assert not timing.evaluate() and math.isnan(timing.figures.largest_real_time_factor)
    # One step in a hundred takes long: the median must not see it, the 99 % just not.
    timing.add_batch(99, 99 * 2e-6, 99 * 3)
    timing.add_batch(1, 500e-6, 43)
    timing.add_sample(300e-6)
    assert timing.evaluate()
    figures = timing.figures
    assert figures.microseconds_per_step_median == pytest.approx(2.0)
    assert figures.microseconds_per_step_p99 == pytest.approx(2.0)
    assert figures.gradients_per_step == pytest.approx((99 * 3 + 43) / 100)
    assert figures.microseconds_per_sample == pytest.approx(300.0)
    # 100 steps of 2 us and a sample of 300 us take 500 us for 0.1 s.
    assert figures.largest_real_time_factor == pytest.approx(0.1 / 500e-6)
    timing.add_batch(2, 2 * 500e-6, 6)
    clock.time = 1.0
    assert timing.evaluate()
    assert timing.figures.microseconds_per_step_p99 == pytest.approx(500.0)


def test_pace_is_simulated_over_wall_time_between_two_evaluations():
    clock = Clock()
    timing = Timing(every=1, tick=0.01, now=clock)
    timing.add_batch(1, 1e-6, 1)
    assert timing.evaluate() and math.isnan(timing.figures.real_time_factor)
    for _ in range(50):
        timing.add_sample(1e-6)
    clock.time = 0.1
    # Too soon: the figures are evaluated a few times a second, not with every sample.
    assert not timing.evaluate()
    clock.time = 0.25
    assert timing.evaluate()
    assert timing.figures.real_time_factor == pytest.approx(0.5 / 0.25)


def test_pace_counts_neither_a_pause_nor_what_lies_before_the_first_step():
    clock = Clock()
    timing = Timing(every=1, tick=0.01, now=clock)
    timing.add_batch(1, 1e-6, 1)
    for begin in (10.0, 30.0):
        # Configuration, then a pause, of 10 s and more.
        clock.time = begin
        timing.restart()
        assert timing.evaluate() and math.isnan(timing.figures.real_time_factor)
        for _ in range(50):
            timing.add_sample(1e-6)
        clock.time = begin + 0.25
        assert timing.evaluate()
        assert timing.figures.real_time_factor == pytest.approx(2.0)


def test_figures_forget_what_lies_before_the_window():
    timing = Timing(every=1, tick=0.01, now=Clock())
    for _ in range(WINDOW):
        timing.add_batch(1, 1.0, 100)
    for _ in range(WINDOW):
        timing.add_batch(1, 1e-6, 2)
    timing.evaluate()
    assert timing.figures.microseconds_per_step_p99 == pytest.approx(1.0)
    assert timing.figures.gradients_per_step == 2.0
