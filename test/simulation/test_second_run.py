# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Each run knows the error of its path, from other runs with other steps."""

import re
import warnings

from helpers import plain_run
from hnn_vi_ros import load_scene, Scene, simulate, simulate_many
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import build, PathReport, second_run, Simulation
from hnn_vi_ros.simulation.trajectory import many
import numpy as np
import pytest
from scene_files import FAILING

KIND = 'path not resolved'
# One step of the reference of order 16, of whose multiples the others are.
FINE, END = 0.004, 20.16
# With a step of the size, its phase is h^2 / 12 t off.
OSCILLATOR = Scene.build(hamiltonian={'kind': 'harmonic_oscillator'}, step_size=0.02,
                         integrator='implicit_midpoint', initial_state=([1.0], [0.0]))
PUSHED = Scene.build(
    hamiltonian={'kind': 'pendulum'}, integrator='implicit_midpoint', step_size=0.05,
    initial_state=([0.5], [0.0]), effects=[
        {'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 100.0}])


def orbit(method: object = 'implicit_midpoint', step_size: float = 0.02) -> Scene:
    """Return an orbit of eccentricity 0.7 with drag."""
    return Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x', 'y'],
                     'H': '(p_x^2 + p_y^2) / 2 - 1 / sqrt(x^2 + y^2)'},
        integrator=method, step_size=step_size,
        initial_state=([0.3, 0.0], [0.0, 2.3804761428476167]),
        effects=[{'kind': 'damping', 'rate': 0.01}])


@pytest.fixture(scope='module')
def path() -> np.ndarray:
    return simulate(orbit('gauss16', FINE), END, path_error='off').q


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        yield


@pytest.fixture
def others(monkeypatch) -> list[tuple[float, float]]:
    """Return the step sizes and tolerances of the runs beside a run, relative to its own."""
    taken, sibling = [], Simulation.sibling

    def counted(simulation: Simulation, steps: float = 1.0, tolerances: float = 1.0):
        taken.append((steps, tolerances))
        return sibling(simulation, steps, tolerances)
    monkeypatch.setattr(Simulation, 'sibling', counted)
    return taken


def error_of(run, path: np.ndarray) -> float:
    """Return the true error of a path over its amplitude."""
    finer = path[::round(run.t[1] / FINE)][:len(run.q)]
    return float(np.max(np.abs(run.q - finer) / (0.5 * np.ptp(path, axis=0))))


@pytest.mark.parametrize('method, h', [
    ('variational_euler', 0.004), ('implicit_midpoint', 0.008), ('gauss4', 0.08),
    ('gauss8', 0.18)], ids=['order 1', 'order 2', 'order 4', 'order 8'])
def test_estimate_is_right_within_a_factor_of_two(path, others, method, h):
    run = simulate(orbit(method, h), END)
    error, told = error_of(run, path), run.path_error
    assert told.estimated and len(others) == 2
    assert 0.01 < error < 0.5 and 0.5 < told.largest / error < 2.0
    assert told.t[-1] == pytest.approx(END, abs=13.0 * h) and np.isnan(told.chaotic)
    assert f'{100.0 * told.largest:.2g} % of the amplitude' in str(told) and str(told) in repr(run)


@pytest.mark.parametrize('method, h', [
    ('rk4', 0.012), ('gauss4', 0.02), ('gauss8', 0.072)])
def test_bound_holds_and_saves_the_third_run(path, others, method, h):
    run = simulate(orbit(method, h), END)
    assert not run.path_error.estimated and not run.alarms
    assert others == [(13.0 / 8.0, 1.0)]
    assert error_of(run, path) <= run.path_error.largest < 0.01
    assert str(run.path_error).startswith('path error below ')


@pytest.mark.parametrize('scene, more, steps', [
    (orbit(), {'duration': 2.0}, [0.5]),
    (PUSHED, {'duration': 20.0, 'commands': lambda t: [0.1]}, [0.5]),
    (orbit(), {'duration': 2.1}, [13.0 / 8.0, 8.0 / 13.0])], ids=['short', 'commands', 'others'])
def test_runs_that_are_short_or_commanded_are_repeated_with_half_the_step(
        scene, more, steps, others):
    told = simulate(scene, **more).path_error
    assert [step for step, _ in others[:len(steps)]] == steps and len(told.t) > 1


def test_adaptive_methods_are_repeated_with_other_tolerances(path, others):
    method = {'kind': 'dop853', 'relative_tolerance': 3e-4, 'absolute_tolerance': 3e-7}
    run = simulate(orbit(method, 0.02), END)
    assert others == [(1.0, 32.0), (1.0, 1.0 / 32.0)]
    # The exponent of a tolerance is seen at large distances only.
    assert 0.2 < run.path_error.largest / error_of(run, path) < 5.0


def test_rotations_are_compared_by_their_angles():
    run, finer = (simulate(load_scene('heavy_top'), 4.0, step_size=h, every=every)
                  for h, every in ((0.02, 1), (0.002, 10)))
    angles = 2.0 * np.arccos(np.minimum(np.abs((run.q * finer.q).sum(axis=1)), 1.0))
    around = 2.0 * np.arccos(np.minimum(np.abs((run.q * run.q[:1]).sum(axis=1)), 1.0))
    error, told = angles.max() / around.max(), run.path_error
    assert told.largest >= 0.5 * error > 1e-5
    assert not told.estimated or told.largest < 2.0 * error


@pytest.mark.parametrize('period', [None, 0.0])
def test_second_run_leaves_no_trace_and_threads_change_no_result(period):
    simulation, report = build(orbit()), PathReport()
    report.follow(simulation, 1008, period)
    q, _ = simulation.record(1008, 1)
    alarms = [alarm for _, alarm in report.finish()]
    expected = simulate(orbit(), END)
    assert np.array_equal(q, simulate(orbit(), END, path_error='off').q[1:])
    assert alarms == [alarm for alarm in expected.alarms if alarm.kind == KIND] != []
    (found,) = report.errors()
    assert np.array_equal(found.t, expected.path_error.t)
    assert np.array_equal(found.value, expected.path_error.value)


def test_alarms_do_not_depend_on_when_a_rescue_is_compiled():
    """Here the second run needs one in its first steps, the run itself does not."""
    found = []
    for ready in (True, False):
        simulation, report = plain_run('tao', 'generalized_leapfrog', 0.35, [1.6], [0.0]), \
            PathReport()
        simulation.rescue_ready = ready
        report.follow(simulation, period=0.0)
        simulation.record(600, 1)
        found.append(([alarm for _, alarm in report.finish()], report.errors()[0]))
        assert simulation.rescued == 0
    (expected, error), (alarms, other) = found
    assert alarms == expected != []
    assert np.array_equal(other.value, error.value)


@pytest.mark.parametrize('how', ['restart', 'restore', 'restart at a step'])
def test_comparison_begins_anew_where_the_state_is_replaced(how):
    simulation, report = build(OSCILLATOR), PathReport()
    report.follow(simulation, period=None)
    simulation.record(150, 1)
    snapshot = simulation.snapshot()
    simulation.record(150, 1)
    if how == 'restore':
        simulation.restore(snapshot)
    else:
        simulation.restart([0.0], [5.0], step=300 if 'step' in how else 0)
    simulation.record(600, 1)
    assert report.finish() == []
    assert report.errors()[0].largest < 0.01


@pytest.mark.parametrize('name, reason', [
    ('exact_brownian_oscillator', 'noise'), ('stepwise_pendulum', 'method and step size')])
def test_runs_that_cannot_be_repeated_say_why(name, reason):
    run = simulate(load_scene(name), 1.0)
    assert reason in run.path_error.reason and reason in repr(run)
    assert not len(run.path_error.t) and np.isnan(run.path_error.largest)


def test_run_whose_path_error_is_off_is_taken_once(others):
    run = simulate(OSCILLATOR.changed({'path_error': 'off'}), 10.0)
    assert others == [] and 'path error' not in repr(run)
    assert simulate(OSCILLATOR, 1.0, path_error='off').path_error.reason == 'path_error is off'


def rows(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(0.5, 2.0, count)[:, None], np.zeros((count, 1))


def test_each_trajectory_of_a_batch_knows_its_error():
    q, p = rows(3)
    scene = load_scene('exact_pendulum').with_overrides(0.06, 'implicit_midpoint')
    found = simulate_many(scene, q, p, 30.0, samples=500)
    for k in range(3):
        alone = simulate(scene, 30.0, initial_state=(q[k], p[k]))
        # Steps of a batch are solved until all trajectories have converged.
        assert found.path_error[k].largest == pytest.approx(alone.path_error.largest, rel=1e-6)
        assert found.select(k).path_error is found.path_error[k]
    assert 'in the worst of 3 trajectories' in repr(found)


def test_a_sample_of_a_large_batch_is_measured(monkeypatch):
    monkeypatch.setattr(many, 'MAX_MEASURED_STEPS', 6000)
    q, p = rows(64)
    found = simulate_many(OSCILLATOR, q, p, 2.4, samples=1)
    measured = [k for k, told in enumerate(found.path_error) if not told.reason]
    # 32 are drawn; the first and the last are the extremes of energy, speed and distance.
    assert {0, 63} <= set(measured) and 32 <= len(measured) <= 34
    other = next(told for told in found.path_error if told.reason)
    assert f'{len(measured)} of 64 trajectories' in other.reason


def test_trajectories_with_commands_know_the_errors_of_simulate():
    q, p, commands = *rows(2), np.random.default_rng(1).uniform(-1.0, 1.0, (2, 40, 1))
    found = simulate_many(PUSHED, q, p, 20.0, samples=40, commands=commands)
    for k in range(2):
        alone = simulate(PUSHED, 20.0, initial_state=(q[k], p[k]), every=10,
                         commands=commands[k])
        assert found.path_error[k].largest == alone.path_error.largest > 0.0


def test_later_stretches_find_what_the_first_cannot(monkeypatch):
    """The frequency grows tenfold: the last steps are too long."""
    monkeypatch.setattr(second_run, '_MAX_STEPS', 200)
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'coordinates': ['x'],
                     'H': 'p_x^2 / 2 + (1 + 99 * t / 40) * x^2 / 2'},
        integrator='implicit_midpoint', step_size=0.04, initial_state=([1.0], [0.0]))
    run = simulate(scene, 40.0)
    first = next(alarm for alarm in run.alarms if alarm.kind == KIND)
    assert first.step > 400 and run.path_error.t[-1] <= 8.0


