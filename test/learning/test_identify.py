# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of scenes from measured motions: what is found, how sure it is, and what is not told."""

from collections.abc import Sequence
from dataclasses import replace
import json
from pathlib import Path
import shutil

from helpers import long, mostly_long
import hnn_vi_ros
from hnn_vi_ros.errors import HnnViRosError, ModelError, SceneError
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.identify.free_numbers import edited, free_scene, FreeScene
from hnn_vi_ros.identify.identify import main
from hnn_vi_ros.identify.intervals import Estimates, estimates_of, profile
from hnn_vi_ros.learning import (
    DELAY, evaluate, EvenMotion, fit_numbers, FitProblem, LogSimulation, ModelParts, Prediction,
    processes, steps_between, Windows)
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.fit.shooting import _INNER
from hnn_vi_ros.learning.fit.windows import CannotFollow, cut_windows
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, difference, DifferentiableRun, Trajectory
from hnn_vi_ros.sweeps import running as sweep
from messages import refused
import numpy as np
import pytest
from python_process import run_code
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import chi2
from studies import identify_coverage
from urdf_robots import ROOT, TREE

NOISE = 0.01, 0.05


def measured(scene: Scene, motion: Trajectory, tau: np.ndarray | None = None,
             random: np.random.Generator | None = None, noise: tuple[float, float] = NOISE
             ) -> EvenMotion:
    """Return the log of a motion of a scene, with forces and with white noise, if any."""
    q, v = motion.q, scene.create_hamiltonian().gradient(motion.q, motion.p)[1]
    if random is not None:
        q, v = (part + size * random.normal(size=part.shape)
                for part, size in zip((q, v), noise, strict=True))
    return smoothed('log', motion.t, q, v, np.zeros_like(q) if tau is None else tau, 40.0)


def swing(scene: Scene, duration: float, every: int, seed: int | None = 0) -> EvenMotion:
    """Return a log of a scene from its initial state, with white noise unless without a seed."""
    return measured(scene, hnn_vi_ros.simulate(scene, duration, every=every),
                    random=None if seed is None else np.random.default_rng(seed))


def freed(scene: Scene, folder: Path, **starts: float) -> FreeScene:
    """Return a scene with numbers free, and where the search begins."""
    names = [name.replace('__', '.') for name in starts]
    return free_scene(scene.parts(), names, {}, folder, True).starting_at([*starts.values()])


def estimated(free: FreeScene, motion: EvenMotion, robust: bool = False,
              horizon: float | None = None) -> Estimates:
    found = fit_numbers([free], [motion], horizon, robust)
    return estimates_of(found.solution, found.problem, free, (), False)


@pytest.fixture(scope='module')
def pendulum() -> Scene:
    return load_scene('exact_pendulum')


@pytest.mark.long
def test_intervals_hold_the_truth_as_often_as_they_say(pendulum, tmp_path):
    # Errors in units of the standard error: their squares sum to chi squared of so many logs,
    # which is outside of these bounds once in a thousand.
    logs = 20
    errors = []
    for seed in range(logs):
        one, = estimated(freed(pendulum, tmp_path, length=1.03), swing(pendulum, 2.0, 4, seed)
                         ).estimates
        errors.append((one.value - 1.0) / one.standard_error)
    low, high = chi2.ppf([0.0005, 0.9995], logs)
    assert low < np.sum(np.square(errors)) < high
    # Binomial: more than five of 20 are missed by chance once in a thousand.
    assert np.sum(np.abs(errors) > 1.96) <= 5


@pytest.mark.long
@pytest.mark.parametrize('case', identify_coverage.CASES, ids=lambda case: case.name)
def test_the_study_of_coverage_finds_what_made_its_logs(case):
    # All intervals of a log miss once in some hundreds: their errors share data.
    assert any(next(identify_coverage.held(case, 'white', 1, 3)))


@pytest.mark.parametrize('name, numbers', [
    long('exact_double_pendulum', {'mass2': 1.1, 'damping__rate': 0.4,
                                   'quadratic_drag__coefficient': 0.1}),
    long('exact_double_pendulum', {'mass2': 1.1, 'length2': 0.9}),
    long('two_joint_arm', {'forearm__mass': 1.1})])
def test_exact_tangents_are_differences_of_simulations(name, numbers, tmp_path, monkeypatch):
    scene = load_scene(name)
    if 'damping__rate' in numbers:
        scene = scene.changed({'effects': [{'kind': 'damping', 'rate': 0.3}, {
            'kind': 'quadratic_drag', 'coordinates': ['angle1'], 'coefficient': 0.2}]})
    free = freed(scene, tmp_path, **numbers)
    values = np.array([*numbers.values()])
    windows = cut_windows([swing(scene, 0.5, 5)], 0.3)
    assert_exact_slopes(free, values, windows, scene.initial_state.q, monkeypatch)


