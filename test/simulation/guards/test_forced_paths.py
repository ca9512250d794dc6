# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs with forces at steps too large raise an alarm, and resolved ones raise none."""

from typing import Any

from hnn_vi_ros import Scene, simulate, simulate_many
from hnn_vi_ros.simulation import build
import numpy as np
import pytest

PENDULUM = {'kind': 'pendulum'}
WELLS = {'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x^2 / 2 - x^2 / 2 + x^4 / 4'}
SERVO = {'kind': 'servo', 'coordinates': ['angle'], 'damping': 1.0, 'position': [0.5],
         'stiffness': 1e4}


def drive(coordinate: str, amplitude: float, frequency: float) -> dict[str, Any]:
    return {'kind': 'periodic_drive', 'coordinate': coordinate, 'amplitude': amplitude,
            'frequency': frequency}


def damping(rate: float) -> dict[str, Any]:
    return {'kind': 'damping', 'rate': rate}


# H, q, p, duration [s], effects; a method, a step that is wrong, one that is right.
CASES = {
    'orbit in a double well': (
        WELLS, 0.8, 0.0, 100.0, [damping(0.25), drive('x', 0.2, 0.5 / np.pi)],
        'implicit_midpoint', 0.8, 0.02),
    'overdamped': (PENDULUM, 1.0, 0.0, 30.0, [damping(1e4)], 'generalized_leapfrog', 0.01, None),
    'resonance': ({'kind': 'harmonic_oscillator', 'stiffness': 100.0}, 0.0, 0.0, 60.0,
                  [damping(0.05), drive('x', 1.0, 5.0 / np.pi)], 'rk4', 0.1, 0.01),
    'drag': ({'kind': 'free_particle', 'names': ['x']}, 0.0, 400.0, 5.0,
             [{'kind': 'quadratic_drag', 'coordinates': ['x'], 'coefficient': 0.5}],
             'generalized_leapfrog', 0.02, 0.001),
    'servo': (PENDULUM, 0.0, 0.0, 6.0, [SERVO], 'gauss4', 0.03, 0.002),
    'paper': (PENDULUM, 0.2, 0.0, 20.0, [damping(0.5), drive('angle', 1.0, 0.4)],
              'variational_euler', 0.3, 0.002)}


def scene_of(case: str, method: str, step_size: float) -> Scene:
    hamiltonian, q, p, _, effects, *_ = CASES[case]
    return Scene.build(hamiltonian=hamiltonian, integrator=method, step_size=step_size,
                       initial_state=([q], [p]), effects=effects)


def kinds(case: str, step_size: float) -> set[str]:
    *_, duration, _, method, _, _ = CASES[case]
    return {alarm.kind for alarm in simulate(scene_of(case, method, step_size), duration).alarms}


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('case', CASES)
def test_run_with_forces_at_steps_too_large_raises_an_alarm(case):
    *_, coarse, fine = CASES[case]
    assert 'path not resolved' in kinds(case, coarse)
    assert fine is None or kinds(case, fine) == set()


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method, h, told', [
    ('generalized_leapfrog', 1 / 6, True), ('generalized_leapfrog', 0.04, False),
    ('gauss8', 0.15, False), ('gauss8', 0.2, True)])
def test_drive_that_the_nodes_cannot_see_is_told(method, h, told):
    """At h nu = 2, halved steps see a constant force as well."""
    scene = Scene.build(hamiltonian=PENDULUM, integrator=method, step_size=h,
                        initial_state=([0.5], [0.0]), effects=[drive('angle', 0.1, 12.0)])
    alarms = simulate(scene, 2.0).alarms
    assert ('drive not resolved' in [alarm.kind for alarm in alarms]) == told


@pytest.mark.filterwarnings('ignore')
def test_trajectories_that_step_together_are_told_of_paths_that_are_wrong():
    scene = scene_of('orbit in a double well', 'implicit_midpoint', 0.8)
    many = simulate_many(scene, [[0.8], [0.7]], [[0.0], [0.0]], 80.0, samples=100)
    assert all('path not resolved' in [alarm.kind for alarm in own] for own in many.alarms)


