# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The hard cases come out as committed, and whatever is planted turns them red."""

from dataclasses import replace
import math
from pathlib import Path
import shutil

from hnn_vi_ros.errors import ParameterError, StepFailure
from hnn_vi_ros.integrators import INTEGRATORS, Requirements
from hnn_vi_ros.integrators.variational_euler import VariationalEuler
from hnn_vi_ros.simulation import Alarm, PathError, Simulation
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from matplotlib.figure import Figure
from messages import refused
import numpy as np
from PIL import Image
import pytest
from studies import hard_cases, hard_cases_checks, hard_cases_run
from studies.hard_cases_checks import run_job
from studies.hard_cases_figure import _draw_panel, _note
from studies.hard_cases_gates import failed_gates, limit_of, Measured, verdict
from studies.hard_cases_plan import Job, load_plan, make_jobs
from studies.hard_cases_results import (
    CaseRow, differences, Expectation, expectations_file, Folder, format_values, FULL, judge,
    load_expectations, make_row, parse_values, QUICK, read_csv, write_expectations)
from studies.variants import Undersolved

PLAN = load_plan()
CONTROLS = {'explicit_euler', 'rk4'}
GATES = ['G1', 'G2', 'G3', 'G4', 'G5']


def job(number: int, method: str, kind: str = 'exact', steps: int = 2000, **changes) -> Job:
    """Return a job of the first set-up of a case and kind, with changes to the set-up."""
    case = next(case for case in PLAN.cases if case.number == number)
    set_up = next(set_up for set_up in case.set_ups if set_up.kind == kind)
    return Job(case, set_up.model_copy(update=changes), method, steps, PLAN.guards)


def row_of(measured: Measured) -> CaseRow:
    """Return the row that a measurement makes."""
    return make_row(job(1, 'variational_euler'), measured, 0.0)


def calm(**changes) -> Measured:
    """Return what a run measures that passes everything."""
    return Measured(**{'largest': 1.0, 'residual': 1e-16, 'residual_limit': 2e-15, 'band': 1e-3,
                       'slope': 0.01, 'growth': 1.0, 'modified_band': 1e-6, 'reversal': 1e-16,
                       'symplectic': 1e-13, **changes})


@pytest.fixture(scope='module')
def short(tmp_path_factory) -> Path:
    """Run one case in short; return the folder of what comes out."""
    folder = tmp_path_factory.mktemp('short')
    assert hard_cases.main(['--quick', '--case', '14', '--jobs', '1', '--out', str(folder)]) == 0
    return folder


def check(folder: Path, cases: list[int]) -> None:
    """Compare a report of a quick run with the plan and the expectations."""
    page = (folder / 'hard_cases.md').read_text()
    assert 'are not' not in page and 'expected' in page
    with (folder / 'hard_cases.csv').open() as file:
        assert len(file.readlines()) == 1 + len(make_jobs(PLAN, True, cases))
    for number in cases:
        picture = np.asarray(Image.open(folder / f'case_{number:02d}.png').convert('L'))
        # Something dark is drawn on white.
        assert picture.min() < 80 and picture.max() == 255


# Most of it is compilation, where nothing is on disk yet.
@pytest.mark.long
@pytest.mark.timeout(1200)
def test_quick_run_comes_out_as_committed(tmp_path, capsys):
    assert hard_cases.main(['--quick', '--out', str(tmp_path)]) == 0, capsys.readouterr().out
    check(tmp_path, [case.number for case in PLAN.cases])


def test_case_comes_out_as_committed_and_is_not_run_again(short, monkeypatch):
    check(short, [14])
    # Every row is there: nothing is run again, and the result is the same.
    monkeypatch.setattr(hard_cases, 'run_one', lambda job: pytest.fail(f'{job.key} runs again'))
    assert hard_cases.main(['--quick', '--case', '14', '--out', str(short)]) == 0


