# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How many samples a run has, and when they are stamped."""

from types import SimpleNamespace

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.run import Sampler
from messages import refused
import pytest

# What a 32-bit signed number of seconds holds.
LAST = 2**31 * 10**9 - 1


def sampler(step_size: float, rate: float, origin: int = 0, steps: int = 0) -> Sampler:
    return Sampler(SimpleNamespace(initial_energy=1.0, step_size=step_size, steps=steps), rate,
                   origin)


@pytest.mark.parametrize('step_size, rate, origin, steps', [
    (1e5, 1e-3, 0, 0), (1e5, 1e-3, 1, 0), (7.3, 0.02, 0, 0), (0.01, 100.0, LAST - 5 * 10**9, 0),
    (0.1, 10.0, 123, 20 * 10**9), (0.003, 100.0, 2 * 10**18, 40 * 10**9)])
def test_samples_end_with_the_last_that_a_stamp_holds(step_size, rate, origin, steps):
    found = sampler(step_size, rate, origin, steps)
    last = steps + found.count(0.0) * found.every
    # But for what is less than a second beyond the last whole one.
    assert found.stamp_at(last) <= LAST
    assert found.stamp_at(last + found.every) > LAST - 10**9
    assert found.count(1e9) <= found.count(0.0)
    found._simulation.steps = last
    assert 'beyond 2147483647 s' in found.end
    with refused(ParameterError):
        found.count(1.0)


def test_samples_of_a_duration_are_those_of_the_nearest_multiple():
    found = sampler(0.01, 100.0)
    assert [found.count(time) for time in (0.01, 0.0149, 0.0151, 5.0)] == [1, 1, 2, 500]
    with refused(ParameterError):
        found.count(0.004)
    assert found.end == 'the duration is over'
