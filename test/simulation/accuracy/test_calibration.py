# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The integrator auto: what it chooses holds the tolerance, and what cannot be held is said."""

from dataclasses import replace
from itertools import accumulate, count
import math

from benchmarks import campaign
from benchmarks.systems import orbit
from helpers import long, problem_of
from hnn_vi_ros.errors import CalibrationError, SceneError, UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import (
    build, Choice, choose, InitialValueProblem, Method, simulate, Tolerance)
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate, CANDIDATES, remembered
from hnn_vi_ros.simulation.accuracy.trials import CalibrationTask
from hnn_vi_ros.simulation.dense_step import record_at
from messages import refused
import numpy as np
from plain_systems import Plain
import pytest
from studies.references import make_reference

ENERGY, PATH = 'energy_error', 'path_error'
# None of these was looked at when the constants of the calibration were chosen.
PAIRS = [
    *[('exact_pendulum', Tolerance(ENERGY, error, horizon))
      for error in (3e-3, 2e-5, 7e-8, 4e-11) for horizon in (40.0, 700.0)],
    *[('pendulum', Tolerance(ENERGY, error, horizon))
      for error, horizon in ((5e-4, 300.0), (3e-7, 60.0), (2e-9, 500.0))],
    *[('kepler', Tolerance(ENERGY, error, horizon))
      for error, horizon in ((2e-3, 90.0), (4e-6, 800.0), (5e-10, 200.0))],
    *[('henon_heiles', Tolerance(ENERGY, error, horizon))
      for error, horizon in ((6e-4, 1000.0), (1e-7, 150.0))],
    *[('exact_pendulum', Tolerance(PATH, error, horizon))
      for error, horizon in ((4e-3, 15.0), (6e-6, 80.0), (3e-8, 250.0))],
    *[('kepler', Tolerance(PATH, error, horizon))
      for error, horizon in ((5e-3, 12.0), (8e-6, 60.0), (4e-7, 200.0))],
    ('exact_damped_driven_pendulum', Tolerance(ENERGY, 2e-4, 60.0)),
]


def error_of(name: str, tolerance: Tolerance, choice: Choice) -> float:
    """Return the error that a choice makes up to the horizon, looked at a thousand times."""
    method, problem = Method(choice.method, choice.arguments), problem_of(name)
    simulation = problem.simulation(method, choice.step_size)
    if tolerance.kind == PATH:
        reference = make_reference(problem.hamiltonian, problem.q, problem.p, tolerance.horizon)
        tenth = reference.instants.count // 10
        errors = []
        for k in range(10):
            simulation.advance(round((k + 1) * tolerance.horizon / 10 / choice.step_size)
                               - simulation.steps)
            z = np.concatenate([simulation.q, simulation.p])
            errors.append(np.abs(z - reference.states[(k + 1) * tenth - 1]).max())
        return max(errors)
    size, worst = choice.energy_scale, 0.0
    steps = round(tolerance.horizon / choice.step_size)
    every = math.ceil(steps / 1000)
    while simulation.steps < steps:
        simulation.advance(every)
        worst = max(worst, abs(simulation.energy_balance) / size)
    return worst


# One of each kind; `make test-long` takes the others too.
SHORT = [('exact_pendulum', Tolerance(ENERGY, 2e-5, 40.0)),
         ('exact_pendulum', Tolerance(PATH, 4e-3, 15.0))]


@pytest.mark.parametrize('name, tolerance', [
    pair if pair in SHORT else long(*pair) for pair in PAIRS], ids=lambda value: str(
        value) if isinstance(value, str) else f'{value.kind}-{value.error:g}-{value.horizon:g}')
def test_choice_holds_its_tolerance_up_to_the_horizon(name: str, tolerance: Tolerance, measured):
    choice = calibrate(CalibrationTask(problem_of(name), tolerance))
    error = error_of(name, tolerance, choice)
    measured('error of the choice of auto, over its tolerance', f'{name}, {tolerance.kind} '
             f'{tolerance.error:g} up to {tolerance.horizon:g} s, {choice.method}, '
             f'h = {choice.step_size:.3g}', error / tolerance.error, '<= 1')
    assert error <= tolerance.error