@pytest.mark.parametrize('method', ['gauss4', 'generalized_leapfrog', 'implicit_midpoint'])
def test_machine_that_a_servo_holds_at_rest_costs_few_gradients(method):
    # The terms of its force, 1250 N m, cancel but for gravity and rounding.
    held = {**SERVO, 'stiffness': 2500.0, 'damping': 100.0}
    scene = Scene.build(hamiltonian=PENDULUM, integrator=method, step_size=0.002,
                        initial_state=([0.0], [0.0]), effects=[held])
    assert simulate(scene, 6.0).alarms == ()
    live = build(scene)
    live.advance(3000)
    # Alarmed from 100.
    assert live.rescued == 0 and live.costliest[0] < 50


@pytest.mark.filterwarnings('ignore')
def test_commands_that_cannot_be_held_for_long_do_not_hide_a_wrong_path():
    """Under a constant force no coarse step can be solved after a second; it changes before."""
    pole = ('(p_cart^2 - 4 * cos(pole) * p_cart * p_pole + 24 * p_pole^2)'
            ' / (2 * (1 + sin(pole)^2 / 5)) + 0.981 * (1 - cos(pole))')
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['cart', 'pole'], 'H': pole},
        integrator='generalized_leapfrog', step_size=0.16, initial_state=([0.0] * 2, [0.0] * 2),
        effects=[{'kind': 'external_force', 'coordinates': ['cart'], 'timeout': 100.0}])
    pushed = simulate(scene, 14.4, commands=lambda t: [
        0.0 if t < 9.59 else 6.0 * (-1.0) ** int((t + 0.01) / 1.2)])
    assert [alarm.kind for alarm in pushed.alarms] == ['path not resolved']


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('fast', [0, 1, 2])
def test_trajectories_with_commands_are_told_of_any_path_that_is_wrong(fast):
    p, commands = np.zeros((3, 1)), np.full((3, 200, 1), 0.05)
    p[fast] = 12.0
    pushed = [{'kind': 'external_force', 'coordinates': ['x'], 'timeout': 100.0}, damping(0.05)]
    scene = Scene.build(hamiltonian=WELLS, integrator='generalized_leapfrog', step_size=0.1,
                        initial_state=([1.0], [0.0]), effects=pushed)
    many = simulate_many(scene, np.full((3, 1), 1.05), p, 20.0, samples=200, commands=commands)
    assert [[alarm.kind for alarm in own] for own in many.alarms] == [
        ['path not resolved'] * (k == fast) for k in range(3)]


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('effects', [[], [damping([0.0, 0.01])]])
def test_angle_is_watched_whatever_the_unit_of_a_length(effects):
    """A cart goes 20 km in mm, beside a pendulum that is wrong by its whole amplitude."""
    cart, angle = {'name': 'cart', 'q_unit': 'mm'}, {'name': 'angle', 'q_unit': 'rad'}
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': [cart, angle],
                     'H': 'p_cart^2 / 2e6 + p_angle^2 / 2 - 9.81 * cos(angle)'},
        integrator='implicit_midpoint', step_size=0.3, initial_state=([0.0, 2.0], [5e11, 0.0]),
        effects=effects)
    assert 'path not resolved' in [alarm.kind for alarm in simulate(scene, 40.0).alarms]


def test_joint_that_a_servo_holds_to_rounding_raises_no_alarm_about_another():
    """The angle moves by 1e-15; x contracts, so that its errors of 0.3 % do not add up."""
    servo = {**SERVO, 'stiffness': 1e3, 'damping': 50.0,
             'position': [0.7 + 9.81 * np.sin(0.7) / 1e3]}
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x', 'angle'],
                     'H': 'p_x^2 / 2 + p_angle^2 / 2 + 2*x^2 + x^4 / 4 - 9.81 * cos(angle)'},
        integrator='implicit_midpoint', step_size=0.05, initial_state=([0.5, 0.7], [0.0, 0.0]),
        effects=[damping([1.0, 0.0]), drive('x', 3.0, 0.3), servo])
    assert simulate(scene, 300.0).alarms == ()


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('step_size', [1.7, 2.4])
def test_run_that_diverges_within_a_dozen_steps_raises_an_alarm(step_size):
    # rk4 multiplies an oscillation by 3.2 and 18 in each step, with half the step by .9 and .5.
    scene = Scene.build(hamiltonian={'kind': 'harmonic_oscillator', 'stiffness': 4.0},
                        integrator='rk4', step_size=step_size, initial_state=([1.0], [0.0]),
                        effects=[damping(0.1)])
    alarms = simulate(scene, 12 * step_size).alarms
    assert 'path not resolved' in {alarm.kind for alarm in alarms}