def assert_exact_slopes(free: FreeScene, values: np.ndarray, windows: Windows, q: Sequence[float],
                        monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Compare derivatives with differences of simulations, and return them."""
    starts = np.tile([*q, 0.3, -0.2], (len(windows.run), 1))

    def slopes() -> list[np.ndarray]:
        prediction = Prediction(free, values, windows)
        return [*prediction.by_starts(starts), prediction.parameter_jacobian(starts)]
    exact = slopes()
    assert Prediction(free, values, windows)._run is not None
    monkeypatch.setattr(Prediction, '_run', None)
    for one, other in zip(exact, slopes(), strict=True):
        assert np.isfinite(one).all()
        # Differences lose two thirds of the digits, and some more by the motion's growth and where
        # they are one-sided, at zero.
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max())
    return exact


def test_exact_tangents_of_driven_windows_are_differences_of_simulations(tmp_path, monkeypatch):
    """Each window begins at a time of its own, with the forces that were measured from there."""
    scene = Scene.build(
        hamiltonian='double_pendulum', integrator='implicit_midpoint', step_size=0.01,
        initial_state=([0.5, -0.3], [0.0, 0.0]), effects=[
            {'kind': 'damping', 'rate': 0.3},
            {'kind': 'joint_friction', 'friction': {'angle2': 0.0}, 'damping': {'angle1': 0.2},
             'speed': 0.5},
            {'kind': 'periodic_drive', 'coordinate': 'angle1', 'amplitude': 2.0,
             'frequency': 1.3},
            {'kind': 'external_force', 'coordinates': ['angle2'], 'timeout': 10.0,
             'gain': [1.3], 'offset': 0.2}])
    t = 0.02 * np.arange(31)
    force = 3.0 * np.sin(9.0 * t)[:, None]
    log = smoothed('one', t, np.zeros((31, 2)), np.zeros((31, 2)), force, 40.0)
    late = replace(log, name='two', t=t + 0.4, tau=force[::-1])
    names = ('mass2', 'damping.rate', 'joint_friction.friction.angle2',
             'periodic_drive.frequency', 'external_force.gain.0', 'external_force.offset', DELAY)
    free = free_scene(scene.parts(), names, {DELAY: (0.0, 0.1)}, tmp_path, True)
    values = np.array([number.start for number in free.numbers])
    windows = cut_windows([log, late], 0.3)
    exact = assert_exact_slopes(free, values, windows, [0.5, -0.3], monkeypatch)
    # Windows differ by their forces and by the phase of the drive.
    assert len(np.unique(exact[0][:, 5, 1])) == len(windows.run) == 4


@pytest.mark.parametrize('value', [0.0, 1e-9, 0.5, 1.0])
def test_differences_keep_within_a_range_and_are_of_order_two(value):
    points = difference(value, 1e-5, 0.0, 1.0)
    assert all(0.0 <= other <= 1.0 for other, _ in points)
    # What is cut off is 1e-10 of the third derivative, and rounding some 1e-11.
    assert sum(weight * np.exp(other) for other, weight in points) == pytest.approx(
        np.exp(value), rel=1e-9)


@pytest.mark.parametrize('start', [0.2, 0.0])
def test_number_that_has_all_but_vanished_has_the_slope_of_zero(start, pendulum, tmp_path):
    scene = pendulum.changed({'effects': [{
        'kind': 'joint_friction', 'damping': {'angle': 0.1}, 'friction': {'angle': start},
        'speed': 0.5}]})
    free = free_scene(scene.parts(), ['joint_friction.friction.angle'], {}, tmp_path, False)
    windows = cut_windows([swing(pendulum, 0.2, 4)], 0.2)
    starts = np.tile([0.5, 0.1], (len(windows.run), 1))
    tiny, zero = (Prediction(free, np.array([value]), windows).parameter_jacobian(starts)
                  for value in (1e-21, 0.0))
    np.testing.assert_allclose(tiny, zero, atol=1e-9 * np.abs(zero).max())


@pytest.mark.parametrize('inputs', ['held', 'linear'])
def test_each_step_of_a_long_window_gets_the_force_of_its_time(inputs, pendulum, tmp_path):
    # Sums of intervals are off by 1e-8 of one after some thousands of them.
    spacing, u = 0.0016384043, np.random.default_rng(0).normal(size=(30000, 1))
    t = spacing * np.arange(len(u))
    scene = pendulum.changed({'step_size': spacing, 'effects': [
        {'kind': 'external_force', 'coordinates': ['angle']}]})
    windows = cut_windows([replace(smoothed('log', t, np.sin(t)[:, None], None, u, 40.0),
                                   inputs=inputs)], 60.0)
    forces = Prediction(freed(scene, tmp_path, length=1.0), np.ones(1), windows).log.forces[0]
    means = u[:-1] if inputs == 'held' else 0.5 * (u[1:] + u[:-1])
    # Of a linear force, the slopes at both ends are added: h / 12 times their difference.
    bound = 0.0 if inputs == 'held' else np.abs(np.diff(u, 2, axis=0)).max() / 6.0
    assert np.abs(forces - means).max() <= bound


@pytest.mark.parametrize('refuses', [-1.0, 1.0, 0.0])
def test_slope_beside_values_that_a_model_refuses_is_that_of_the_other_side(
        refuses, pendulum, tmp_path, monkeypatch):
    free = freed(pendulum, tmp_path, length=1.0)
    windows = cut_windows([swing(pendulum, 0.2, 4)], 0.2)
    starts = np.tile([0.5, 0.1], (len(windows.run), 1))
    whole = Prediction(free, np.ones(1), windows).parameter_jacobian(starts)
    usual = FreeScene.parts_at

    def parts_at(model: FreeScene, values: np.ndarray) -> ModelParts:
        beside = values[0] - 1.0
        if refuses * beside > 0.0 or (not refuses and beside):
            raise ModelError('the mass matrix is not positive definite')
        return usual(model, values)
    monkeypatch.setattr(FreeScene, 'parts_at', parts_at)
    edge = Prediction(free, np.ones(1), windows)
    if not refuses:
        with refused(CannotFollow):
            edge.parameter_jacobian(starts)
        return
    # Differences of order 2 with a spacing of 6e-6: 4e-11, and rounding of 1e-16 over it.
    np.testing.assert_allclose(edge.parameter_jacobian(starts), whole,
                               atol=1e-9 * np.abs(whole).max())


def test_one_window_that_fails_leaves_the_others(pendulum, tmp_path):
    free = freed(pendulum, tmp_path, length=1.0)
    windows = cut_windows([swing(pendulum, 0.4, 4)], 0.1)
    starts = np.tile([0.5, 0.1], (len(windows.run), 1))
    whole = Prediction(free, np.ones(1), windows).by_starts(starts)
    starts[1] = np.inf
    for one, other in zip(Prediction(free, np.ones(1), windows).by_starts(starts), whole,
                          strict=True):
        assert np.isnan(one[1]).all()
        assert np.array_equal(np.delete(one, 1, axis=0), np.delete(other, 1, axis=0))


def test_mistake_in_the_derivatives_of_windows_is_no_window_that_fails(
        pendulum, tmp_path, monkeypatch):
    free = freed(pendulum, tmp_path, length=1.0)
    windows = cut_windows([swing(pendulum, 0.4, 4)], 0.1)
    monkeypatch.setattr(DifferentiableRun, 'push_forward', lambda run, changes: np.zeros(2) @ [1])
    with pytest.raises(ValueError, match='matmul'):
        Prediction(free, np.ones(1), windows).by_starts(
            np.tile([0.5, 0.1], (len(windows.run), 1)))


def test_what_no_data_tell_has_no_interval(pendulum, tmp_path):
    # Of a free pendulum only g / l shows: neither the mass, nor one of the two by itself.
    found = estimated(freed(pendulum, tmp_path, mass=1.2, length=1.0, gravity=9.5),
                      swing(pendulum, 2.0, 4))
    assert [one.known for one in found.estimates] == [False] * 3
    assert sorted(map(sorted, found.unknown)) == [['gravity', 'length'], ['mass']]
    length, gravity = (found.estimates[k].value for k in (1, 2))
    assert gravity / length == pytest.approx(9.81, rel=0.01)


def test_number_that_no_data_tell_has_no_interval_beside_one_that_is_next_to_zero(tmp_path):
    """A change of 1e-12 1/s is a large part of a rate of 1e-19 1/s, but not of a motion."""
    scene = load_scene('exact_pendulum').with_overrides(effects=[{'kind': 'damping', 'rate': 0.2}])
    log = swing(scene, 2.0, 4)
    # Backwards it gains energy: the rate ends next to its bound.
    log = smoothed('log', log.t, log.q[::-1], -log.v[::-1], log.tau, 40.0)
    found = estimated(freed(scene, tmp_path, mass=0.7, length=1.1, damping__rate=0.2), log)
    mass, length, damping = found.estimates
    assert 0.0 < damping.value < 1e-9
    assert not mass.known and length.known and damping.known
    assert [sorted(direction) for direction in found.unknown] == [['mass']]
    assert not any('mass' in pair for pair in found.correlated)


@pytest.mark.parametrize('kind, starts, unknown', [
    # Coordinates and velocities show k / m alone.
    ('oscillator', {'mass': 1.1, 'stiffness': 3.9}, {'mass', 'stiffness'}),
    # At rest nothing shows.
    ('rest', {'mass': 1.1, 'stiffness': 3.9}, {'mass', 'stiffness'}),
    # Two springs that pull in parallel are one.
    ('springs', {'spring__0__stiffness': 1.0, 'spring__1__stiffness': 1e-9,
                 'damping__rate': 1e-15}, {'spring.0.stiffness', 'spring.1.stiffness'})])
def test_every_degeneracy_leaves_its_numbers_without_an_interval(kind, starts, unknown, tmp_path):
    springs = [{'kind': 'spring', 'point': ['x'], 'anchor': [0.0], 'stiffness': stiffness}
               for stiffness in (1.0, 1.0)]
    scene = Scene.build(
        hamiltonian={'kind': 'harmonic_oscillator', 'mass': 1.0, 'stiffness': 4.0},
        effects=[*springs * (kind == 'springs'), {'kind': 'damping', 'rate': 0.05}],
        integrator='implicit_midpoint', step_size=0.01,
        initial_state=([0.0 if kind == 'rest' else 1.0], [0.0]))
    log = swing(scene, 4.0, 4)
    estimates = estimated(freed(scene, tmp_path, **starts), log).estimates
    assert {one.name for one in estimates if not one.known} >= unknown
    for one in estimates:
        assert one.known == (one.low is not None) and not (one.known and one.low == one.high)


def test_numbers_that_no_data_tell_stay_where_the_search_begins(pendulum, tmp_path):
    free = freed(pendulum, tmp_path, mass=1.2, length=1.05)
    solution = fit_numbers([free], [swing(pendulum, 1.0, 4)], None, False).solution
    # Along the mass there is rounding alone, which once led to some 1e17 kg.
    assert solution.values[0] == pytest.approx(1.2, rel=1e-6)
    assert solution.values[1] == pytest.approx(1.0, rel=0.02)


def test_delay_and_friction_of_a_driven_pendulum_are_found(tmp_path):
    late, rate, dt = 0.043, 0.3, 0.02
    scene = commanded('implicit_midpoint', 0.01)

    def force(t: np.ndarray) -> np.ndarray:
        return 3.0 * np.sin(3.0 * t + 0.7 * t**2)
    # Of the mean of a force over a step its value in the middle is wrong by h^2 / 24 of F''.
    motion = hnn_vi_ros.simulate(
        scene, 4.0, every=2, commands=lambda t: [float(force(np.array(t + 0.005 - late)))])
    log = measured(scene, motion, force(motion.t)[:, None])
    found = estimated(freed(scene, tmp_path, input_delay=0.0, damping__rate=0.2, mass=1.1), log)
    delay, damping, mass = (one.value for one in found.estimates)
    # Between samples the force is taken for straight: dt^2 / 12 of F'', at most 3 N m * 8.6^2.
    assert delay == pytest.approx(late, abs=dt**2)
    assert damping == pytest.approx(rate, rel=0.01)
    assert mass == pytest.approx(1.0, rel=0.01)


def test_windows_of_a_time_in_h_begin_at_their_times_and_have_the_energies_of_a_run(tmp_path):
    scene = load_scene('driven_duffing')
    run = hnn_vi_ros.simulate(scene, 1.0, every=10, energy_by_cause=True)
    parts = freed(scene, tmp_path, parameters__F=0.37).parts_at([0.37])
    states = np.hstack([run.q, run.p])
    log = LogSimulation(parts, cut_windows([measured(scene, run)], 0.4))
    first = log.windows.first
    assert len(first) > 1
    # The same steps; the clock of a window begins at a rounded time.
    for row, begin, found in zip(log.windows.there, first, log.states(states[first, None])[:, 0],
                                 strict=True):
        assert np.abs(found[row] - states[begin:begin + row.sum()]).max() < 1e-12
    whole = LogSimulation(parts, cut_windows([measured(scene, run)], 2.0))
    causes = dict(zip(run.energy_by_cause.names, run.energy_by_cause.values[-1], strict=True))
    assert whole.energies(states[:1]) == pytest.approx(
        {name: value for name, value in causes.items() if name.startswith(('work/', 'heat/'))},
        abs=1e-12)


def test_fit_takes_finer_steps_where_the_error_of_the_method_shows(tmp_path, capsys):
    t = np.arange(121) / 30.0
    q = solve_ivp(lambda t, z: [z[1], -9.81 / 1.13 * np.sin(z[0])], (0.0, 4.0), [1.1, 0.3],
                  'DOP853', t, rtol=1e-12, atol=1e-12).y[0]
    scene, said = tmp_path / 'scene.yaml', []
    scene.write_text('hamiltonian: {kind: pendulum}\nintegrator: {kind: implicit_midpoint}\n'
                     f'step_size: {1 / 30}\ninitial_state: {{q: [1.0], p: [0.0]}}\n')
    true = q + 5e-4 * np.random.default_rng(0).normal(size=121)
    own = hnn_vi_ros.simulate(load_scene(scene), 4.0).q[:, 0]
    for name, measured_q in (('true', true), ('own', own)):
        np.savez(tmp_path / f'{name}.npz', t=t, q=measured_q[:, None])
        main([str(scene), '--data', str(tmp_path / f'{name}.npz'), '--free', 'length', '--json',
              str(tmp_path / f'{name}.json'), '--write', str(tmp_path / f'fit_{name}.yaml')])
        said.append(capsys.readouterr().out)
    assert 'Fitted with a step size of' in said[0] and 'moves length by' in said[0]
    assert 'fits worse, as for data simulated' in said[1] and 'Fitted with' not in said[1]
    # At the step of the scene it was 1.1284, 30 standard errors off.
    found = json.loads((tmp_path / 'true.json').read_text())['length']
    assert found['low'] < 1.13 < found['high'] < found['low'] + 4e-4
    assert load_scene(tmp_path / 'fit_true.yaml').step_size < 0.25 / 30
    # A log of the scene's own steps without noise fits only these.
    assert load_scene(tmp_path / 'fit_own.yaml').step_size == 1 / 30


@pytest.mark.parametrize('seed', [0, long(4)])
def test_error_of_the_method_moves_no_number_by_a_third_of_a_standard_error(
        seed, tmp_path, capsys):
    """
    Fit a chaotic arm at 5 ms, which errs by up to 8.8 standard errors, and by a method of order 8.

    Half of the last step moves no number by more than 0.2 standard errors, and the smaller ones,
    of a method of order 2, by a third of that in total.
    """
    coarse, fine = (load_scene('two_joint_arm').with_overrides(0.005, method)
                    for method in ('implicit_midpoint', 'gauss8'))
    random = np.random.default_rng([7, seed])
    q = np.array(coarse.initial_state.q) + 0.3 * random.normal(size=2)
    motion = hnn_vi_ros.simulate(coarse.with_overrides(0.00125, 'gauss8'), 2.0, every=16,
                                 initial_state=(q.tolist(), [0.0, 0.0]))
    np.savez(tmp_path / 'log.npz', t=motion.t,
             q=motion.q + 0.002 * random.normal(size=motion.q.shape))
    shutil.copy(*coarse.model_files().values(), tmp_path)
    found = []
    for name, scene in (('coarse', coarse), ('fine', fine)):
        (tmp_path / f'{name}.yaml').write_text(scene.to_yaml().replace('../robots/', ''))
        main([str(tmp_path / f'{name}.yaml'), '--data', str(tmp_path / 'log.npz'), '--posterior',
              str(tmp_path / f'{name}.json'), '--free', 'forearm.mass', 'forearm.centre_z',
              'upper_arm.centre_z'])
        rows = json.loads((tmp_path / f'{name}.json').read_text())['parameters'].values()
        found.append(np.array([[row['value'], row['standard_error']] for row in rows]))
    assert 'Fitted with a step size of' in capsys.readouterr().out
    (values, errors), (exact, _) = (rows.T for rows in found)
    assert (abs(values - exact) <= 0.2 * (4.0 / 3.0 + 0.1) * errors).all()


@pytest.mark.parametrize('inputs, least', [long('linear', 2**3), ('spline', 2**4)])
def test_measured_forces_move_positions_to_order_3_or_4_in_the_step(inputs, least, tmp_path):
    t = 0.2 * np.arange(21)
    force = 3.0 * np.sin(2.0 * np.maximum(t - 1.0, 0.0))[:, None]**4
    log = replace(smoothed('log', t, np.zeros((21, 1)), None, force, 40.0), inputs=inputs)
    windows, found = cut_windows([log], 4.0), []
    for steps in (1, 2, 4, 64):
        free = freed(commanded('gauss8', 0.2 / steps), tmp_path, mass=1.0)
        found.append(Prediction(free, np.ones(1), windows).by_starts(np.array([[0.5, 0.0]]))[0])
    coarse, middle, fine = (abs(one - found[-1]).max() for one in found[:-1])
    # A linear course has kinks. By the mean of each step alone these were 2^2.
    assert min(coarse / middle, middle / fine) > 0.9 * least


def commanded(method: str, step_size: float) -> Scene:
    return Scene.build(
        hamiltonian='pendulum', integrator=method, step_size=step_size,
        initial_state=([0.5], [0.0]), effects=[
            {'kind': 'damping', 'rate': 0.3},
            {'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 10.0}])


LATE = 0.035


@pytest.fixture(scope='module')
def held_log() -> EvenMotion:
    """Return what a pendulum does by commands that are held for 80 ms and come 35 ms late."""
    scene = commanded('gauss4', 0.001)
    force = np.repeat(3.0 * np.random.default_rng(1).normal(size=21), 4)
    motion = hnn_vi_ros.simulate(scene, 1.6, every=20, commands=lambda t: [
        float(force[max(0, int((t - LATE) / 0.02 + 1e-6))])])
    return replace(measured(scene, motion, force[:81, None]), inputs='held')


# Late in a step, in its middle, and at its end; rk4 begins steps by a gradient of the last.
@pytest.mark.parametrize('method, step_size', [
    ('gauss4', 0.02), long('gauss4', 0.01), long('gauss4', 0.005), long('rk4', 0.005)])
def test_held_forces_act_from_the_moment_of_their_command_on(
        held_log, method, step_size, tmp_path):
    free = freed(commanded(method, step_size), tmp_path, input_delay=0.03, mass=1.05)
    delay, mass = (one.value for one in estimated(free, held_log).estimates)
    # Of steps of order 4, (5 h)^4 / 720 of the motion and less; by means over steps, some 1e-4.
    assert mass == pytest.approx(1.0, abs=2e-6)
    assert delay == pytest.approx(LATE, abs=1e-7)


def identified(folder: Path, log: EvenMotion, capsys: pytest.CaptureFixture, *options: str
               ) -> tuple[str, dict]:
    """Return what is said of the delay and the damping of such a pendulum, and the numbers."""
    np.savez(folder / 'log.npz', t=log.t, q=log.q, dq=log.v, tau=log.tau)
    (folder / 'scene.yaml').write_text(
        'hamiltonian: {kind: pendulum}\nintegrator: {kind: gauss4}\nstep_size: 0.02\n'
        'effects: [{kind: external_force, coordinates: [angle]}, {kind: damping, rate: 0.2}]\n'
        'initial_state: {q: [0.5], p: [0.0]}\n')
    path = folder / f'{len(options)}.json'
    free = [] if '--free' in options else [
        '--free', *(['input_delay'] if log.tau.any() else []), 'damping.rate']
    main([str(folder / 'scene.yaml'), '--data', str(folder / 'log.npz'), *free,
          '--json', str(path), *options])
    return capsys.readouterr().out, json.loads(path.read_text())


@pytest.mark.parametrize('missing', [True, False])
def test_log_without_the_force_that_an_effect_takes_says_so(missing, held_log, tmp_path, capsys):
    log = replace(held_log, tau=0.0 * held_log.tau) if missing else held_log
    said, _ = identified(tmp_path, log, capsys)
    assert ('no column of a force' in said and 'angle_force' in said) is missing
    assert 'Energy in the windows, by the fitted scene: work of external_force ' in said


def test_way_of_forces_between_samples_is_told_and_tested(held_log, tmp_path, capsys):
    random = np.random.default_rng(0)
    q, v = (part + noise * random.normal(size=part.shape)
            for part, noise in zip((held_log.q, held_log.v), (1e-4, 1e-3), strict=True))
    log = replace(held_log, q=q, v=v)
    said, found = identified(tmp_path, log, capsys)
    # Interpolated forces come half of a sample earlier.
    assert found['input_delay']['low'] > LATE + 0.005
    assert 'taken as linear, which the data do not specify; as held they fit better' in said
    assert 'use --inputs held' in said
    said, found = identified(tmp_path, log, capsys, '--inputs', 'held')
    assert found['input_delay']['low'] < LATE < found['input_delay']['high']
    assert 'Forces between samples are taken as held; as linear they fit worse' in said
    assert 'as spline they fit worse' in said


@pytest.mark.parametrize('unit, told', [(1.0, False), (1e3, True), (1e-3, True)])
def test_efforts_in_newton_millimetres_are_named_as_a_cause(held_log, unit, told, tmp_path,
                                                            capsys):
    log = replace(held_log, tau=unit * held_log.tau)
    said, _ = identified(tmp_path, log, capsys, '--inputs', 'held', '--free', 'mass')
    assert ('N mm' in said) == told


@pytest.mark.parametrize('idle', [True, False])
def test_what_acted_before_a_record_is_found_with_the_delay(idle, tmp_path, capsys):
    late, random, scene = 0.06, np.random.default_rng(3), commanded('gauss4', 0.01)
    force = np.repeat(3.0 * random.normal(size=25), 4)
    force[:4] = 4.0
    motion = hnn_vi_ros.simulate(scene, 1.98, every=2, commands=lambda t: [
        0.0 if idle and t < late - 1e-9 else
        float(force[max(0, int((t - late) / 0.02 + 1e-6))])])
    log = measured(scene, motion, force[:len(motion.t), None], random, (1e-4, 1e-3))
    said, found = identified(tmp_path, log, capsys, '--inputs', 'held')
    assert f'Assumed before each run: {"no" if idle else "the first recorded"} force' in said
    for name, truth in (('input_delay', late), ('damping.rate', 0.3)):
        assert found[name]['low'] < truth < found[name]['high']
        assert found[name]['high'] - found[name]['low'] < 0.02


def two_masses(folder: Path, stiffness: float) -> tuple[str, ...]:
    """Write a log of a of two masses, between which there may be a spring; return arguments."""
    (folder / 'masses.yaml').write_text(
        'hamiltonian:\n  kind: formula\n  coordinates: [a, b]\n'
        '  H: p_a^2/2 + p_b^2/(2*m) + a^2/2 + k*b^2/2 + c*(a-b)^2/2\n'
        f'  parameters: {{m: 1.5, k: 2.5, c: {0.8 * stiffness}}}\n'
        'integrator: {kind: gauss8}\nstep_size: 0.1\n'
        'initial_state: {q: [0.0, 0.0], p: [0.0, 0.0]}\n')
    t = 0.1 * np.arange(151)
    m, k, c = 1.5, 2.0, stiffness
    rates = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-1.0 - c, c, 0.0, 0.0],
                      [c / m, -(k + c) / m, 0.0, 0.0]])
    a = np.array([expm(rates * time)[0] @ [0.3, -0.5, 0.2, 0.4] for time in t])
    a += 1e-3 * np.random.default_rng(5).normal(size=t.size)
    np.savez(folder / 'a.npz', t=t, q=a[:, None])
    return (str(folder / 'masses.yaml'), '--data', str(folder / 'a.npz'), '--measured', 'a',
            '--json', str(folder / 'found.json'), '--free', 'initial_state', 'parameters.k')


def test_numbers_and_states_of_an_unmeasured_mass_are_found_through_its_spring(tmp_path):
    main([*two_masses(tmp_path, 1.0), 'parameters.c'])
    found = json.loads((tmp_path / 'found.json').read_text())
    truth = {'parameters.k': 2.0, 'parameters.c': 1.0, 'initial_state.b': -0.5,
             'initial_state.p_b': 0.6}
    for name, value in truth.items():
        # Twice the interval: one of five misses its own in a quarter of all logs.
        middle = 0.5 * (found[name]['low'] + found[name]['high'])
        assert abs(middle - value) < found[name]['high'] - found[name]['low'] < 0.1


def test_what_does_not_move_what_is_measured_is_not_identifiable(tmp_path):
    main([*two_masses(tmp_path, 0.0), 'parameters.m'])
    found = json.loads((tmp_path / 'found.json').read_text())
    unknown = {name for name, one in found.items() if one['low'] is None}
    assert unknown == {'parameters.k', 'parameters.m', 'initial_state.b', 'initial_state.p_b'}


def test_windows_that_are_done_are_not_simulated_and_change_no_others(pendulum, tmp_path):
    windows = cut_windows([swing(pendulum, 0.4, 4)], 0.1)
    prediction = Prediction(freed(pendulum, tmp_path, length=1.0), np.ones(1), windows)
    starts = np.random.default_rng(2).normal(size=(len(windows.run), 2))
    only = np.arange(len(starts)) % 2 == 1
    for whole, part in zip(prediction.by_starts(starts), prediction.by_starts(starts, only),
                           strict=True):
        assert np.array_equal(part[only], whole[only]) and np.isnan(part[~only]).all()


def test_outliers_move_a_robust_fit_less(pendulum, tmp_path, monkeypatch):
    # Of half as many samples, chance makes some logs of white noise look correlated.
    log = swing(pendulum, 2.0, 2)
    q = log.q.copy()
    q[::17] += 0.5
    spoilt = replace(log, q=q)
    free = freed(pendulum, tmp_path, length=1.03)
    plain, robust = (estimated(free, spoilt, robust).estimates[0] for robust in (False, True))
    assert abs(robust.value - 1.0) < 4.0 * robust.standard_error
    assert robust.standard_error < 0.7 * plain.standard_error
    # Of friction that the scene has not, no residual is cut off: all count, the largest ones less.
    damped = pendulum.with_overrides(effects=[{'kind': 'damping', 'rate': 0.3}])
    searches, descend, evaluate = [], FitProblem.descend, FitProblem._evaluate
    monkeypatch.setattr(FitProblem, 'descend', lambda *arguments: (
        searches.append(0), descend(*arguments))[1])
    monkeypatch.setattr(FitProblem, '_evaluate', lambda *arguments: (
        searches.append(searches.pop() + 1), evaluate(*arguments))[1])
    solution = fit_numbers(
        [freed(pendulum, tmp_path, length=1.05)], [swing(damped, 2.0, 4, None)], 0.5, True
        ).solution
    # Each start ends by itself.
    assert max(searches) <= _INNER // 2
    assert solution.misfit < 3.0


@pytest.mark.parametrize('spacing, steps', [
    (0.002, 1), (0.0020000935, 1), (0.00203, 2), (0.004, 2), (0.0005, 1), (0.0059, 3)])
def test_clock_of_a_log_that_is_a_little_off_asks_for_no_further_step(spacing, steps):
    assert steps_between(spacing, 0.002) == steps


def test_profile_of_a_number_is_its_interval_where_all_is_nearly_linear(pendulum, tmp_path):
    free = freed(pendulum, tmp_path, length=1.0)
    fitted = fit_numbers([free], [swing(pendulum, 2.0, 4)], None, False)
    solution, problem = fitted.solution, fitted.problem
    one, = estimates_of(solution, problem, free, (), False).estimates
    told = profile(solution, problem, free, one)
    # Curvature is of the relative size of the interval, some 1 %; the search ends at 1e-3.
    assert told.low == pytest.approx(one.low, abs=0.03 * one.standard_error)
    assert told.high == pytest.approx(one.high, abs=0.03 * one.standard_error)


@pytest.mark.parametrize('robust', [False, long(True)])
def test_profile_is_as_wide_as_the_interval_where_noise_is_correlated(
        robust, pendulum, tmp_path):
    log, random = swing(pendulum, 4.0, 2, None), np.random.default_rng(3)
    noise = np.zeros_like(log.q)
    for k, white in enumerate(random.normal(size=len(noise))):
        noise[k] = 0.9 * noise[k - 1] + 4e-3 * white
    free = freed(pendulum, tmp_path, length=1.0)
    fitted = fit_numbers([free], [replace(log, q=log.q + noise, v=None)], None, robust)
    solution, problem = fitted.solution, fitted.problem
    found = estimates_of(solution, problem, free, (), False)
    one, = found.estimates
    assert found.coloured[0] > 4.0
    told = profile(solution, problem, free, one)
    # Without it the profile is half as wide, or less. Of the robust loss the shape counts too.
    assert told.high - told.low == pytest.approx(one.high - one.low, rel=0.1 if robust else 0.02)


def test_initial_state_is_as_uncertain_as_correlated_noise_makes_it(pendulum, tmp_path):
    log, random, share = swing(pendulum, 24.0, 2, None), np.random.default_rng(3), 0.8
    noise = lfilter([4e-3], [1.0, -share], random.normal(size=len(log.q)))[:, None]
    free = freed(pendulum, tmp_path, length=1.0)
    found = fit_numbers([free], [replace(log, q=log.q + noise, v=None)], None, False)
    solution, problem, stages = found.solution, found.problem, found.stages
    # They are what this noise makes, though neighbouring samples differ by a third of it.
    assert all(0.7 < excess < 1.5 for _, excess in stages)
    slopes = np.concatenate([solution.parameter_jacobian, solution.by_starts], axis=3)[0, :, 0]
    lags = np.arange(len(slopes))
    inverse = np.linalg.inv(slopes.T @ slopes)
    true = inverse @ slopes.T @ share**np.abs(lags[:, None] - lags) @ slopes @ inverse
    found = estimates_of(solution, problem, free, pendulum.create_hamiltonian().coordinates, True)
    # Some 9 times those of white noise, and 50 times the error of the share more, which is
    # sqrt(0.36 / 1201): 10 % are one standard error.
    assert np.diag(found.covariance) == pytest.approx(np.diag(true), rel=0.3)
    assert (np.diag(inverse) < 0.3 * np.diag(true)).all()
    correlation, expected = (one / np.sqrt(np.outer(*2 * [np.diag(one)])) for one in (
        found.covariance, true))
    assert correlation == pytest.approx(expected, abs=0.1)


def test_correlated_noise_is_noticed_and_white_noise_is_not():
    random, n = np.random.default_rng(4), 20000
    white = random.normal(size=n)
    for noise, order, together in ((white, 0, 1.0), (lfilter([1.0], [1.0, -0.8], white), 1, 9.0),
                                   (lfilter([1.0], [1.0, -0.9, 0.5], white), 2, 4.0 / 3.0)):
        found = processes(noise[None], np.array([n]), np.ones((1, n, 1)) / np.sqrt(n), random)
        assert min(len(one.reflections) for one in found) == order
        # 1 / 0.6^2 over the variance 25 / 12 for the last one; told within 5 % by so many samples.
        assert np.median([one.samples_as_one for one in found]) == pytest.approx(
            together, rel=0.1)


@pytest.mark.parametrize('kind', mostly_long(
    [*identify_coverage.NOISES, identify_coverage.QUANTISED], 'arma', identify_coverage.QUANTISED))
def test_intervals_hold_the_truth_whatever_the_noise_is_like(kind):
    rows = np.array([*identify_coverage.held_by_regression(300, kind, 30, 1)])
    # Of 30 logs more than five miss a number by chance once in a thousand. Chance is no less
    # likely to miss a number alone than all four.
    assert rows.sum() >= 4 * 25


def test_numbers_are_put_into_yaml_and_comments_stay():
    text = ('# Mine.\nhamiltonian: {kind: pendulum, mass: 1.0}  # [kg]\neffects:\n'
            '  - kind: damping  # slow\n    rate: 0.1\n')
    assert edited(text, {('hamiltonian', 'mass'): '2.0', ('hamiltonian', 'length'): '3.0',
                         ('effects', '0', 'rate'): '0.5', ('effects', '0', 'x'): '1'}) == (
        '# Mine.\nhamiltonian: {kind: pendulum, mass: 2.0, length: 3.0}  # [kg]\neffects:\n'
        '  - kind: damping  # slow\n    x: 1\n    rate: 0.5\n')


@pytest.fixture(scope='module')
def log(tmp_path_factory) -> Path:
    """Return a file of arrays, as measured."""
    motion = swing(load_scene('exact_pendulum'), 2.0, 4)
    path = tmp_path_factory.mktemp('logs') / 'swing.npz'
    np.savez(path, t=motion.t, q=motion.q, v=motion.v)
    return path


ROBOT = """\
hamiltonian:
  {kind: urdf, file: tree.urdf, locked: {follower: 0.03}, rotor_inertia: {rail: 1.5, hip: 0.2}}
effects:
- {kind: joint_friction, damping: {rail: 2.0, hip: 0.1}, friction: {rail: 1.0}}
- {kind: joint_limits, lower: {rail: -1.0, hip: -2.0}}
- {kind: servo, coordinates: [rail, hip], stiffness: [1.0, 2.0], damping: 1.0, position: [0, 1]}
- {kind: periodic_drive, coordinate: hip, amplitude: 1.0, frequency: 1.0}
- {kind: dry_friction, coordinate: finger, force: 1.0}
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [0, 0, 0, 0.05, 0], p: [0, 0, 0, 0, 0]}
"""


@pytest.fixture
def robot(tmp_path) -> Scene:
    (tmp_path / 'tree.urdf').write_text(TREE)
    (tmp_path / 'robot.yaml').write_text(ROBOT)
    return load_scene(tmp_path / 'robot.yaml')


def test_numbers_of_a_slide_have_the_units_of_lengths(robot, tmp_path):
    units = {
        'rail.damping': 'N s/m', 'rail.friction': 'N', 'trunk.ixx': 'kg m2',
        'joint_friction.damping.rail': 'N s/m', 'joint_friction.damping.hip': 'N m s/rad',
        'joint_friction.friction.rail': 'N', 'joint_friction.speed': 'rad/s or m/s',
        'joint_limits.lower.rail': 'm', 'joint_limits.lower.hip': 'rad',
        'servo.stiffness.0': 'N/m', 'servo.stiffness.1': 'N m/rad',
        'servo.damping': 'N s/m or N m s/rad', 'servo.position.0': 'm', 'servo.position.1': 'rad',
        'periodic_drive.amplitude': 'N m', 'dry_friction.force': 'N', 'locked.follower': 'm',
        'rotor_inertia.rail': 'kg', 'rotor_inertia.hip': 'kg m2', DELAY: 's'}
    free = free_scene(robot.parts(), [*units], {}, tmp_path, True)
    assert {number.name: number.unit for number in free.numbers} == units


def test_number_of_a_link_that_is_fixed_to_another_is_that_of_a_body(robot, tmp_path):
    # That of the tool with the hand could still be one, were these below zero.
    free = free_scene(robot.parts(), ['tool.mass', 'tool.ixx', 'tip.mass'], {}, tmp_path, True)
    assert [number.low for number in free.numbers] == [0.0, 0.0, 0.0]
    with refused(ModelError):
        free.at([0.4, 9.0, 0.1])


def test_command_writes_numbers_posterior_report_and_scene(log, drawn, tmp_path, capsys):
    paths = {name: tmp_path / name for name in ('a.json', 'b.json', 'report', 'fitted.yaml')}
    main(['exact_pendulum', '--data', str(log), '--free', 'length', 'mass', 'initial_state',
          '--bounds', 'length', '0.5', '2', '--json', str(paths['a.json']),
          '--posterior', str(paths['b.json']), '--out', str(paths['report']),
          '--write', str(paths['fitted.yaml'])])
    numbers = json.loads(paths['a.json'].read_text())
    assert [*numbers] == ['length', 'mass', 'initial_state.angle', 'initial_state.p_angle']
    assert all(sorted(one) == ['high', 'low', 'value'] for one in numbers.values())
    assert numbers['length']['low'] < 1.0 < numbers['length']['high']
    assert numbers['mass']['low'] is None
    told = json.loads(paths['b.json'].read_text())
    assert told['covariance']['names'] == ['length', 'initial_state.angle']
    assert told['covariance']['matrix'][0][0]**0.5 == pytest.approx(
        told['parameters']['length']['standard_error'])
    assert 'if these change together, relatively: mass +1' in capsys.readouterr().out
    assert {path.name for path in paths['report'].iterdir()} == {
        'report.md', 'fit.png', 'correlations.png'}
    assert (paths['report'] / 'fit.png').read_bytes().startswith(b'\x89PNG')
    scene = load_scene(paths['fitted.yaml'])
    assert scene.hamiltonian.length == numbers['length']['value']
    assert hnn_vi_ros.simulate(scene, 0.1).q.shape[1] == 1


def test_identify_needs_no_torch_for_a_scene_without_networks(log):
    code = ('import sys\n'
            'class Without:\n'
            '    def find_spec(self, name, *_):\n'
            '        if name == "torch":\n'
            '            raise ModuleNotFoundError(name=name)\n'
            'sys.meta_path.insert(0, Without())\n'
            'from hnn_vi_ros.identify.identify import main\n'
            f'main(["exact_pendulum", "--data", {str(log)!r}, "--free", "length"])')
    result = run_code(code)
    assert result.returncode == 0 and '| length | 1' in result.stdout, result.stderr


def test_bounds_that_hold_the_truth_out_are_told(log, capsys):
    main(['exact_pendulum', '--data', str(log), '--free', 'length', '--bounds', 'length', '1.2',
          '2', '--horizon', '2'])
    said = capsys.readouterr().out
    assert 'in one window of 2 s with its own initial state' in said
    assert 'length is at its bound, 1.2 m: the data may fit better beyond it' in said
    assert 'The residuals are much larger than the noise' in said


def test_fitted_robot_is_written_beside_its_scene(tmp_path):
    scene = load_scene('two_joint_arm')
    motion = swing(scene, 0.5, 4, None)
    data = tmp_path / 'arm.npz'
    np.savez(data, t=motion.t, q=motion.q, dq=motion.v)
    shutil.copy(shipped_file('scene', 'two_joint_arm'), tmp_path / 'arm.yaml')
    text = (tmp_path / 'arm.yaml').read_text().replace('../robots/two_joint_arm.urdf', 'arm.urdf')
    (tmp_path / 'arm.yaml').write_text(text)
    robot = scene.model_files()[scene.hamiltonian.file].read_text()
    (tmp_path / 'arm.urdf').write_text(robot.replace('<mass value="1.2"/>',
                                                     '<mass value="1.3"/>'))
    main([str(tmp_path / 'arm.yaml'), '--data', str(data), '--free', 'forearm.mass',
          '--horizon', '0.5', '--write', str(tmp_path / 'fitted.yaml')])
    link = load_scene(tmp_path / 'fitted.yaml').create_hamiltonian().robot.links['forearm']
    # Without noise what is left is the end of the search.
    assert link.inertial is not None and link.inertial.mass == pytest.approx(1.2, rel=1e-5)


@pytest.mark.parametrize('free, data', [
    (['lenght'], {}), ([DELAY], {}), (['length', 'length'], {}),
    (['length'], {'q': np.zeros((100, 2))}), (['length'], {'q': np.zeros(100)}),
    (['length'], {'t': np.arange(5.0), 'q': np.zeros((5, 1))}),
    (['length'], {'tau': np.ones((100, 1))}),
    (['length'], {'t': np.arange(0.0), 'q': np.zeros((0, 1))}),
    (['length'], {'q': np.full((100, 1), np.nan)}), (['length'], {'q': np.zeros((100, 1))}),
    (['length', '--bounds', 'length', 'nan', '2'], {}),
    (['length', '--measured', 'elbow'], {}),
    (['length', '--config', str(ROOT / 'config' / 'training' / 'two_joint_arm.yaml')], {})],
    ids=range(13))
def test_what_cannot_be_fitted_is_one_line(free, data, tmp_path, monkeypatch):
    monkeypatch.setattr('hnn_vi_ros.identify.identify.elapsed', lambda _: pytest.fail('has begun'))
    t = 0.02 * np.arange(100)
    np.savez(tmp_path / 'log.npz', **{'t': t, 'q': np.sin(t)[:, None]} | data)
    with refused(HnnViRosError):
        main(['exact_pendulum', '--data', str(tmp_path / 'log.npz'), '--free', *free])


@pytest.mark.parametrize('command', [
    lambda scene, log, _: main([scene, '--data', log, '--free', 'mass']),
    lambda scene, log, _: evaluate.main([scene, '--data', log]),
    lambda _, __, plan: sweep.main([plan, '--out', f'{plan}.out'])],
    ids=['identify', 'evaluate', 'sweep'])
def test_effect_on_a_coordinate_that_is_not_there_is_the_same_line_in_every_command(
        command, log, tmp_path):
    scene, plan = tmp_path / 'scene.yaml', tmp_path / 'plan.yaml'
    scene.write_text(
        'hamiltonian: {kind: pendulum}\nintegrator: {kind: gauss4}\nstep_size: 0.02\n'
        'effects: [{kind: dry_friction, coordinate: elbow, force: 0.1}]\n'
        'initial_state: {q: [0.5], p: [0.0]}\n')
    plan.write_text('scene: scene.yaml\nduration: 1.0\n'
                    'vary: [{kind: values, key: initial_state.q.0, values: [0.1, 0.2]}]\n')
    with pytest.raises(SceneError) as expected:
        build(load_scene(scene))
    with pytest.raises(SceneError) as caught:
        command(str(scene), str(log), str(plan))
    assert str(caught.value).endswith(str(expected.value).partition('/scene.yaml')[2])
