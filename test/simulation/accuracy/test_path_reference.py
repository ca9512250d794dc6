# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""References: as accurate as they say, by formulas or by refining, and none in chaos."""

import math

from helpers import EPS, exact_orbit, exact_pendulum
from hnn_vi_ros.effects.thermostat import Thermostat
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.double_pendulum import DoublePendulum
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.simulation.accuracy.path_reference import best_reference, PathReference
from hnn_vi_ros.simulation.accuracy.trials import InitialValueProblem, survey
import numpy as np
import pytest


def reference_of(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray, horizon: float, *effects,
                 limit: float = math.inf) -> PathReference:
    """Return the best reference of a motion."""
    problem = InitialValueProblem(hamiltonian, effects, q, p)
    return best_reference(
        problem, horizon, horizon, survey(problem, horizon, horizon), limit)


def tenths(reference: PathReference) -> np.ndarray:
    """Return the states at tenths of the horizon, shape (10, 2 d)."""
    return reference.states.reshape(10, -1, reference.states.shape[1])[:, -1]


@pytest.mark.parametrize('q0, p0', [(2.5, 0.0), (0.3, -1.0), (1.0, 9.0), (-3.0, 0.5)])
@pytest.mark.parametrize('horizon', [10.0, 1000.0])
def test_pendulum_reference_is_as_accurate_as_it_says(q0, p0, horizon):
    reference = reference_of(Pendulum(), np.array([q0]), np.array([p0]), horizon)
    exact = np.array([exact_pendulum(q0, p0, horizon * j / 10) for j in range(1, 11)])
    assert reference.how.startswith('exact') and reference.verified
    assert np.abs(tenths(reference) - exact).max() <= reference.accuracy


@pytest.mark.parametrize('e', [0.0, 0.6, 0.9])
def test_kepler_reference_is_as_accurate_as_it_says(e):
    q0, p0 = np.array([-1.0 - e, 0.0]), np.array([0.0, -np.sqrt((1.0 - e) / (1.0 + e))])
    reference = reference_of(Kepler(), q0, p0, 1000.0)
    exact = np.array([exact_orbit(e, 100.0 * j) for j in range(1, 11)])
    assert reference.how.startswith('exact')
    # 1 + e and the square root are rounded: eps of the energy, 1.5 eps of the phase T.
    sensitivity = 3.0 * EPS * 1000.0 / (1.0 - e) ** 2
    assert np.abs(tenths(reference) - exact).max() <= reference.accuracy + sensitivity


@pytest.mark.parametrize('q0, p0', [((1.0, 0.0), (0.0, 1.5)), ((1.0, 0.0), (-0.5, 0.0))],
                         ids=['open', 'into the centre'])
def test_orbits_that_are_no_ellipse_have_no_formula(q0, p0):
    assert Kepler().exact_motion(np.array(q0), np.array(p0), np.ones(1)) is None


def test_formula_and_gauss_agree_within_their_accuracies(monkeypatch):
    start = np.array([0.96, 1.28]), np.array([-0.4, 0.3])
    exact = reference_of(Kepler(), *start, 100.0)
    monkeypatch.setattr(Kepler, 'exact_motion', lambda *arguments: None)
    gauss = reference_of(Kepler(), *start, 100.0)
    assert gauss.how.startswith('gauss16') and gauss.accuracy < 1e-11
    # Each is known to a few times what it says.
    assert np.abs(exact.states - gauss.states).max() <= 3.0 * (exact.accuracy + gauss.accuracy)


def test_chaotic_motion_is_followed_only_as_far_as_refining_verifies():
    start = np.array([1.2, 0.0]), np.array([0.0, 0.0])
    assert reference_of(DoublePendulum(), *start, 10.0).verified
    # 500 s are some 60 Lyapunov times: 1e-16 has grown to the size of the motion by far.
    assert not reference_of(DoublePendulum(), *start, 500.0).verified


def test_random_motion_has_no_reference():
    reference = reference_of(HarmonicOscillator(), np.ones(1), np.zeros(1), 1.0,
                             Thermostat(temperature=0.1, rate=1.0))
    assert not len(reference.states) and not reference.verified and reference.horizon == 1.0


def test_reference_that_gradients_limit_keeps_the_whole_path(monkeypatch):
    """Of a method of order 2, which could be refined for ever, at the price of the path's end."""
    monkeypatch.setattr(Kepler, 'exact_motion', lambda *arguments: None)
    monkeypatch.setattr('hnn_vi_ros.simulation.accuracy.trials.SURVEYORS', ('stormer_verlet',))
    start = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    rough, fine = (reference_of(Kepler(), *start, 10.0, limit=limit) for limit in (3e4, 1e6))
    for reference in (rough, fine):
        assert len(reference.states) == reference.instants.count
    assert 1e-12 < fine.accuracy < 0.1 * rough.accuracy