@pytest.mark.long
@pytest.mark.parametrize('tolerance', [Tolerance(ENERGY, 1e-3, 200.0),
                                       Tolerance(PATH, 1e-4, 30.0)],
                         ids=lambda tolerance: tolerance.kind)
@pytest.mark.parametrize('end', ['apocentre', 'pericentre'])
@pytest.mark.parametrize('eccentricity', [0.9, 0.99])
def test_close_encounters_are_resolved_from_either_end(eccentricity, end, tolerance):
    """From afar the encounter is not in sight; next to it the rest of the orbit is not."""
    mine = orbit(eccentricity, end == 'apocentre').problem
    choice = calibrate(CalibrationTask(mine, tolerance))
    simulation = mine.simulation(Method(choice.method, choice.arguments), choice.step_size)
    steps = math.ceil(tolerance.horizon / choice.step_size - 1e-6)
    states = np.hstack(simulation.record(steps, 1))
    if tolerance.kind == ENERGY:
        # Over 2 abs(H0), which the virial theorem makes the mean of abs(p . H_p).
        error = np.abs(mine.hamiltonian.energy(*np.split(states, 2, axis=1)) + 0.5).max()
    else:
        t = choice.step_size * np.arange(1, steps + 1)
        error = np.abs(states - mine.hamiltonian.exact_motion(mine.q, mine.p, t).path).max()
    assert error <= tolerance.error


@pytest.mark.long
def test_choice_is_the_same_each_time_however_busy_the_machine_is(monkeypatch):
    """Nothing is chosen by the clock: one that runs wild changes what is told, and no more."""
    tolerance, mine = Tolerance(PATH, 1e-4, 30.0), orbit(0.9, True).problem
    first = calibrate(CalibrationTask(mine, tolerance))
    random = np.random.default_rng(0)
    clock = accumulate(random.exponential(1e-3) for _ in count())
    monkeypatch.setattr('time.perf_counter', lambda: next(clock))
    again = calibrate(CalibrationTask(mine, tolerance))
    assert again.seconds_per_simulated_second != first.seconds_per_simulated_second
    assert replace(again, seconds_per_simulated_second=0.0) == replace(
        first, seconds_per_simulated_second=0.0)


def test_step_that_the_publish_rate_bounds_is_said():
    tolerance = Tolerance(ENERGY, 1e-2, 40.0)
    bounded, free = (calibrate(CalibrationTask(problem_of('exact_pendulum'), tolerance, largest))
                     for largest in (1e-3, None))
    assert bounded.step_size == 1e-3
    assert 'h is at most the sampling interval of 0.001 s' in bounded.explain(tolerance)
    assert 'samples' not in free.explain(tolerance)


def test_path_that_round_off_hides_is_not_called_chaotic():
    with pytest.raises(CalibrationError, match='round-off: the motion is regular'):
        calibrate(CalibrationTask(problem_of('exact_pendulum'), Tolerance(PATH, 1e-17, 20.0)))


@pytest.mark.long
def test_path_that_ends_where_no_survey_came_is_refused(monkeypatch):
    """Beside an oscillation something moves slowly to where H is not defined, at t = 200 s."""
    monkeypatch.setattr('hnn_vi_ros.simulation.accuracy.trials._MAX_PYTHON_GRADIENTS', 3000)

    def gradient(q, p):
        return np.array([q[0], 0.0]) if q[1] < 1.0 else np.full(2, np.nan), p

    end = Plain(lambda q, p: 0.5 * float(p @ p + q[0] ** 2), gradient, 2)
    slow = InitialValueProblem(end, (), np.array([1.0, 0.0]), np.array([0.0, 5e-3]))
    with pytest.raises(CalibrationError, match='no reference path can be computed'):
        calibrate(CalibrationTask(slow, Tolerance(PATH, 1e-5, 6400.0)))


