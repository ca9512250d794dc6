# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equilibria, linear models and regulators."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.control import (
    BatchStep, find_equilibrium, linearise, lqr, momentum, state_space, velocity)
from hnn_vi_ros.errors import StateError, UnsupportedSystem
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.scene import Scene
from mechanical_models import random_mechanical
from messages import refused
import numpy as np
import pytest
from scipy.linalg import expm

FORCE = {'kind': 'external_force', 'coordinates': ['angle']}


def pendulum(*effects: dict, method: str = 'rk4') -> Scene:
    return load_scene('exact_pendulum').with_overrides(0.01, method, effects=[FORCE, *effects])


def formula(H: str, near: list[float], unit: str = 'm', *effects: dict, **numbers: float) -> Scene:
    """Return a scene of a formula of coordinates x, y, ... that is stepped by rk4."""
    coordinates = [{'name': name, 'q_unit': unit} for name in 'xyz'[:len(near)]]
    return Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': coordinates, 'H': H, 'parameters': numbers},
        effects=effects, integrator='rk4', step_size=0.001,
        initial_state=(near, [0.0] * len(near)))


# A pendulum of 1 g on 5 cm, of 4.9e-4 N m and 2.5e-6 kg m2.
SMALL = {'m': 1e-3, 'l': 0.05, 'g': 9.81}
SWUNG = 'p_x^2/(2*m*l^2) - m*g*l*cos(x)'


def test_a_small_pendulum_does_not_stand_under_more_torque_than_its_weight_holds():
    pull = {'kind': 'potential', 'formula': '-s*m*g*l*x', 'parameters': {**SMALL, 's': 1.02}}
    together = formula(f'{SWUNG} - s*m*g*l*x', [1.5], 'rad', **SMALL, s=1.02)
    for scene in (together, formula(SWUNG, [1.5], 'rad', pull, **SMALL)):
        for near in (0.3, 1.5, 1.57, np.pi / 2):
            with pytest.raises(StateError, match='no equilibrium was found'):
                find_equilibrium(scene, [near])


@pytest.mark.parametrize('share', [0.5, 0.98, -0.3])
def test_a_small_pendulum_leans_by_the_arcsine_of_its_torque(share):
    scene = formula(f'{SWUNG} - s*m*g*l*x', [0.1], 'rad', **SMALL, s=share)
    z, _ = find_equilibrium(scene, [0.1])
    # The derivative of the arcsine, times rounding.
    assert abs(z[0] - np.arcsin(share)) < 1e-15 / np.sqrt(1.0 - share**2)


def test_atoms_of_argon_rest_where_the_potential_of_lennard_and_jones_is_least():
    numbers = {'m': 6.63e-26, 'e': 1.65e-21, 's': 3.4e-10}
    pair = formula('p_x^2/(2*m) + p_y^2/(2*m) + 4*e*((s/(y - x))^12 - (s/(y - x))^6)',
                   [0.0, 1.2 * numbers['s']], **numbers)
    z, _ = find_equilibrium(pair, [0.0, 1.2 * numbers['s']])
    assert (z[1] - z[0]) / numbers['s'] == pytest.approx(2.0**(1 / 6), rel=1e-12)
    with pytest.raises(StateError, match='no equilibrium was found'):
        # Beyond the point of inflection every step leads further away.
        find_equilibrium(pair, [0.0, 1.5 * numbers['s']])


def test_singular_states_are_refused_in_one_line():
    pair = formula('p_x^2/2 + 1/x + x', [1.0])
    with refused(StateError):
        find_equilibrium(pair, [0.0])
    with refused(StateError):
        linearise(pair, ([0.0, 0.0], []))


def test_a_charge_at_rest_in_a_magnetic_field_has_a_momentum_of_its_own():
    scene = formula('(p_x - b*y)^2/(2*m) + (p_y + b*x)^2/(2*m) + k*((x - a)^2 + y^2)/2',
                    [1e-6, 1e-6], b=1e-20, m=1e-26, k=1e-9, a=2e-6)
    z, _ = find_equilibrium(scene, [1e-6, 1e-6])
    assert z == pytest.approx([2e-6, 0.0, 0.0, -2e-26], abs=1e-38) \
        and z[:2] == pytest.approx([2e-6, 0.0], abs=1e-18)


def test_numbers_that_are_none_are_refused():
    with refused(ValueError):
        find_equilibrium(pendulum(), [np.nan])
    with refused(ValueError):
        find_equilibrium(pendulum(), [1.0, 2.0])
    a, b = linearise(pendulum(), ([np.pi, 0.0], [0.0]))
    for q, r, discrete in ((np.eye(2), [[0.0]], False), (np.eye(2), [[0.0]], True),
                           (np.eye(2), [[np.nan]], True), (-np.eye(2), [[1.0]], False),
                           (np.eye(3), [[1.0]], False), (np.eye(2), [[1.0, 0.0]], True)):
        with refused(ValueError):
            lqr(a, b, q, r, discrete)


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


