# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors of joints: what their readings hold, and what they depend on."""

from hnn_vi_ros.run import JointReading, JointSensor
from hnn_vi_ros.scene import JointSensorChoice
from messages import refused
import numpy as np
import pytest

H, EVERY = 0.001, 10


def true_at(step: int) -> JointReading:
    """Return a cubic motion of two joints, which cubic interpolation follows exactly."""
    t = step * H
    return JointReading(np.array([t**3 - t, 2.0 * t]), np.array([3.0 * t**2 - 1.0, 2.0]),
                        np.array([t, 0.0]))


def readings(first: int = 0, last: int = 1000, **choice) -> dict[int, JointReading]:
    """Return the readings by step of a run with samples every EVERY steps."""
    sensor = JointSensor(JointSensorChoice(**choice), 2, EVERY, H)
    found = {k: sensor.measure(k, true_at(k)) for k in range(first, last + 1, EVERY)}
    return {k: reading for k, reading in found.items() if reading is not None}


def test_sensor_without_errors_gives_the_true_values():
    for k, found in readings().items():
        for own, true in zip(found, true_at(k), strict=True):
            assert (own == true).all()


@pytest.mark.parametrize('delay', [0.003, 0.01, 0.0251])
def test_delayed_reading_is_the_motion_that_long_ago(delay: float):
    for k, found in readings(delay=delay).items():
        past = true_at(max(k - delay / H, 0.0))
        # Round-off of sums of terms of order 1.
        np.testing.assert_allclose(found.position, past.position, atol=1e-15)
        np.testing.assert_allclose(found.velocity, past.velocity, atol=1e-13)


def test_rate_and_losses_leave_readings_out():
    assert set(readings(rate=20.0)) == set(range(0, 1001, 50))
    kept = len(readings(last=100_000, dropout=0.3))
    # Three standard deviations of a binomial count.
    assert abs(kept - 7000) < 3.0 * (10_000 * 0.3 * 0.7)**0.5


def test_noise_bias_and_resolution_are_those_asked_for():
    found = readings(last=100_000, noise=[0.1, 0.0], bias=[0.0, 0.5], velocity_noise=0.2)
    errors = np.array([[found[k].position - true_at(k).position,
                        found[k].velocity - true_at(k).velocity] for k in found])
    # Three standard errors of a standard deviation of n samples, 1 / sqrt(2 n).
    bound = 3.0 / (2.0 * len(found))**0.5
    assert errors[:, 0, 0].std() == pytest.approx(0.1, rel=bound)
    # Round-off of positions up to 200.
    np.testing.assert_allclose(errors[:, 0, 1], 0.5, atol=1e-13)
    np.testing.assert_allclose(errors[:, 1].std(axis=0), 0.2, rtol=bound)
    for k, reading in readings(quantisation=[0.0, 0.01]).items():
        assert abs(reading.position[1] - true_at(k).position[1]) <= 0.005 * (1.0 + 1e-12)
        assert abs(reading.position[1] / 0.01 - round(reading.position[1] / 0.01)) < 1e-12


def test_velocity_of_an_encoder_is_a_difference_of_its_positions():
    found = readings(velocity='encoder', quantisation=0.001, rate=50.0)
    for before, k in zip([*found][:-1], [*found][1:], strict=True):
        np.testing.assert_allclose(
            found[k].velocity, (found[k].position - found[before].position) / 0.02, rtol=1e-12)
    assert all(reading.velocity.size == 0 for reading in readings(velocity='none').values())


def test_readings_depend_on_seed_and_step_alone():
    whole, later = readings(noise=1.0), readings(500, noise=1.0)
    assert all((later[k].position == whole[k].position).all() for k in later)
    assert (readings(noise=1.0, seed=1)[0].position != whole[0].position).all()
    sensor = JointSensor(JointSensorChoice(noise=1.0, delay=0.02), 2, EVERY, H)
    first, again = ([sensor.measure(k, true_at(k)).position for k in range(0, 100, EVERY)]
                    for _ in range(2))
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize(('choice', 'joints'), [
    ({'rate': 30.0}, 2), ({'noise': [0.1]}, 2), ({}, 0)])
def test_sensor_that_does_not_fit_is_refused(choice: dict, joints: int):
    with refused(ValueError):
        JointSensor(JointSensorChoice(**choice), joints, EVERY, H)
