# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The pair DOP853: orders, tolerances, the clock, events, snapshots, stiffness."""

import warnings

from helpers import dop853_path, effect, kepler_orbit, plain_run, python_kernel, Uncompiled
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import AlarmWarning, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.integrators import Dop853, mark_commanded, PhasePoint
from hnn_vi_ros.integrators.dop853_tableau import DOP853_TABLEAU
from hnn_vi_ros.scene import Condition
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.dense_step import record_at
from hnn_vi_ros.simulation.events import EventFunction, WatchedSimulation
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.steps import StabilityGuard
from hnn_vi_ros.simulation.guards.watch import look, Watch
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

EPS = float(np.finfo(np.float64).eps)
STARTS = {'pendulum': [1.5, 0.0], 'double_pendulum': [1.0, 0.5, 0.0, 0.0],
          'kepler': [0.4, 0.0, 0.0, 2.0], 'henon_heiles': [0.1, 0.2, 0.3, 0.1]}


def run(name: str, tolerance: float, h: float, *effects, start=None) -> Simulation:
    """Return a compiled simulation with equal tolerances."""
    q, p = np.split(np.array(STARTS[name] if start is None else start), 2, axis=-1)
    return Simulation(HAMILTONIANS[name](), Dop853(tolerance, tolerance), h, q, p, effects)


def one_step(length: float, share: float) -> np.ndarray:
    """Return (q, p) at a share of one internal step of this length, in plain Python."""
    method, kernel = Dop853(1e6, 1e6), python_kernel(HAMILTONIANS['tao']())
    z, z1, memory = PhasePoint.empty(1), PhasePoint.empty(1), method.memory(1)
    z.q[0], z.p[0], memory[0].kept.control[0] = 0.7, -1.2, (length, 1.0)
    if share == 1.0:
        mark_commanded(memory)
    method.step(kernel, share * length, method.options(), z, z1, memory)
    return np.append(z1.q, z1.p)


def test_dop853_coefficients_satisfy_the_order_conditions():
    """Of the quadrature, and of the stages' own order, in the known nodes (section II.5)."""
    stages, errors, dense = DOP853_TABLEAU
    nodes, powers = stages.sum(axis=1), np.arange(8)
    # 1/3, 1/4, 4/13 and 6/7 are among the nodes; the last stage and the new state are at 1.
    known = [1/3, 1/4, 4/13, 6/7, 1.0, 1.0]
    assert nodes[[5, 6, 7, 10, 11, 12]] == pytest.approx(known, abs=4e-14)
    moments = nodes[:, None] ** powers
    # Sums of 13 terms of size up to 10.
    assert stages[12] @ moments == pytest.approx(1.0 / (powers + 1.0), abs=200 * EPS)
    for k, order in ((0, 5), (1, 3)):
        defects = np.abs(errors[k] @ moments)
        assert defects[:order].max() < 1e-13 < 1e-4 < defects[order]
    assert dense @ moments[:, 0] == pytest.approx(np.zeros(4), abs=1e-12)


@pytest.mark.parametrize('share, order', [(1.0, 8), (0.3, 7), (0.8, 7)])
def test_dop853_step_and_dense_output_have_their_orders(share: float, order: int, measured):
    lengths, errors = np.array([0.4, 0.3, 0.2, 0.15]), []
    for length in lengths:
        exact = solve_ivp(lambda t, z: [(z[0]**2 + 1) * z[1], -(z[1]**2 + 1) * z[0]],
                          (0.0, share * length), [0.7, -1.2], 'DOP853', rtol=3e-14, atol=1e-16)
        errors.append(np.abs(one_step(length, share) - exact.y[:, -1]).max())
    assert min(errors) > 100 * EPS
    slope = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    measured('order of the local error', f'dop853 at {share} of a step', slope,
             f'{order + 1} + 0.6')
    # One step errs by O(h^(p + 1)); the next term changes the slope by up to 0.6 at these lengths.
    assert order + 0.7 < slope < order + 1.8