def alarms_of(h_nu: float, method: str, h: float = 0.02) -> set[str]:
    """Return the alarms of a mass on a spring with a drive in H."""
    hamiltonian = {
        'kind': 'formula', 'coordinates': ['x'], 'parameters': {'w': 2.0 * np.pi * h_nu / h},
        'H': 'p_x^2 / 2 + x^2 / 2 - 50 * x * cos(w * t + 0.3)'}
    scene = Scene.build(hamiltonian=hamiltonian, integrator=method, step_size=h,
                        initial_state=([0.0], [0.0]))
    return {alarm.kind for alarm in simulate(scene, 0.5).alarms}


# The largest h nu of a right run, below 1 % of the amplitude, and the next whole one.
RESOLVED = {'variational_euler': (0.0005, 1), 'generalized_leapfrog': (0.05, 1),
            'implicit_midpoint': (0.05, 1), 'rk4': (0.3, 1), 'gauss4': (0.3, 1),
            'yoshida4': (0.1, 1), 'gauss8': (0.48, 1), 'kahan_li8': (0.48, 1), 'gauss16': (1, 3)}


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method', RESOLVED)
def test_time_in_h_that_stages_cannot_see_is_told(method):
    right, wrong = RESOLVED[method]
    assert 'drive not resolved' not in alarms_of(right, method)
    # Where stages see some phases of a period, trials differ.
    for h_nu in (wrong, 2 * wrong, 7, 8, 13, 31, 32):
        assert alarms_of(h_nu, method) & {'drive not resolved', 'path not resolved'}
    # At multiples of this, all trials see the same.
    assert 'drive not resolved' in alarms_of(32, method)


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method, h_nu', [('kahan_li8', 4), ('kahan_li8', 6), ('suzuki4', 2)])
def test_path_is_lost_where_half_the_step_is_as_wrong(method, h_nu):
    assert 'path not resolved' in alarms_of(h_nu, method)


@pytest.mark.filterwarnings('ignore')
def test_pulse_between_stages_is_told_and_a_jump_is_not():
    """Whenever it comes: the time in H is checked all along the run."""
    def kinds(force: str) -> set[str]:
        scene = Scene.build(
            hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                         'H': f'p_x^2 / 2 + x^2 / 2 - x * ({force})'},
            integrator='implicit_midpoint', step_size=0.02, initial_state=([0.3], [0.0]))
        return {alarm.kind for alarm in simulate(scene, 20.0).alarms}

    assert 'drive not resolved' in kinds('piecewise(t > 10, cos(200 * pi * t), 0)')
    assert 'drive not resolved' not in kinds('piecewise(t > 4.13, 0.1, 0)')


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method, h', [('dop853', 0.1), ('gauss4', 0.05)])
def test_jumps_of_h_in_time_are_work_of_the_drive(method, h):
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                     'H': 'p_x^2 / 2 + x^2 / 2 - x * piecewise(t > 4.13, 1, 0)'},
        integrator=method, step_size=h, initial_state=([0.1], [0.0]))
    run = simulate(scene, 60.0)
    assert not run.alarms
    # H jumps by -x = -0.1 cos(4.13), its work is not that of a step without it.
    drift = simulate(scene.changed({'integrator': {'kind': 'explicit_euler'}}), 60.0)
    assert 'energy not accounted for' in {alarm.kind for alarm in drift.alarms}