@pytest.mark.parametrize('run', [QUICK, pytest.param(FULL, marks=pytest.mark.long)])
def test_every_row_has_a_committed_verdict_and_limits_derived_from_what_was_measured(run):
    expected = load_expectations(expectations_file(), run)
    assert {job.key for job in make_jobs(PLAN, run == QUICK)} == set(expected)
    for key, entry in expected.items():
        assert entry.verdict in ('stable', 'alarm', 'stopped', 'unstable')
        assert entry.limits.keys() == entry.measured.keys()
        assert (entry.verdict == 'stable') == bool(entry.limits) or key[0] == 14
        for name, value in entry.measured.items():
            assert entry.limits[name] == limit_of(value)


@pytest.mark.parametrize('run', [QUICK, FULL])
def test_only_methods_that_keep_nothing_fail_without_a_word(run):
    for key, entry in load_expectations(expectations_file(), run).items():
        assert entry.verdict != 'unstable' or key[3] in CONTROLS, key


# Explicit Euler's energy rises in every conservative case; each check must hear of it.
@pytest.mark.parametrize('number', [1, 14, 15])
def test_stable_is_never_a_run_whose_energy_left(number):
    row = make_row(job(number, 'explicit_euler'), run_job(job(number, 'explicit_euler')), 0.0)
    assert row.verdict == 'alarm' and 'under-resolved' in row.alarm


def test_no_committed_run_of_explicit_euler_is_stable():
    rows = read_csv(Path(__file__).parents[2] / 'docs/evidence/hard_cases/hard_cases.csv')
    ends = {row.verdict for row in rows if row.method == 'explicit_euler'}
    assert ends == {'alarm', 'stopped'}


def test_all_cases_run_exact_and_learned_or_say_why_not():
    assert [case.number for case in PLAN.cases] == list(range(1, 22))
    for case in PLAN.cases:
        kinds = {set_up.kind for set_up in case.set_ups}
        assert kinds == {'exact', 'learned'} or case.without


def test_limit_is_the_smallest_of_its_kind_at_least_twice_the_value():
    for value, limit in [(2.5e-3, 5e-3), (6e-14, 2e-13), (1e-3, 2e-3), (4.1, 10.0), (4.0, 8.0),
                         (0.5, 1.0), (2.6e-3, 8e-3), (2.01e-3, 5e-3), (0.0, 0.0)]:
        assert limit_of(value) == limit


@pytest.mark.parametrize('changes, gate', [
    ({'largest': 1e10}, 'G1'), ({'largest': math.nan}, 'G1'), ({'residual': 3e-15}, 'G2'),
    ({'slope': -0.11}, 'G3'), ({'growth': 1.6}, 'G3'), ({'band': math.nan}, 'G3'),
    ({'reversal': 3e-8}, 'G4'), ({'symplectic': 2e-9}, 'G5')])
def test_gate_fails_for_what_it_is_about(changes, gate):
    assert failed_gates(calm(), GATES) == []
    if 'band' in changes:
        changes |= {'slope': math.nan}
    assert failed_gates(calm(**changes), GATES) == [gate]


def test_gates_leave_out_what_a_method_does_not_claim_and_what_is_rounding():
    assert failed_gates(calm(reversal=math.nan, symplectic=math.nan, residual=0.0,
                             residual_limit=math.nan), GATES) == []
    assert failed_gates(calm(band=1e-15, slope=0.9, growth=3.0, rounding=1e-14), GATES) == []


def test_verdict_names_a_failure_before_an_alarm_before_a_gate():
    alarm = Alarm('under-resolved', 5, 1.0, 0.5, 'text', 'J')
    failure = StepFailure('not finite', 0.1, 0.01, 0.0, 1)
    assert verdict(calm(), []) == 'stable'
    assert verdict(calm(), ['G3']) == 'unstable'
    assert verdict(calm(alarms=[alarm]), ['G3']) == 'alarm'
    assert verdict(calm(alarms=[alarm], failure=failure), []) == 'stopped'
    assert calm(alarms=[alarm], failure=failure).first_word == 5
    assert calm(failure=failure).first_word == 10