@pytest.mark.parametrize('name', STARTS)
@pytest.mark.parametrize('h', [0.01, 10.0])
def test_dop853_holds_its_tolerance(name: str, h: float, measured):
    """
    Errors of samples, also inside internal steps, are those of n steps of the tolerance.

    Each internal step adds at most tolerance (1 + size of the state), which grows as neighbouring
    motions part.
    """
    hamiltonian, start = HAMILTONIANS[name](), np.array(STARTS[name])
    d, times = start.size // 2, np.linspace(0.0, 10.0, 101)[1:]
    exact = dop853_path(hamiltonian, *np.split(start, 2), np.append(0.0, times), 3e-14, 1e-15)
    growth = 1.0
    for direction in np.eye(2 * d):
        near = dop853_path(hamiltonian, *np.split(start + 1e-7 * direction, 2),
                           np.append(0.0, times), 1e-12, 1e-13)
        growth = max(growth, np.abs(near - exact).max() / 1e-7)
    size = 1.0 + np.abs(exact).max()
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
        simulation = run(name, tolerance, h)
        q, p = record_at(simulation, times)
        error = np.abs(np.hstack([q, p]) - exact[1:]).max()
        measured('error over tolerance', f'dop853, {name}, {tolerance:g}, h = {h:g} s',
                 error / tolerance, f'{growth:.0f} growth')
        assert error <= simulation.internal_steps[0] * growth * size * tolerance


def test_dop853_internal_steps_do_not_depend_on_the_clock():
    states, steps = [], []
    for h in (0.01, 0.25, 10.0):
        simulation = run('kepler', 1e-8, h)
        simulation.advance(round(10.0 / h))
        states.append(np.append(simulation.q, simulation.p))
        steps.append(simulation.internal_steps[0])
    # The same steps, and time as a sum of up to a thousand rounded terms, at speeds up to 2.
    assert steps[0] == steps[1] and 0 <= steps[0] - steps[2] <= 1
    assert np.abs(states[0] - states[1]).max() < 1e-12
    # The end is a state of a step, not of dense output.
    assert np.abs(states[0] - states[2]).max() < 1e-6


def test_dop853_follows_a_kepler_orbit_through_its_pericentre():
    simulation = run('kepler', 1e-10, 0.1)
    q, _ = simulation.record(200, 1)
    exact, _ = kepler_orbit(np.arange(1, 201) * 0.1, 0.6)
    # Some 200 internal steps of 1e-10; phase errors grow with the square of the time, 20 s.
    assert np.abs(q - exact).max() < 200 * 20.0 * 1e-10
    accepted, rejected, limited = simulation.internal_steps
    assert 0 < rejected < 0.2 * accepted and limited == 0


def test_dop853_trajectories_that_step_together_are_bit_identical_to_single_ones():
    starts = np.array([[0.4, 0.0, 0.0, 2.0], [0.5, 0.0, 0.0, 1.7], [0.9, 0.1, 0.0, 1.1]])
    together = run('kepler', 1e-7, 0.3, start=starts)
    together.advance(40)
    for k, start in enumerate(starts):
        single = run('kepler', 1e-7, 0.3, start=start)
        single.advance(40)
        assert np.array_equal(single.q, together.q[k])
        assert np.array_equal(single.p, together.p[k])


@pytest.mark.parametrize('effects', [
    (), (('damping', [0.3]), ('periodic_drive', 'angle', 0.7, 0.4)),
    (('external_force', ['angle']),)], ids=['none', 'forces', 'commands'])
def test_dop853_restored_inside_an_internal_step_is_bit_identical(effects):
    made = [effect(*row) for row in effects]
    whole, resumed = (run('pendulum', 1e-6, 0.01, *made) for _ in range(2))
    for simulation in (whole, resumed):
        if simulation.takes_commands:
            simulation.set_command([0.4])
    whole.advance(33)
    snapshot = whole.snapshot()
    whole.advance(70)
    resumed.restore(snapshot)
    resumed.advance(70)
    assert np.array_equal(resumed.row, whole.row)
    assert np.array_equal(resumed.internal_steps, whole.internal_steps)


def test_dop853_steps_with_forces_pass_the_clock_and_those_with_commands_end_there():
    smooth = run('pendulum', 1e-6, 0.01, effect('damping', [0.3]))
    driven = run('pendulum', 1e-6, 0.01, effect('external_force', ['angle']))
    for simulation in (smooth, driven):
        simulation.advance(200)
    assert smooth.internal_steps[0] < 20
    assert driven.internal_steps[0] == 200


def test_dop853_command_acts_from_its_step_on():
    simulation, z = run('pendulum', 1e-9, 0.1, effect('external_force', ['angle'])), [1.5, 0.0]
    for k in range(20):
        force = 3.0 * np.sin(0.7 * k)
        simulation.set_command([force])
        simulation.advance(1)
        z = solve_ivp(lambda t, z, force=force: [z[1], force - 9.81 * np.sin(z[0])], (0.0, 0.1), z,
                      'DOP853', rtol=1e-12, atol=1e-13).y[:, -1]
    # Twenty steps of 1e-9 at momenta of some 5, in a motion that does not stretch errors.
    assert np.abs(np.append(simulation.q, simulation.p) - z).max() < 20 * 5 * 1e-9
    assert abs(simulation.energy_balance) < 20 * 5 * 5 * 1e-9