@pytest.mark.long
def test_cost_of_a_choice_is_at_most_half_as_much_again_as_the_best_of_a_sweep(monkeypatch):
    """In work, which does not depend on the machine; the campaign has more of these."""
    monkeypatch.setattr(campaign, '_METHODS', [
        Method(name) for name in CANDIDATES if name != 'time_transformed'])
    mine, tolerance = problem_of('exact_pendulum'), Tolerance(ENERGY, 1e-5, 40.0)
    _, least, _ = campaign.sweep(mine, campaign.Truth(mine, tolerance.horizon), tolerance)
    assert calibrate(CalibrationTask(mine, tolerance)).work_per_simulated_second <= 1.5 * least


@pytest.mark.long
def test_cheap_gradients_are_not_bought_by_dear_steps():
    """To three digits a Gauss method takes fewer gradients of nanoseconds, and more time."""
    choice = calibrate(CalibrationTask(
        problem_of('exact_pendulum'), Tolerance(ENERGY, 1e-3, 200.0)))
    assert choice.method == 'stormer_verlet'


@pytest.mark.parametrize(('eccentricity', 'horizon', 'error', 'largest'), [
    (0.5, 500.0, 1e-6, None), *(long(*row) for row in (
        (0.5, 100.0, 1e-6, None), (0.5, 500.0, 1e-8, None), (0.8, 200.0, 1e-6, 1.0),
        (0.9, 200.0, 1e-5, None), (0.9, 100.0, 1e-7, None), (0.9, 200.0, 1e-5, 1.0)))])
def test_choice_holds_a_path_error_between_its_steps(eccentricity, horizon, error, largest):
    """At times within steps of several orbits, and near the pericentre, where errors peak."""
    mine = orbit(eccentricity, False).problem
    choice = calibrate(CalibrationTask(mine, Tolerance(PATH, error, horizon), largest))
    simulation = mine.simulation(Method(choice.method, choice.arguments), choice.step_size)
    t = np.linspace(0.01, horizon, 4001)
    exact = mine.hamiltonian.exact_motion(mine.q, mine.p, t).path
    assert np.abs(np.hstack(record_at(simulation, t)) - exact).max() <= error


@pytest.mark.long
def test_series_are_chosen_for_paths_alone_and_where_steps_are_long():
    pytest.importorskip('heyoka', reason='heyoka, which computes the series, is not installed')
    mine = problem_of('kepler')
    chosen = [calibrate(CalibrationTask(mine, Tolerance(kind, 1e-9, 100.0), largest)).method
              for kind, largest in ((PATH, None), (ENERGY, None), (PATH, 0.1))]
    assert chosen[0] == 'taylor' != chosen[1]
    # A step through Python takes longer than one of a compiled method.
    assert chosen[2] != 'taylor'


def test_step_divides_the_time_between_two_samples():
    choice = calibrate(CalibrationTask(
        problem_of('exact_pendulum'), Tolerance(ENERGY, 1e-4, 100.0), 0.01))
    parts = 0.01 / choice.step_size
    assert choice.step_size <= 0.01 and parts == pytest.approx(round(parts), rel=1e-12)


def test_tolerance_below_round_off_is_refused_with_the_nearest():
    with pytest.raises(CalibrationError, match=r'no method meets .* the best is gauss\d+'):
        calibrate(CalibrationTask(problem_of('exact_pendulum'), Tolerance(ENERGY, 1e-18, 10.0)))


@pytest.mark.long
def test_path_of_a_chaotic_motion_is_refused():
    with pytest.raises(CalibrationError, match=r'chaotic with a Lyapunov time of \d'):
        calibrate(CalibrationTask(problem_of('henon_heiles'), Tolerance(PATH, 1e-6, 2000.0)))


def test_candidates_all_keep_their_energy():
    # The last one is symplectic in a time of its own, see test_time_transformed; the one before
    # conserves the energy, see test_variational_midpoint.
    assert all(INTEGRATORS[name].requirements.symplectic for name in CANDIDATES[:-2])


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Return a function that reads a scene of the pendulum with some integrator."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))

    def read(integrator: str, more: str = ''):
        path = tmp_path / 'mine.yaml'
        path.write_text('hamiltonian: {kind: pendulum}\n'
                        f'integrator: {{kind: auto, {integrator}}}\n{more}'
                        'initial_state: {q: [2.5], p: [0.0]}\n')
        return load_scene(path)
    return read