def test_row_beyond_a_limit_is_unstable_and_not_as_expected():
    row = row_of(calm())
    limits = {'band': 2e-3, 'modified band': 2e-6}
    expectation = Expectation('stable', '', {}, limits)
    assert differences([judge(row, expectation)], {row.key: expectation}) == []
    worse = judge(row_of(calm(band=2.1e-3)), expectation)
    assert (worse.verdict, worse.failed) == ('unstable', 'band > 0.002')
    (line,) = differences([worse], {row.key: expectation})
    assert line.endswith('unstable (band > 0.002), expected stable')
    # Below what rounding may reach nothing is compared, and a missing value is not a small one.
    assert judge(row_of(calm(band=2.1e-3, rounding=1e-2)), expectation).verdict == 'stable'
    assert judge(row_of(calm(modified_band=math.nan)), expectation).verdict == 'unstable'


def test_difference_is_told_for_another_alarm_and_for_a_row_without_a_verdict():
    row = row_of(calm(alarms=[Alarm('under-resolved', 5, 1.0, 0.5, 'text', 'J')]))
    assert differences([row], {row.key: Expectation('alarm', 'under-resolved', {}, {})}) == []
    (line,) = differences([row], {row.key: Expectation('alarm', 'not finite', {}, {})})
    assert 'expected alarm (not finite)' in line
    (line,) = differences([row], {})
    assert 'no verdict is committed' in line


def test_exit_status_is_1_when_a_verdict_differs(short, tmp_path, monkeypatch, capsys):
    path = tmp_path / 'expected.csv'
    monkeypatch.setattr(hard_cases, 'expectations_file', lambda: path)
    shutil.copytree(short, tmp_path / 'out')
    arguments = ['--quick', '--case', '14', '--out', str(tmp_path / 'out')]
    assert hard_cases.main([*arguments, '--commit']) == 0
    text = path.read_text()
    assert hard_cases.main(arguments) == 0
    path.write_text(text.replace(',stable,', ',alarm,', 1))
    capsys.readouterr()
    assert hard_cases.main(arguments) == 1
    assert 'not as expected: case 14' in capsys.readouterr().out


def test_case_that_does_not_exist_is_an_error_that_names_the_valid_ones(tmp_path):
    with refused(ParameterError):
        hard_cases.main(['--case', '22', '--out', str(tmp_path)])


def test_folder_of_another_run_is_refused(tmp_path):
    Folder(tmp_path, {'run': 'quick'})
    with refused(ParameterError):
        Folder(tmp_path, {'run': 'full'})


def test_folder_gives_back_the_rows_that_it_was_given(tmp_path):
    row = row_of(calm(measures={'drift': 1e-6}, t=np.arange(3.0), error=np.arange(3.0),
                      slope=math.inf))
    Folder(tmp_path, {'run': 'quick'}).add(row)
    assert Folder(tmp_path, {'run': 'quick'}).rows == [row]


def test_expectations_are_read_as_they_were_written(tmp_path):
    path, row = tmp_path / 'expected.csv', row_of(calm(measures={'Lyapunov time': 12.0}))
    write_expectations(path, QUICK, [row])
    write_expectations(path, FULL, [replace(row, verdict='alarm', alarm='x at step 3')])
    assert load_expectations(path, QUICK) == {row.key: Expectation(
        'stable', '', {'band': 1e-3, 'modified band': 1e-6},
        {'band': 2e-3, 'modified band': 2e-6})}
    assert load_expectations(path, FULL) == {row.key: Expectation('alarm', 'x', {}, {})}
    path.write_text('nothing\n1\n')
    with refused(ParameterError):
        load_expectations(path, QUICK)
    assert parse_values(format_values({'a b': 0.5, 'c': 1e-9})) == {'a b': 0.5, 'c': 1e-9}