def test_coarser_run_that_fails_leaves_the_finer_one(monkeypatch):
    sibling = Simulation.sibling

    def failing(simulation: Simulation, steps: float = 1.0, tolerances: float = 1.0):
        other = sibling(simulation, steps, tolerances)
        if steps > 1.0:
            def record(n: int, every: int):
                raise StepFailure('no convergence', 0.0, 0.1, 1.0, 1, 'use a smaller step')
            other.record = record
        return other
    monkeypatch.setattr(Simulation, 'sibling', failing)
    run = simulate(OSCILLATOR, 10.0)
    assert run.alarms == () and run.path_error.estimated
    # Without the second run the order is not seen: h^2 / 12 t, overestimated as order 1/2.
    assert 1.0 < run.path_error.largest / (0.02**2 / 12.0 * 10.0) < 10.0


def test_failure_of_a_step_is_raised_where_no_step_of_a_block_succeeded(tmp_path):
    """A node takes few steps at a time."""
    (tmp_path / 'scene.yaml').write_text(FAILING)
    simulation, report = build(load_scene(tmp_path / 'scene.yaml')), PathReport()
    report.follow(simulation, period=None)
    with pytest.raises(StepFailure):
        for _ in range(100):
            simulation.advance(1)
    assert len(report.finish()) <= 1


