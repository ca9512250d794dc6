# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of accuracy: errors of their order, methods that fit, and what is recommended holds."""

from functools import cache
import math
from types import SimpleNamespace

from helpers import exact_orbit, problem_of
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import CostStudy, measure_costs, Method, MethodCost, Tolerance
from hnn_vi_ros.simulation.accuracy import automatic_choice, cost
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate, held_costs
from hnn_vi_ros.simulation.accuracy.cost import error_between, fastest, run_errors
from hnn_vi_ros.simulation.accuracy.path_reference import exact_path, Instants
from hnn_vi_ros.simulation.accuracy.trials import CalibrationTask
from hnn_vi_ros.simulation.dense_step import record_at
import numpy as np
import pytest


@pytest.fixture
def few(monkeypatch):
    """Let studies measure few methods, so that little is compiled."""
    def only(*kinds: str) -> None:
        monkeypatch.setattr(cost, 'INTEGRATORS', {kind: INTEGRATORS[kind] for kind in kinds})
    return only


@cache
def kepler_study() -> CostStudy:
    """Return the costs of methods of orders 1, 2, 4 and 8 on an orbit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, 'INTEGRATORS', {kind: INTEGRATORS[kind] for kind in (
            'symplectic_euler', 'stormer_verlet', 'rk4', 'gauss8', 'lie_leapfrog', 'dop853',
            'discrete_euler_lagrange', 'time_transformed', 'variational_midpoint')})
        return measure_costs(problem_of('kepler'), 10.0, 60.0)


@pytest.mark.parametrize('kind, order', [
    ('symplectic_euler', 1), ('stormer_verlet', 2), ('rk4', 4), ('gauss8', 8)])
def test_errors_of_a_method_fall_with_its_order(kind, order):
    study = kepler_study()
    own = [row for row in study.costs if row.method.kind == kind
           and 100.0 * study.floor < row.path_error < 1e-2]
    assert len(own) >= 4
    h, errors = np.array([(row.step_size, row.path_error) for row in own]).T
    slope = np.polyfit(np.log(h), np.log(errors), 1)[0]
    # Over steps that are not all small the slope is not yet the order, to a tenth or two of it.
    assert 0.8 * order < slope < 1.3 * order


def test_rows_cost_more_the_smaller_their_steps_and_name_what_they_took():
    study = kepler_study()
    for kind in ('stormer_verlet', 'rk4'):
        own = [row for row in study.costs if row.method.kind == kind]
        assert [row.step_size for row in own] == sorted((row.step_size for row in own),
                                                        reverse=True)
        per_step = {'stormer_verlet': 1, 'rk4': 4}[kind]
        # Of a symmetric splitting a step begins with the gradient that the last one ended with.
        assert all(row.gradients * row.step_size == pytest.approx(per_step, rel=1e-2, abs=1.0)
                   for row in own)
        assert all(row.seconds > 0.0 for row in own)


def test_methods_that_do_not_fit_are_left_out_once_with_the_reason():
    study = kepler_study()
    assert study.left_out == {
        'needs rotations or poses, but this H has none': ['lie_leapfrog'],
        'needs coordinates that are not canonical, those of a model of the family '
        'symplectic_form': ['variational_midpoint'],
        'needs an argument of the scene: give either discrete_lagrangian or model':
            ['discrete_euler_lagrange']}
    assert not study.unreached
    assert {row.method.kind for row in study.costs} == {
        'symplectic_euler', 'stormer_verlet', 'rk4', 'gauss8', 'dop853', 'time_transformed'}


def test_recommendation_holds_its_error_in_an_independent_run():
    """Against Kepler's equation in 40 digits, at instants that were not compared."""
    best = calibrate(CalibrationTask(problem_of('kepler'), Tolerance('path_error', 1e-6, 10.0)))
    assert best.error <= 0.95e-6
    simulation = problem_of('kepler').simulation(
        Method(best.method, best.arguments), best.step_size)
    worst, turn, times = 0.0, np.array([[-0.6, 0.8], [-0.8, -0.6]]), np.linspace(0.07, 9.97, 97)
    for time, state in zip(times, np.hstack(record_at(simulation, times)), strict=True):
        orbit = exact_orbit(0.6, time)
        # The scene's apocentre is on (0.6, 0.8), that of exact_orbit on (-1, 0).
        exact = np.array([*turn @ orbit[:2], *turn @ orbit[2:]])
        worst = max(worst, np.abs(state - exact).max())
    assert 0.0 < worst <= 1e-6


def test_recommendation_is_the_cheapest_and_none_below_what_is_known():
    study = kepler_study()
    best = study.recommended(1e-6)
    assert all(row.seconds >= best.seconds for row in study.costs
               if study.error(row) <= 0.95e-6 - study.floor)
    assert study.recommended(0.5 * study.floor) is None