@pytest.mark.long
def test_steps_that_are_not_solved_fail_the_gates(monkeypatch):
    """Three iterations of variational Euler on Tao's H: the residual and the 2-form show it."""
    hurried = job(7, 'variational_euler', q=[1.0], p=[-1.0], step_size=0.05)

    def parts(self):
        hamiltonian, _, effects = original(self)
        worse = Undersolved(VariationalEuler(), 3)
        worse.requirements = Requirements(symmetric=False, symplectic=True)
        return hamiltonian, worse, effects

    original = Job.parts
    monkeypatch.setattr(Job, 'parts', parts)
    measured = run_job(hurried)
    failed = failed_gates(measured, hurried.case.gates)
    assert {'G2', 'G5'} <= set(failed)


def test_box_alarm_is_raised_at_the_first_step_outside():
    leaving = job(11, 'variational_euler', 'learned', hamiltonian={
        'kind': 'hnn', 'model': 'pendulum'}, q=[0.0], p=[7.5])
    simulation = leaving.simulation()
    q, p = simulation.record(2000, 1)
    low, high = np.concatenate(simulation.hamiltonian.box).T
    z = np.hstack([q, p])
    first = 1 + int(((z < low) | (z > high)).any(axis=1).argmax())
    alarm = run_job(leaving).alarms[0]
    assert (alarm.kind, alarm.step) == (BoxGuard.kind, first)
    assert first > 1


@pytest.mark.long
def test_energy_that_rises_in_a_damped_scene_is_found():
    pushed = job(12, 'variational_euler', steps=10_000,
                 effects=[{'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 5.0,
                           'frequency': 0.3}])
    assert 'energy rises' in failed_gates(run_job(pushed), ['G1'])


def test_rod_that_is_not_kept_is_found(monkeypatch):
    """The gravity of case 13 without its rod: the first swing is a fall."""
    original = Job.parts
    fallen = job(13, 'generalized_leapfrog', steps=200)
    monkeypatch.setattr(Job, 'parts', lambda self: (
        (parts := original(self))[0], parts[1], parts[2][:1]))
    broken = failed_gates(run_job(fallen), ['G1'])
    assert broken == ['length > 1e-10', 'rate > 1e-09']


def test_damping_that_does_nothing_is_found_where_it_changes_more_than_rounding(monkeypatch):
    for method, change, found in (
            ('generalized_leapfrog', 0.0, False), ('generalized_leapfrog', 1e-16, True),
            ('gauss4', 1e-13, False), ('gauss4', 1e-11, True)):
        monkeypatch.setattr(hard_cases_checks, '_change_by_no_damping', lambda job, change=change:
                            change)
        broken = failed_gates(run_job(job(12, method, steps=2000)), ['G1'])
        assert ('another path with a rate of 0' in broken) == found


def test_other_bits_are_found(monkeypatch):
    """A simulation that forgets on restore what its solver remembers."""
    forgetful = job(14, 'variational_euler', 'learned', hamiltonian={
        'kind': 'hnn', 'model': 'pendulum'}, q=[2.5], p=[0.0])
    restore = Simulation.restore

    def forget(self, snapshot):
        restore(self, snapshot)
        self.p[0] = np.nextafter(self.p[0], math.inf)

    assert failed_gates(run_job(forgetful), ['G1']) == []
    monkeypatch.setattr(Simulation, 'restore', forget)
    assert failed_gates(run_job(forgetful), ['G1']) == ['other bits when resumed']


@pytest.mark.long
@pytest.mark.parametrize('told, estimated, alarms, broken', [
    (0.4, True, [], ['no alarm']), (0.4, True, [Alarm('', 0, 1.0, 0.1, '', '1')], []),
    (0.1, True, [], ['no alarm', 'estimate']), (0.3, False, [], ['no alarm', 'bound'])])