def test_scene_with_the_integrator_auto_is_simulated(scene):
    trajectory = simulate(scene('energy_error: 1e-5, horizon: 100.0'), 20.0)
    assert np.ptp(trajectory.energy) <= 1e-5 * trajectory.energy[0]


def test_choice_is_remembered(scene, monkeypatch):
    mine = scene('energy_error: 1e-5, horizon: 100.0')
    _, first = choose(mine)
    monkeypatch.setattr('hnn_vi_ros.simulation.accuracy.automatic_choice.calibrate', None)
    assert choose(mine)[1] == first
    # Another tolerance is another question.
    with pytest.raises(TypeError):
        choose(scene('energy_error: 1e-6, horizon: 100.0'))


def test_choice_that_cannot_be_read_is_made_anew(tmp_path, scene):
    mine = scene('energy_error: 1e-5, horizon: 100.0')
    choose(mine)
    (file,) = (tmp_path / 'cache').rglob('*.json')
    for damaged in ('', '{', '{"method": "gauss4"}', '[]'):
        file.write_text(damaged)
        assert choose(mine)[1].choice.method in CANDIDATES
    assert 'step_size' in file.read_text()


@pytest.mark.parametrize('integrator', [
    'horizon: 1.0', 'energy_error: 1e-3, path_error: 1e-3, horizon: 1.0', 'energy_error: 1e-3',
    'energy_error: -1.0, horizon: 1.0'], ids=str)
def test_mistake_in_a_tolerance_is_answered_with_its_place(scene, integrator):
    with refused(SceneError):
        scene(integrator)


def test_simulation_is_built_only_of_a_scene_whose_method_was_chosen(scene):
    with refused(SceneError):
        build(scene('energy_error: 1e-5, horizon: 100.0'))


def test_scene_without_step_size_needs_the_integrator_auto(scene):
    mine = scene('energy_error: 1e-5, horizon: 100.0')
    with refused(SceneError):
        mine.with_overrides(integrator='gauss4')
    assert build(mine.with_overrides(0.01, 'gauss4')).step_size == 0.01


def test_effect_that_no_candidate_takes_is_refused(scene):
    two = ('effects:\n'
           '  - {kind: thermostat, temperature: 0.1, rate: 1.0}\n'
           '  - {kind: holonomic_constraint, point: [angle], anchor: [0.0], length: 2.5}\n')
    with refused(SceneError, UnsupportedSystem):
        choose(scene('energy_error: 1e-5, horizon: 100.0', two))


def test_remembered_tells_largest_steps_apart(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    tolerance = Tolerance(ENERGY, 1e-3, 50.0)
    steps = [remembered(CalibrationTask(
        problem_of('exact_pendulum'), tolerance, largest), 'name').step_size
             for largest in (None, 0.01)]
    assert steps[1] <= 0.01 < steps[0]


def test_choice_for_code_of_the_user_is_made_anew_each_time(tmp_path, monkeypatch):
    """A file of the same name, edited or in another folder, may hold another H."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / 'own_oscillator.py').write_text(
        'from hnn_vi_ros.hamiltonians import HAMILTONIANS\n\n\n'
        "def make():\n    return HAMILTONIANS['harmonic_oscillator'](stiffness=1.0)\n")
    (tmp_path / 'own.yaml').write_text(
        "hamiltonian: {kind: python, factory: 'own_oscillator:make'}\n"
        'integrator: {kind: auto, path_error: 1.0e-4, horizon: 20.0}\n'
        'initial_state: {q: [1.0], p: [0.0]}\n')
    own = load_scene(tmp_path / 'own.yaml')
    stiff = HAMILTONIANS['harmonic_oscillator'](stiffness=1600.0)
    slow = choose(own)[1].choice.work_per_simulated_second
    monkeypatch.setattr('own_oscillator.make', lambda: stiff)
    # As much for each period, 40 times as many periods, and the fixed cost of long steps.
    assert choose(own)[1].choice.work_per_simulated_second > 1.5 * slow