@pytest.mark.parametrize('kind', ['gauss8', 'dop853'])
def test_more_settings_are_tried_near_a_requested_error(kind, monkeypatch):
    """Next to the cheapest setting that holds the error is one that does not."""
    monkeypatch.setattr(automatic_choice, 'CANDIDATES', (kind, 'time_transformed'))
    monkeypatch.setattr(automatic_choice, 'PATH_CANDIDATES', ())
    tolerance = Tolerance('path_error', 1e-6, 10.0)
    study = held_costs(CalibrationTask(problem_of('exact_pendulum'), tolerance))
    tried = [row for row in study.costs if row.method.kind == kind]
    held = max(row.coarseness for row in tried if study.holds(row, 1e-6))
    # Steps have ratios of at most 4 / 3, tolerances of 10^(1/4).
    assert any(held < row.coarseness <= 1.8 * held for row in tried)


def test_errors_of_adaptive_methods_fall_with_their_tolerance_at_one_step_of_the_clock():
    study = kepler_study()
    own = [row for row in study.costs if row.method.kind == 'dop853']
    good = [row for row in own if 100.0 * study.floor < row.path_error < 1e-2]
    assert len(good) >= 6 and {row.step_size for row in own} == {1.0}
    tolerances = [row.method.tolerance for row in good]
    assert tolerances == sorted(tolerances, reverse=True)
    slope = np.polyfit(np.log(tolerances), np.log([row.path_error for row in good]), 1)[0]
    # Proportional, on a path whose errors differ by chance from one tolerance to the next.
    assert 0.8 < slope < 1.3
    # One row of the table, whatever the tolerance.
    assert {row.method.family for row in own} == {'dop853'}
    assert study.cheapest(1e-6, 'dop853').path_error <= 1e-6


def test_errors_of_a_run_are_those_of_the_states_it_comes_by():
    problem, h = problem_of('exact_pendulum'), 0.05
    reference = exact_path(problem, Instants.of(2.0, 2.0, 40))
    errors = run_errors(problem.simulation('rk4', h), reference)
    q, p = problem.simulation('rk4', h).record(40, 1)
    exact = problem.hamiltonian.exact_motion(problem.q, problem.p, h * np.arange(1, 41)).path
    assert errors.path == np.abs(np.hstack([q, p]) - exact).max()
    assert errors.energy == np.abs(problem.hamiltonian.energy(q, p)
                                   - problem.hamiltonian.energy(problem.q, problem.p)).max()
    assert errors.gradients == 160
    # One that is known to be bad enough ends early.
    early = run_errors(problem.simulation('rk4', h), reference, 1e-12)
    assert 1e-12 < early.path < errors.path and early.gradients < errors.gradients


@pytest.mark.long
def test_run_that_overflows_is_a_failure_and_no_row_of_the_table(few):
    few('explicit_euler', 'gauss8')
    problem = problem_of('henon_heiles')
    with pytest.raises(StepFailure, match='not finite'), np.errstate(all='ignore'):
        reference = exact_path(problem_of('kepler'), Instants.of(400.0, 400.0, 1))
        run_errors(problem.simulation('explicit_euler', 1.0), reference.__class__(
            Instants.of(400.0, 400.0, 1), np.empty((0, 4)), math.inf, ''))
    study = measure_costs(problem, 20.0, 20.0)
    assert all(not row.failure for row in study.costs if study.error(row) < math.inf)


@pytest.mark.long
def test_bodies_that_turn_are_measured_by_the_methods_made_for_them(few):
    few('lie_leapfrog', 'lie_gauss8', 'kahan_li8', 'gauss8')
    study = measure_costs(problem_of('heavy_top'), 2.0, 60.0)
    assert study.reference.how.startswith('lie_gauss16') and not study.no_path
    assert {str(row.method) for row in study.costs} == {
        'lie_leapfrog', 'lie_gauss8', 'kahan_li8 (base lie_stormer_verlet)'}
    reason, = study.left_out
    assert reason == 'adds to coordinates, which a rotation (attitude) does not allow'
    assert study.cheapest(1e-9) is not None


@pytest.mark.long
def test_effects_are_taken_and_their_errors_are_of_the_balance(few):
    few('generalized_leapfrog', 'gauss8', 'stormer_verlet')
    study = measure_costs(problem_of('exact_damped_driven_pendulum'), 5.0, 60.0)
    assert not study.no_path and study.cheapest(1e-8).method.kind == 'gauss8'
    gauss = [row for row in study.costs if row.method.kind == 'gauss8']
    assert gauss[-1].energy_error < 1e-9


