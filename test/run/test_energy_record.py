# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of the energy of a run is what it did; no tolerance is exceeded unnoticed."""

from dataclasses import replace
import math

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.run import Sampler
from hnn_vi_ros.run.monitor import EnergyRecord
from hnn_vi_ros.simulation import Simulation, Tolerance
import numpy as np
import pytest

TICK = 0.01


def oscillator(method: str = 'variational_euler', h: float = TICK, effects=()) -> Simulation:
    return Simulation(HAMILTONIANS['harmonic_oscillator'](), INTEGRATORS[method](), h, [1.0],
                      [0.0], effects)


def planted(record: EnergyRecord, error, count: int) -> None:
    """Hand samples over whose energy error is a function of time."""
    sample = Sampler(oscillator(), 100.0).sample()
    for n in range(1, count + 1):
        record.add(replace(sample, energy_error=error(n * TICK)))
    record.evaluate()


@pytest.mark.parametrize('count', [2500, 40_000])
def test_drift_is_the_slope_of_the_error_and_not_its_oscillation(count):
    record = EnergyRecord(oscillator(), TICK)
    planted(record, lambda t: 1e-3 * math.sin(2.0 * t) + 1e-6 * t, count)
    # A sine of amplitude A and frequency w leaves at most 12 A / (w T^2) in the slope of a
    # least-squares fit over T; half a block of up to 2 % of the run at its ends leaves as much.
    left = 2.0 * 12.0 * 1e-3 / (2.0 * (count * TICK) ** 2)
    assert record.drift_per_hour == pytest.approx(3600.0 * 1e-6, abs=3600.0 * left)


def test_drift_of_a_line_is_exact_up_to_rounding():
    record = EnergyRecord(oscillator(), TICK)
    planted(record, lambda t: 0.25 - 1e-3 * t, 12_345)
    assert record.drift_per_hour == pytest.approx(-3.6, rel=1e-9)


def test_drift_is_not_told_before_the_motion_has_been_seen():
    record = EnergyRecord(oscillator(), TICK)
    planted(record, lambda t: t, 1999)
    assert math.isnan(record.drift_per_hour)
    planted(record, lambda t: 20.0 + t, 100)
    assert math.isfinite(record.drift_per_hour)


def test_memory_of_a_long_run_does_not_grow():
    record = EnergyRecord(oscillator(), TICK)
    planted(record, math.sin, 100_000)
    assert 100 <= len(record._low) == len(record._high) < 200


def test_band_is_the_largest_deviation_of_the_modified_energy():
    simulation = oscillator(h=0.1)
    sampler, record = Sampler(simulation, 10.0), EnergyRecord(simulation, 0.1)
    energies = []
    for _ in range(100):
        simulation.advance(1)
        record.add(sampler.sample())
        energies.append(simulation.modified_energy)
    # H~ of the start is H, since p is zero there.
    assert record.band == np.abs(np.array(energies) - 0.5).max()


@pytest.mark.parametrize('simulation', [
    oscillator('gauss8'), oscillator(effects=[EFFECTS['damping'](0.1)])],
    ids=['no modified energy', 'not conservative'])
def test_band_is_not_told_where_nothing_is_conserved(simulation):
    record = EnergyRecord(simulation, TICK)
    simulation.advance(1)
    record.add(Sampler(simulation, 100.0).sample())
    assert math.isnan(record.band)


def run(simulation: Simulation, record: EnergyRecord, count: int) -> list[bool]:
    sampler, beyond = Sampler(simulation, 1.0 / simulation.step_size), []
    for _ in range(count):
        simulation.advance(1)
        beyond.append(record.add(sampler.sample()))
    return beyond


def test_tolerance_of_energy_is_exceeded_where_the_error_is_and_only_up_to_the_horizon():
    simulation = oscillator()
    # H oscillates by h / 2 relative to H0: 5e-3, passed after an eighth of a turn.
    record = EnergyRecord(simulation, TICK, Tolerance('energy_error', 2.5e-3, 2.0))
    beyond = run(simulation, record, 300)
    first = beyond.index(True) * TICK
    # sin(2 t) = 1 / 2 up to the next step.
    assert first == pytest.approx(math.pi / 12.0, abs=2.0 * TICK)
    assert all(beyond[beyond.index(True):200]) and not any(beyond[200:])
    assert record.largest == pytest.approx(5e-3, rel=0.02)


def test_tolerance_of_energy_that_is_held_is_not_exceeded():
    simulation = oscillator()
    assert not any(run(
        simulation, EnergyRecord(simulation, TICK, Tolerance('energy_error', 6e-3, 100.0)), 1000))


def test_tolerance_of_the_path_counts_no_more_than_the_path_errs():
    simulation = Simulation(HAMILTONIANS['pendulum'](), INTEGRATORS['variational_euler'](), 0.02,
                            [2.0], [0.0])
    exact = Simulation(HAMILTONIANS['pendulum'](), INTEGRATORS['gauss12'](), 0.02, [2.0], [0.0])
    record = EnergyRecord(simulation, 0.02, Tolerance('path_error', 1.0, 1e3))
    sampler, worst = Sampler(simulation, 50.0), 0.0
    for _ in range(500):
        simulation.advance(1)
        exact.advance(1)
        worst = max(worst, abs(simulation.q - exact.q).max(), abs(simulation.p - exact.p).max())
        record.add(sampler.sample())
        assert record.largest <= worst
    # It is of use: within a factor of a hundred of the path's error.
    assert record.largest > 0.01 * worst


def test_tolerance_of_the_path_is_left_alone_where_work_is_done():
    simulation = oscillator(effects=[EFFECTS['damping'](0.1)])
    record = EnergyRecord(simulation, TICK, Tolerance('path_error', 1e-12, 100.0))
    assert not any(run(simulation, record, 100))
