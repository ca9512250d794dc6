# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that a sensor got wrong are found, and no others."""

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.faults import faults
from messages import refused
import numpy as np
import pytest
from scipy.special import ellipj, ellipk

RATES = 20, 100, 500  # [Hz], of a motion of 0.5 Hz


def swing(rate: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and an undamped pendulum of amplitude 1 rad, with white noise."""
    t = np.arange(20 * rate) / rate
    k = np.sin(0.5)
    q = 2.0 * np.arcsin(k * ellipj(3.3 * t + ellipk(k**2), k**2)[0])
    return t, q + noise * np.random.default_rng(0).normal(size=len(t))


def found(t: np.ndarray, q: np.ndarray, v: np.ndarray | None = None) -> np.ndarray:
    return faults(t, q[:, None], None if v is None else v[:, None], ['coordinate 1'] * 2, 'log')[0]


@pytest.mark.parametrize('noise', [0.0, 5e-3, 0.05])
@pytest.mark.parametrize('rate', RATES)
def test_right_samples_are_no_faults(rate, noise):
    (t, q), (_, still) = swing(rate, noise), swing(rate, 0.0)
    rest = np.where(t < 8.0, still[8 * rate], still) + (q - still)  # held for long, then released
    close = 1.0 / (1.0 + (0.7 * rate * np.sin(t))**2)  # peaks as of close passages of a planet
    for x in (q, np.round(q, 2), rest, np.abs(q), np.angle(np.exp(5j * q)), close):
        assert not found(t, x).any()


@pytest.mark.parametrize('rate', RATES)
@pytest.mark.parametrize('value', [-17.4, 0.0, 3.0])
def test_values_that_stand_for_none_are_faults(rate, value):
    t, q = swing(rate, 5e-3)
    wrong = np.random.default_rng(1).random(len(t)) < 0.05
    far = wrong & (np.abs(q - value) > 0.5)
    mask = found(t, np.where(wrong, value, q))
    # Right samples among more than three wrong ones of seven are lost: 35 0.05^4 of them.
    assert mask[far].all() and mask[~wrong].mean() < 1e-3


@pytest.mark.parametrize('rate', RATES)
def test_stuck_sensor_is_found_and_slow_one_is_read_once_for_each_value(rate):
    t, q = swing(rate, 5e-3)
    stuck = (t > 5.0) & (t < 5.4)
    assert np.array_equal(found(t, np.where(stuck, q[5 * rate], q)), stuck)
    held = np.repeat(q[:len(q) // 5], 5)
    assert found(t[:len(held)], held).sum() == 4 * len(held) // 5


@pytest.mark.parametrize('rate', RATES)
def test_servo_that_sticks_is_no_stuck_sensor(rate):
    t, q = swing(rate, 5e-3)
    stuck = (t > 5.9) & (t < 6.3)
    first, *_, last = np.flatnonzero(stuck)
    # It goes on from where it stuck.
    x = np.where(stuck, q[first], np.where(t < 6.1, q, q + q[first] - q[last]))
    assert found(t, x)[stuck].any()
    assert not faults(t, x[:, None], None, ['coordinate 1'], 'log', True)[0].any()


def clamped(rate: int, nudge: float) -> np.ndarray:
    """Return a joint that stands still but for a nudge, and for a count now and then."""
    t = np.arange(20 * rate) / rate
    moved = nudge * np.sin(np.pi * (t - 5.0)) * ((t > 5.0) & (t < 6.0))
    return -0.453 + moved + 1e-3 * (np.arange(len(t)) % (2 * rate) == rate)


@pytest.mark.parametrize('nudge', [0.0, 0.05])
@pytest.mark.parametrize('rate', RATES)
def test_clamped_joint_is_no_stuck_sensor(rate, nudge):
    x = clamped(rate, nudge)
    assert not found(np.arange(len(x)) / rate, x).any()


def test_joint_whose_velocity_is_none_is_no_stuck_sensor():
    t, q = swing(100, 5e-3)
    stuck = (t > 5.9) & (t < 6.3)
    first, *_, last = np.flatnonzero(stuck)
    x = np.where(stuck, q[first], np.where(t < 6.1, q, q + q[first] - q[last]))
    for rate in (2.0, 0.0):
        v = np.where(stuck, rate, np.gradient(x, t))
        assert found(t, x, v).any() == (rate > 0.0)


def test_many_faults_and_jumps_that_stay_are_refused():
    t, q = swing(100, 5e-3)
    with refused(DataError):
        found(t, np.where(np.random.default_rng(1).random(len(t)) < 0.15, -17.0, q))
    with refused(DataError):
        found(t, q + (t > 7.7))