def test_dop853_starts_anew_from_a_state_that_an_effect_has_changed():
    """A bounce inside an internal step: the path ahead of the clock is discarded."""
    simulation = plain_run('free_particle', Dop853(1e-8, 1e-8), 0.1, [0.5], [-1.0],
                           effect('impact', 'x'))
    simulation.advance(10)
    # Free motion, reflected at 0 after 0.5 s.
    assert simulation.q[0] == pytest.approx(0.5, abs=1e-12)
    assert simulation.p[0] == pytest.approx(1.0, abs=1e-12)


def test_dop853_finds_events_in_each_internal_step():
    """A step of 10 s holds several swings of a pendulum, and the work of a damper."""
    for damping in (0.0, 0.2):
        effects = [effect('damping', [damping])] if damping else []
        simulation = WatchedSimulation(run('pendulum', 1e-10, 10.0, *effects),
                                       [EventFunction(Condition('angle = 0'))])
        simulation.advance(1)

        def rates(t, z, damping=damping):
            return [z[1], -9.81 * np.sin(z[0]) - damping * z[1]]
        expected = solve_ivp(rates, (0.0, 10.0), STARTS['pendulum'], 'DOP853', rtol=1e-12,
                             atol=1e-13, events=lambda t, z: z[0]).t_events[0]
        # Errors of the path, some 1e-9, over speeds above 1.
        assert [event.t for event in simulation.events] == pytest.approx(list(expected), abs=1e-8)
        assert len(expected) > 8


def test_dop853_at_rest_takes_few_internal_steps():
    simulation = plain_run('pendulum', Dop853(), 0.1, [0.0], [0.0])
    simulation.advance(1000)
    assert simulation.q[0] == simulation.p[0] == 0.0
    # From 1e-6 s by factors of 10, or 5 at first, to 1000 h = 100 s.
    assert simulation.internal_steps[0] <= 12


def test_dop853_fails_by_name_at_a_collision():
    simulation = run('kepler', 1e-8, 1.0, start=[1.0, 0.0, 0.0, 0.0])
    with refused(StepFailure):
        simulation.advance(2)


@pytest.mark.parametrize('kind', ['lugre_friction', 'motor'])
def test_dop853_refuses_internal_forces_by_name(kind: str):
    effects = {'lugre_friction': [effect('lugre_friction', 'angle', 1e4, 1.0, 1.5, 0.1)],
               'motor': [effect('external_force', ['angle']), effect('motor', 'angle', 0.01)]}
    with refused(UnsupportedSystem):
        plain_run('pendulum', Dop853(), 0.1, [0.3], [0.0], *effects[kind])


@pytest.mark.parametrize('tolerance', [1e-3, 1e-6, 1e-9])
def test_dop853_limited_by_stability_raises_an_alarm_that_names_an_implicit_method(tolerance):
    """Springs of 1000 rad/s at rest, damping of 1000 / s, and a servo of 1e4 N m/rad."""
    hamiltonian = Uncompiled(Formula(
        ['x', 'y'], 'p_x^2/2 + p_y^2/2 + 9.81*(1 - cos(x)) + 1e6*y^2/2'))
    for system, start, effects, stiff in (
            (hamiltonian, [[1.5, 1e-12], [0.0, 0.0]], [], True),
            ('pendulum', [[1.5], [0.0]], [effect('damping', [1000.0])], True),
            ('pendulum', [[1.5], [0.0]], [effect('damping', [1.0])], False),
            ('pendulum', [[0.4], [0.0]], [effect('servo', ['angle'], 1e4, 200.0, 100.0, [0.5])],
             True),
            ('kepler', [[0.4, 0.0], [0.0, 2.0]], [], False)):
        simulation = plain_run(system, Dop853(tolerance, tolerance), 0.1, *start, *effects)
        watch = Watch(RunFacts(simulation), (StabilityGuard,))
        simulation.advance(50)
        watch.update(look(simulation))
        assert [alarm.kind for alarm in watch.alarms] == ['stiff'] * stiff
        assert all('gauss4' in alarm.message for alarm in watch.alarms)