def test_path_error_that_is_not_true_is_found(told, estimated, alarms, broken):
    measured = calm(alarms=alarms)
    error = PathError(np.ones(1), np.array([told]), estimated)
    hard_cases_checks._judge_path(0.35, 0.35, error, measured)
    assert measured.broken == broken


def test_lyapunov_time_is_short_in_chaos_and_long_on_a_regular_orbit():
    chaotic = job(5, 'variational_euler', steps=1_000_000)
    regular = replace(chaotic, set_up=chaotic.set_up.model_copy(
        update={'q': [0.0, 0.1], 'p': [0.5, 0.0]}))
    # Hénon and Heiles' chaos at this energy takes some 15 time units; order only log(t) / t.
    assert hard_cases_run.lyapunov_time(chaotic) < 50.0
    assert hard_cases_run.lyapunov_time(regular) > 500.0


@pytest.mark.long
def test_late_word_is_told(monkeypatch):
    late = job(4, 'variational_euler', step_size=0.01, within=10, steps=2000)
    assert any(text.startswith('said only at step') for text in failed_gates(
        run_job(late), ['G1']))


def test_every_method_of_the_plan_is_one():
    for case in PLAN.cases:
        for set_up in case.set_ups:
            for method in set_up.methods or []:
                assert method.partition('@')[0] in INTEGRATORS


def test_page_of_the_docs_is_written_with_its_pictures(short, tmp_path):
    assert hard_cases.main(['--quick', '--case', '14', '--out', str(short), '--docs',
                            str(tmp_path)]) == 0
    page = (tmp_path / 'hard-cases.md').read_text()
    assert ':file: hard_cases/grid.html' in page and '## Case 14: repeatability' in page
    grid = (tmp_path / 'hard_cases' / 'grid.html').read_text()
    assert grid.count('data-run="variational_euler, ') == 2
    assert 'href="#case-14-repeatability"' in grid
    for name in ('bands', 'verdicts'):
        assert (tmp_path / 'hard_cases' / f'{name}.png').is_file()
    assert '![case 14](hard_cases/case_14.png)' in page
    assert (tmp_path / 'hard_cases' / 'case_14.png').is_file()


def test_legend_and_panels_say_why_a_curve_is_absent():
    exact, learned = (replace(row_of(calm()), hamiltonian=kind, t=(1.0,), error=(1.0,))
                      for kind in ('exact', 'learned'))
    rows = [exact, learned, replace(exact, method='gauss16', error=(0.0,))]
    notes = {number: [_note(PLAN.cases[number - 1], row.method, rows) for row in rows]
             for number in (7, 12)}
    assert notes == {7: ['', '', ' (exact H only)'], 12: ['', '', ' (the reference)']}
    ax = Figure().subplots()
    _draw_panel(ax, PLAN.cases[17], '', [replace(exact, t=(), alarm='no convergence at step 9')],
                False)
    assert [text.get_text() for text in ax.texts] == [
        'variational_euler stopped:\nno convergence at step 9']


def test_page_keeps_the_cases_that_a_run_leaves_out(short, tmp_path):
    there, parts = Path(__file__).parents[2] / 'docs/evidence/hard_cases', tmp_path / 'hard_cases'
    parts.mkdir()
    for name in ('hard_cases.csv', 'hard_cases.json'):
        shutil.copy(there / name, parts / name)
    assert hard_cases.main(['--quick', '--case', '14', '--out', str(short), '--docs',
                            str(tmp_path)]) == 0

    def rows(folder: Path, of_case: bool) -> list[str]:
        lines = (folder / 'hard_cases.csv').read_text().splitlines()
        return [line for line in lines if line.startswith('14,') == of_case]

    assert rows(parts, False) == rows(there, False) and len(rows(there, False)) > 400
    assert rows(parts, True) == rows(short, True) != rows(there, True)
    page = (tmp_path / 'hard-cases.md').read_text()
    assert '## Case 1: long horizon' in page and 'The figure shows the first 1e5 steps.' in page
