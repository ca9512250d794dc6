# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate of a step's error is that error, and the run does not notice it."""

import math

from hnn_vi_ros.accuracy.diagnostics import local_error
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene.choices import Condition
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.events import EventFunction, WatchedSimulation
import numpy as np
import pytest


def oscillator(method: str, h: float, effects=()) -> Simulation:
    """Return an oscillation of unit amplitude and frequency."""
    return Simulation(HAMILTONIANS['harmonic_oscillator'](), INTEGRATORS[method](), h, [1.0],
                      [0.5], effects)


@pytest.mark.parametrize('method, h', [('generalized_leapfrog', 0.05), ('gauss4', 0.2)])
def test_local_error_is_that_of_a_step(method: str, h: float):
    simulation = oscillator(method, h)
    q, p = simulation.q[0], simulation.p[0]
    estimate = local_error(simulation)
    simulation.advance(1)
    exact = np.array([q * math.cos(h) + p * math.sin(h), p * math.cos(h) - q * math.sin(h)])
    error = np.abs([*simulation.q, *simulation.p] - exact).max()
    # The next term of a symmetric method is h^2 times the first, with coefficients below one.
    assert estimate == pytest.approx(error, rel=2.0 * h ** 2)


def test_local_error_leaves_the_run_bit_identical():
    watched, alone = (oscillator('generalized_leapfrog', 0.05) for _ in range(2))
    for _ in range(20):
        local_error(watched)
        watched.advance(3)
        alone.advance(3)
        assert np.array_equal([*watched.q, *watched.p], [*alone.q, *alone.p])
    assert (watched.steps, watched.gradients, watched.time) == (
        alone.steps, alone.gradients, alone.time)


def test_local_error_finds_no_events_and_does_not_end_the_run():
    alone = oscillator('variational_euler', 0.1)
    stop = EventFunction(Condition('x = 1.04'), stops=True)
    simulation = WatchedSimulation(oscillator('variational_euler', 0.1), [stop])
    assert local_error(simulation) == local_error(alone)
    assert simulation.events == []
    with pytest.raises(StoppedByEvent):
        simulation.advance(1)
    assert local_error(simulation) == local_error(alone)


def test_local_error_of_noise_is_not_a_number():
    bath = EFFECTS['thermostat'](0.1, 1.0)
    assert math.isnan(local_error(oscillator('generalized_leapfrog', 0.05, [bath])))