def test_oscillation_that_the_tolerance_resolves_is_not_stiff_until_it_has_decayed():
    """A servo of 1e4 N m/rad and damping of 1 N m s/rad decays by exp(-t / 2)."""
    simulation = plain_run('pendulum', Dop853(1e-6, 1e-6), 0.1, [0.4], [0.0], effect(
        'servo', ['angle'], 1e4, 1.0, 100.0, [0.5]))
    watch, kinds = Watch(RunFacts(simulation), (StabilityGuard,)), []
    for _ in range(2):
        # Amplitudes 7e-4 at t = 10 s, which the tolerance resolves, and 1e-12 at t = 50 s.
        simulation.advance(100 if not kinds else 400)
        watch.update(look(simulation))
        kinds.append([alarm.kind for alarm in watch.alarms])
    assert kinds == [[], ['stiff']]


def test_steps_of_a_chain_whose_springs_oscillate_follow_the_tolerance_without_an_alarm():
    """FPUT, omega = 50: 1000^(1/8) = 2.4 times as many steps for a thousandth of the error."""
    scene, counts = load_scene('fput_chain'), []
    for tolerance in (1e-6, 1e-9):
        simulation = Simulation(scene.create_hamiltonian(), Dop853(tolerance, tolerance), 0.1,
                                scene.initial_state.q, scene.initial_state.p)
        watch = Watch(RunFacts(simulation), (StabilityGuard,))
        simulation.advance(100)
        watch.update(look(simulation))
        assert not watch.alarms
        counts.append(simulation.internal_steps[0])
    assert 2.2 < counts[1] / counts[0] < 2.6


def test_energy_drift_of_dop853_is_named_as_that_of_a_method_that_is_not_symplectic():
    scene = load_scene('exact_pendulum').changed({'integrator': {
        'kind': 'dop853', 'relative_tolerance': 0.03, 'absolute_tolerance': 0.03}})
    with pytest.warns(AlarmWarning, match='dop853 is not symplectic, and its energy drifts by'):
        found = simulate(scene, duration=300.0)
    assert all('step_size' not in alarm.message for alarm in found.alarms)


@pytest.mark.parametrize('name, tolerance, duration', [
    ('exact_harmonic_oscillator', 1e-3, 1000.0), ('exact_pendulum', 1e-3, 60.0),
    ('exact_pendulum', 1e-6, 60.0), ('kepler', 1e-3, 60.0), ('kepler', 1e-8, 200.0),
    ('learned_kepler', 1e-4, 60.0)])
def test_phase_that_the_drift_of_the_energy_of_dop853_shifts_is_told(
        name, tolerance, duration):
    """A run that is off by a tenth of its amplitude says so, one by a fortieth does not."""
    scene, runs = load_scene(name), []
    for size in (tolerance, 1e-12):
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', AlarmWarning)
            runs.append(simulate(scene.changed({'integrator': {
                'kind': 'dop853', 'relative_tolerance': size, 'absolute_tolerance': size}}),
                duration))
    loose, exact = runs
    off = np.abs(loose.q - exact.q).max() / (0.5 * np.ptp(exact.q, axis=0).max())
    assert off < 0.025 or off > 0.1
    told = loose.path_error
    assert (told.largest > 0.1) == (off > 0.1)
    # Later than ten turns it is told, and raises no alarm.
    assert ('path not resolved' in [alarm.kind for alarm in loose.alarms]) == (
        told.until(0.1) < told.needed)
    assert not exact.alarms


@pytest.mark.parametrize('tolerance', [1e-2, 1e-5])
def test_dop853_repeats_steps_of_half_the_size_within_tolerances_that_are_smaller_alike(tolerance):
    """With the same tolerances internal steps would be the same: no error would be seen."""
    simulation, times = run('pendulum', tolerance, 0.1), np.linspace(0.0, 3.0, 31)
    exact = dop853_path(simulation.hamiltonian, [1.5], [0.0], times, 1e-12, 1e-13)[1:]
    first, second = (np.hstack(simulation.probe.trial(simulation.row, 0.1 / parts, 30, parts))
                     for parts in (1, 2))
    # By 2^-8, up to the factors between an error and its tolerance.
    assert np.abs(second - exact).max() < 0.1 * np.abs(first - exact).max()
    assert np.array_equal(simulation.q, [1.5]) and simulation.internal_steps[0] == 0
    assert np.array_equal(first, np.hstack(simulation.record(30, 1)))


def test_few_steps_that_stability_limits_raise_no_alarm():
    simulation = plain_run('pendulum', Dop853(1e-6, 1e-6), 0.1, [0.4], [0.0])
    watch = Watch(RunFacts(simulation), (StabilityGuard,))
    simulation.advance(200)
    for limited, kinds in ((1, []), (10, []), (11, ['stiff'])):
        simulation._memories[0][0].kept.tally[2] = limited
        watch.update(look(simulation))
        assert [alarm.kind for alarm in watch.alarms] == kinds