@pytest.mark.long
def test_random_motion_is_measured_by_its_energy(few):
    few('generalized_leapfrog', 'gauss8')
    study = measure_costs(problem_of('exact_brownian_oscillator'), 2.0, 30.0)
    assert study.no_path == 'Thermostat draws different random numbers at each step size'
    assert all(math.isnan(row.path_error) for row in study.costs) and study.floor == 0.0
    assert study.recommended(1e-4).energy_error <= 1e-4
    assert study.left_out == {'does not support the effect thermostat': ['gauss8']}


@pytest.mark.long
def test_chaos_is_measured_by_its_energy_and_the_reason_is_given(few):
    few('gauss8')
    study = measure_costs(problem_of('exact_double_pendulum'), 300.0, 30.0)
    assert 'as in chaotic motions; try a shorter --duration' in study.no_path
    assert study.recommended(1e-3) is not None


def test_methods_that_time_does_not_suffice_for_are_named(few):
    few('gauss8', 'rk4', 'stormer_verlet')
    study = measure_costs(problem_of('exact_pendulum'), 10.0, 1e-6)
    # The first one is measured in any case.
    assert {row.method.kind for row in study.costs} == {'gauss8'}
    assert study.unreached == ['stormer_verlet', 'rk4']


def test_time_to_compile_a_method_takes_none_from_its_rows(few, monkeypatch):
    few('gauss8', 'rk4')
    rows = []
    for compiling in (0.0, 1000.0):
        clock = SimpleNamespace(now=0.0)

        def now(clock=clock) -> float:
            clock.now += 1e-3
            return clock.now

        def warm_up(study, method, clock=clock, compiling=compiling):
            clock.now += compiling * (method.kind == 'rk4')
        monkeypatch.setattr(cost, 'time', SimpleNamespace(process_time=now))
        monkeypatch.setattr(cost, '_warm_up', warm_up)
        study = measure_costs(problem_of('exact_pendulum'), 10.0, 60.0)
        rows.append([row.step_size for row in study.costs if row.method.kind == 'rk4'])
    assert len(rows[0]) > 3 and rows[0] == rows[1]


@pytest.mark.parametrize('kind', ['gauss8', 'taylor', 'dop853'])
def test_error_between_steps_is_that_of_dense_output_where_the_path_is_fastest(
        kind, monkeypatch):
    """A path in steps of several orbits, of which the ends alone are near the exact one."""
    if kind == 'taylor':
        pytest.importorskip('heyoka', reason='heyoka, which computes the series, is not installed')
    monkeypatch.setattr(automatic_choice, 'CANDIDATES', ('gauss8', 'time_transformed'))
    monkeypatch.setattr(automatic_choice, 'PATH_CANDIDATES', (kind,))
    problem = problem_of('kepler')
    study = held_costs(CalibrationTask(problem, Tolerance('path_error', 1e-6, 100.0)))
    best = study.recommended(1e-6, study.costs[-1].method.family)
    assert best is not None and best.method.kind == kind
    simulation = problem.simulation(best.method, best.step_size)
    t = np.linspace(0.01, 100.0, 4001)
    exact = problem.hamiltonian.exact_motion(problem.q, problem.p, t).path
    error = np.abs(np.hstack(record_at(simulation, t)) - exact).max()
    # The fastest instants of 200 parts are not the worst time of all, by a tenth or two.
    assert error_between(study, simulation) == pytest.approx(error, rel=0.2)
    assert error <= 1e-6


def test_scene_s_own_method_keeps_its_arguments(few):
    few('time_transformed', 'yoshida4', 'gauss8')
    own = Method('yoshida4', {'base': 'implicit_midpoint'})
    study = measure_costs(problem_of('exact_pendulum'), 1.0, 30.0, own)
    assert 'yoshida4 (base implicit_midpoint)' in {str(row.method) for row in study.costs}
    assert study.left_out == {
        'is for close encounters, but this path has none': ['time_transformed']}


def test_cheapest_is_of_the_energy_where_there_is_no_path():
    study = kepler_study()
    rows = [MethodCost(Method('rk4'), 0.1, math.nan, 1e-3, 2e-6, 40.0),
            MethodCost(Method('gauss8'), 0.1, math.nan, 1e-9, 5e-6, 80.0),
            MethodCost(Method('explicit_euler'), 0.1, failure='not finite at t = 1 s')]
    chaos = CostStudy(study.problem, study.known, study.reference, 'chaos', rows)
    assert chaos.cheapest(1e-2) == rows[0] and chaos.cheapest(1e-6) == rows[1]
    assert chaos.cheapest(1e-12) is None and chaos.recommended(1e-6) == rows[1]


def test_run_that_compiled_code_is_timed_again():
    class Fast:
        """A simulation whose steps take no time."""

        def restart(self, q, p):
            self.steps = 0

        def advance(self, steps):
            self.steps += steps

    problem = SimpleNamespace(q=np.zeros(1), p=np.zeros(1))
    assert fastest(problem, simulation := Fast(), 1000, 5.0) < 1.0 and simulation.steps == 1000
