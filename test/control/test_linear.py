# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equilibria, linear models and regulators."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.control import (
    BatchStep, find_equilibrium, linearise, lqr, momentum, state_space, velocity)
from hnn_vi_ros.errors import StateError
from hnn_vi_ros.scene import Scene
import numpy as np
import pytest
from scipy.linalg import expm

FORCE = {'kind': 'external_force', 'coordinates': ['angle']}


def pendulum(*effects: dict, method: str = 'rk4') -> Scene:
    return load_scene('exact_pendulum').with_overrides(0.01, method, effects=[FORCE, *effects])


def test_a_and_b_of_a_damped_pendulum_are_the_formulas():
    scene = pendulum({'kind': 'damping', 'rate': 0.2})
    model = scene.create_hamiltonian()
    stiffness = model.hessian_vector(*np.eye(2)[:, :1] * np.pi, np.ones(1), np.zeros(1))[0][0]
    z, u = find_equilibrium(scene, [3.0])
    assert np.abs(z - [np.pi, 0.0]).max() < 1e-12 and u == [0.0]
    a, b = linearise(scene, (z, u))
    mass = 1.0 / a[0, 1]
    assert a == pytest.approx(np.array([[0.0, 1.0 / mass], [-stiffness, -0.2]]), abs=1e-12)
    assert stiffness < 0.0 and np.array_equal(b, [[0.0], [1.0]])


def test_a_of_a_double_pendulum_is_its_mass_matrix_and_weights():
    scene = load_scene('exact_double_pendulum').with_overrides(effects=[
        {'kind': 'external_force', 'coordinates': ['angle1']}])
    z, u = find_equilibrium(scene, [3.0, 3.0])
    a, b = linearise(scene, (z, u))
    # Of bobs of 1 kg on rods of 1 m, with angles from the vertical: upright.
    mass, weight = np.array([[2.0, 1.0], [1.0, 1.0]]), 9.81 * np.diag([2.0, 1.0])
    assert np.abs(a[:2, 2:] - np.linalg.inv(mass)).max() < 1e-12
    assert np.abs(a[2:, :2] - weight).max() < 1e-12
    assert not a[:2, :2].any() or np.abs(a[:2, :2]).max() < 1e-12
    assert np.array_equal(b[:, 0], [0.0, 0.0, 1.0, 0.0])


def test_the_map_of_a_step_is_the_exponential_to_the_order_of_the_method():
    scene, at = pendulum(), ([np.pi, 0.0], [0.0])
    a, b = linearise(scene, at)
    whole = expm(0.1 * np.block([[a, b], [np.zeros((1, 3))]]))
    a_d, b_d = linearise(scene, at, hold=10)
    # Ten steps of (h |A|)^5 / 120, with |A| below 10 / s.
    assert np.abs(np.hstack([a_d, b_d]) - whole[:2]).max() < 10 * 0.1**5 / 120


def test_commands_hold_a_pendulum_aside():
    scene = pendulum()
    z, u = find_equilibrium(scene, [0.5], free=[], commands=True)
    slope = scene.create_hamiltonian().gradient(z[:1], z[1:])[0]
    assert z[0] == 0.5 and u == pytest.approx(slope, rel=1e-12) and u[0] > 0.0
    with pytest.raises(StateError, match='no equilibrium is found'):
        find_equilibrium(scene, [0.5], free=[])
    with pytest.raises(ValueError, match='among the coordinates: angle'):
        find_equilibrium(scene, [0.5], free=['elbow'])


@pytest.mark.parametrize('discrete', [False, True])
def test_the_regulator_solves_riccatis_equation_and_stabilises(discrete):
    scene, at = pendulum(), ([np.pi, 0.0], [0.0])
    a, b = linearise(scene, at, hold=1 if discrete else None)
    q, r = np.diag([2.0, 1.0]), np.array([[0.5]])
    gain, cost = lqr(a, b, q, r, discrete)
    if discrete:
        rest = a.T @ cost @ (a - b @ gain) - cost + q
        assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1.0
    else:
        rest = a.T @ cost + cost @ a - cost @ b @ gain + q
        assert np.linalg.eigvals(a - b @ gain).real.max() < 0.0
    # Rounding of the terms of the equation, and of the solution of its eigenvalue problem.
    assert np.abs(rest).max() < 1e-12 * np.abs(cost).max() * max(1.0, np.abs(a).max())**2 * 10
    with pytest.raises(ValueError, match='no regulator stabilises'):
        lqr(a, 0.0 * b, q, r, discrete)


def test_momentum_and_velocity_are_inverse():
    steps = BatchStep('exact_double_pendulum')
    q, v = np.random.default_rng(0).normal(size=(2, 5, 2))
    assert velocity(steps, q, momentum(steps, q, v)) == pytest.approx(v, abs=1e-12)


def test_python_control_takes_the_linear_model():
    pytest.importorskip('control', minversion='0.10', reason='python-control is not installed')
    scene, at = pendulum(), ([np.pi, 0.0], [0.0])
    for hold, time in ((None, 0.0), (4, 0.04)):
        found = state_space(scene, at, hold)
        a, b = linearise(scene, at, hold)
        assert np.array_equal(found.A, a) and np.array_equal(found.B, b) and found.dt == time
    assert found.input_labels == ['force_angle'] and found.state_labels == ['angle', 'p_angle']