def test_chaos_is_told_and_raises_no_alarm():
    run = simulate(load_scene('exact_double_pendulum'), 20.0, step_size=0.01,
                   integrator='gauss4', initial_state=([2.5, 2.0], [0.0, 0.0]))
    assert str(run.path_error).startswith('chaotic: the path error doubles every ')
    assert KIND not in [alarm.kind for alarm in run.alarms]
    assert 0.05 < run.path_error.chaotic < 2.0


@pytest.mark.parametrize('h, told', [(0.1, False), (0.15, True)])
def test_path_must_be_kept_for_ten_turns(h, told):
    """The phase is off by h^2 / 12 t: by 5 % and 12 % after ten turns, beyond 10 % at the end."""
    run = simulate(OSCILLATOR, 200.0, step_size=h)
    assert (KIND in [alarm.kind for alarm in run.alarms]) == told
    assert run.path_error.largest > 0.1 and 62.0 < run.path_error.needed < 65.0
    assert run.path_error.until(0.1) == pytest.approx(1.2 / h**2, rel=0.1)


@pytest.mark.parametrize('h, until, told', [(0.1, 150.0, True), (0.15, 40.0, False)])
def test_path_must_be_kept_for_the_time_of_the_scene(h, until, told):
    run = simulate(OSCILLATOR.changed({'path_tolerance': until}), 200.0, step_size=h)
    assert (KIND in [alarm.kind for alarm in run.alarms]) == told
    assert run.path_error.needed == until
    chaotic = simulate('exact_double_pendulum', 20.0, initial_state={
        'q': [2.5, 2.0], 'p': [0.0, 0.0]}, integrator='gauss4')
    assert KIND not in [alarm.kind for alarm in chaotic.alarms]
    kept = simulate(chaotic.scene.changed({'path_tolerance': 20.0}), 20.0)
    assert KIND in [alarm.kind for alarm in kept.alarms]


@pytest.mark.parametrize('method, h', [
    ('implicit_midpoint', 0.03), ('gauss4', 0.112), ('variational_euler', 0.012)])
def test_step_size_that_the_alarm_recommends_resolves_the_run(method, h):
    (alarm,) = [alarm for alarm in simulate(orbit(method, h), END).alarms if alarm.kind == KIND]
    step_size = float(re.search(r'use step_size (\S+),', alarm.message)[1])
    assert step_size < h
    run = simulate(orbit(method, step_size), END)
    assert KIND not in [alarm.kind for alarm in run.alarms] and run.path_error.largest < 0.1
