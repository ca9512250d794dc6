# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps among stamps that come evenly, and none where they do not."""

from hnn_vi_ros.ros.replay.replay_check import Missing, missing_stamps
import numpy as np
import pytest

TICK = 10_000_000
GRID = [TICK * i for i in range(100)]


def test_missing_stamps_are_counted_where_they_are_missing():
    stamps = [stamp for stamp in GRID if not 30 * TICK <= stamp < 50 * TICK and stamp != 70 * TICK]
    assert missing_stamps(stamps[::-1]) == [
        Missing(29 * TICK, 50 * TICK, 20), Missing(69 * TICK, 71 * TICK, 1)]


def test_stamps_that_are_rounded_to_nanoseconds_are_even():
    stamps = [round(i * 10**9 / 3) for i in range(300)]
    assert missing_stamps(stamps) == []
    del stamps[100:110]
    assert [gap.count for gap in missing_stamps(stamps)] == [10]


@pytest.mark.parametrize('stamps', [
    [], [5], [1, 2, 50], sorted([*GRID, 31 * TICK + 7, 31 * TICK + 9]),
    np.cumsum(np.random.default_rng(1).uniform(0.5e9, 3e9, 300)).astype(int).tolist(),
], ids=['none', 'one', 'few', 'single steps in a pause', 'wall time'])
def test_stamps_without_a_grid_or_with_more_have_no_gaps(stamps):
    assert missing_stamps(stamps) == []