@pytest.mark.parametrize('speed', [0.0, 0.005])
def test_a_of_a_small_pendulum_has_the_slope_of_its_friction(speed):
    inertia = SMALL['m'] * SMALL['l']**2
    scene = formula(SWUNG, [0.1], 'rad', {
        'kind': 'joint_friction', 'friction': {'x': 1e-6}, 'speed': 0.01}, **SMALL)
    a, _ = linearise(scene, ([0.1, inertia * speed], []))
    slope = 1e-6 / 0.01 / np.cosh(speed / 0.01)**2 / inertia
    # Differences over 6e-6 rad/s: their square, relative to that of the speed of the friction.
    assert a[1, 1] == pytest.approx(-slope, rel=1e-6)


@pytest.mark.parametrize('friction', [
    {'kind': 'joint_friction', 'damping': {'x': 0.1, 'y': 0.1}, 'friction': {'x': 0.1, 'y': 0.2}},
    {'kind': 'damping', 'rate': 0.1}])
@pytest.mark.parametrize('near', [[0.3, 1.5, 0.1], [0.0, -1.6, 0.1], [1.0, -1.5, 0.2]])
def test_friction_does_not_move_the_equilibria_of_an_arm(friction, near):
    """No force acts on x, the angle about the vertical, whose friction has rounding alone."""
    H = ('p_x^2/(2*(0.1 + cos(y)^2)) + (p_y^2 + 4*p_z^2 - 2*p_y*p_z*cos(y - z))/(2*(2 - cos(y - z)'
         '^2)) + 9*sin(y) + 3*sin(z)')
    (z, u), (plain, _) = (find_equilibrium(formula(H, near, 'rad', *effects), near)
                          for effects in ([friction], []))
    assert np.array_equal(z, plain) and not u.size
    assert np.abs(np.cos(z[1:3])).max() < 1e-15 and z[0] == near[0]


@pytest.mark.parametrize(('load', 'fade'), [(0.3, 0.0), (0.0, 0.05), (0.0, 0.0)])
def test_b_is_the_derivative_by_commands_that_are_more_than_forces(load, fade, tmp_path):
    force, gain = {'kind': 'external_force', 'coordinates': ['angle']}, 1.0
    if fade:
        path = tmp_path / 'map.safetensors'
        save_checkpoint(path, random_mechanical('joint', input_map=[[1.4]], fade=[fade]))
        force, gain = {'kind': 'external_force', 'model': str(path)}, 1.4 / (1.0 + 2.0 * fade)**2
    friction = {'kind': 'joint_friction', 'damping': {'angle': 0.1}, 'speed': 0.1,
                'load': {'angle': load}}
    steps = BatchStep(load_scene('exact_pendulum').with_overrides(
        0.01, 'rk4', effects=[force, *[friction] * (load > 0.0)]))
    z = np.append([0.4], momentum(steps, [0.4], [0.2]))
    for linear in (linearise(steps, (z, [2.0])), steps.field_derivatives(z, [2.0])):
        assert linear[1][:, 0] == pytest.approx([0.0, gain - load * np.tanh(2.0)], rel=1e-10)
    if load or fade:
        with refused(UnsupportedSystem):
            _ = steps.places
    else:
        assert steps.places == [[1.0]]


def test_friction_under_load_without_commands_has_an_empty_b():
    """Linearise a pendulum at rest, with the slope F / u of its friction."""
    steps = BatchStep(load_scene('exact_pendulum').with_overrides(0.01, 'rk4', effects=[
        {'kind': 'joint_friction', 'friction': {'angle': 0.1}, 'load': {'angle': 0.2},
         'speed': 0.5}]))
    z, u = find_equilibrium(steps, [0.1])
    a, b = linearise(steps, (z, u))
    plain = linearise(load_scene('exact_pendulum'), (z, []))[0]
    v = steps.hamiltonian.inverse_mass(z[:1], np.zeros(1))[0, 0]
    # Differences of tanh, by the cube root of eps.
    assert a - plain == pytest.approx(np.array([[0.0, 0.0], [0.0, -0.1 / 0.5 * v]]), abs=1e-8)
    assert b.shape == steps.derivatives(z)[2].shape == (2, 0)


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
    with pytest.raises(StateError, match='no equilibrium was found'):
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


@pytest.mark.parametrize('v', [1e-13, 3e-20])
def test_tiny_velocities_have_momenta(v):
    mass = 1.0 / velocity('exact_pendulum', [0.3], [1.0])
    assert momentum('exact_pendulum', [0.3], [v]) == pytest.approx(mass * v, rel=1e-12, abs=0.0)
    # In a magnetic field, beside a far larger momentum that moves nothing.
    field = formula('(p_x - b*y)^2/(2*m) + p_y^2/(2*m)', [0.0, 1e-3], b=1.0, m=1e-20)
    p = momentum(field, [0.0, 0.0], [v, 0.0])
    assert p == pytest.approx([1e-20 * v, 0.0], rel=1e-12, abs=0.0)


def test_python_control_takes_the_linear_model():
    pytest.importorskip('control', minversion='0.10', reason='python-control is not installed')
    scene, at = pendulum(), ([np.pi, 0.0], [0.0])
    for hold, time in ((None, 0.0), (4, 0.04)):
        found = state_space(scene, at, hold)
        a, b = linearise(scene, at, hold)
        assert np.array_equal(found.A, a) and np.array_equal(found.B, b) and found.dt == time
    assert found.input_labels == ['force_angle'] and found.state_labels == ['angle', 'p_angle']
