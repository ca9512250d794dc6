# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Study of accuracy and cost: rows, peers and references agree with other sources; its page."""

from collections import Counter
import dataclasses
import math
from pathlib import Path
import re

from helpers import exact_pendulum, problem_of, random_checkpoint
from hnn_vi_ros.errors import HnnViRosError, ParameterError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import EnergyError, NeuralHamiltonian
from hnn_vi_ros.simulation.accuracy import cost
from hnn_vi_ros.simulation.accuracy.cost import run_errors
from hnn_vi_ros.simulation.accuracy.path_reference import best_reference
from hnn_vi_ros.simulation.accuracy.trials import survey
from messages import refused
import numpy as np
import pytest
from studies import accuracy_page, explore_page, measuring, work_precision
from studies.measuring import measure_rows, Peer, peer_row, StudyRow
from studies.peers import create_peers, jax_energy, scipy_peers
from studies.references import Floor, floor_of, make_reference, ModelDiscrepancy, true_hamiltonian
from studies.results import keep_results, read_results, Results
from studies.work_precision import SCENES


@pytest.fixture(autouse=True)
def few_pictures(monkeypatch):
    """Draw one picture with and one without the error of a model; the others are the same."""
    def draw_some(path: Path, *arguments) -> Path:
        if path.name in ('pendulum_10s.png', 'kepler_10s.png'):
            return draw(path, *arguments)
        path.touch()
        return path

    draw = accuracy_page.draw
    monkeypatch.setattr(accuracy_page, 'draw', draw_some)
    # test_explore_page.py tests the explorer, which needs plotly.
    monkeypatch.setattr(explore_page, '_plotly', str)


def test_study_has_rows_of_methods_and_peers_for_each_horizon(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, 'INTEGRATORS', {
        kind: INTEGRATORS[kind] for kind in ('gauss8', 'rk4')})
    monkeypatch.setattr(work_precision, '_peers', lambda problem: scipy_peers(problem.hamiltonian))
    # Two methods end long before the default budget of time.
    assert work_precision.main(['--scenes', 'exact_pendulum', '--horizons', '2', '1', '--docs',
                                str(tmp_path), '--peers']) == 0
    results = accuracy_page.results_of(tmp_path)['exact_pendulum']
    assert results.horizons == [1.0, 2.0] == [*results.floors]
    for horizon, floor in results.floors.items():
        rows = results.of(horizon)
        assert {row.method.partition(' tolerance=')[0] for row in rows} == {
            'gauss8', 'rk4', 'scipy DOP853', 'scipy RK45'}
        good = [row for row in rows if row.finished]
        # The table has six digits.
        assert all(row.path_error >= 0.99999 * floor.accuracy and row.energy_band >= 0.0
                   and row.seconds_per_simulated_second > 0.0 for row in good)
        # Four gradients a step, and the energies are in J.
        assert all(row.gradients_per_simulated_second == pytest.approx(4.0 / row.step_size)
                   for row in good if row.method == 'rk4')
    assert '| exact_pendulum | 1 | ' in (tmp_path / accuracy_page.PAGE).read_text()


def test_energy_band_of_a_row_is_in_joules():
    problem = problem_of('exact_pendulum')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, 'INTEGRATORS', {'rk4': INTEGRATORS['rk4']})
        rows, reference = measure_rows(problem, [], 1.0, 1.0)
    for row in rows:
        errors = run_errors(problem.simulation('rk4', row.step_size), reference)
        assert row.energy_band == pytest.approx(errors.energy, rel=1e-12)
        assert row.path_error == max(errors.path, reference.accuracy)


@pytest.mark.parametrize('options', [
    '--scenes nothing', '--scenes kepler --horizons -1', '--scenes kepler --seconds nan',
    '--scenes damped_driven_pendulum', '--scenes kepler --docs /dev/null/x'])
def test_bad_input_is_one_line_before_any_time_is_spent(options, monkeypatch, tmp_path):
    monkeypatch.setattr(work_precision, 'measure', lambda *_: pytest.fail('it was measured'))
    monkeypatch.chdir(tmp_path)
    with refused(HnnViRosError):
        work_precision.main(options.split())


@pytest.mark.long
def test_learned_pendulum_carries_the_error_of_the_model():
    problem = problem_of('pendulum')
    truth = true_hamiltonian(problem.hamiltonian)
    assert isinstance(truth, Pendulum)
    assert (truth.mass, truth.length, truth.gravity) == (1.0, 1.0, 9.81)
    model = floor_of(make_reference(problem.hamiltonian, problem.q, problem.p, 10.0),
                     problem.hamiltonian, problem.q, problem.p).model
    # The learned motion against the formula, from another solver and another formula.
    z = np.array([2.5, 0.0])
    (peer, _) = scipy_peers(problem.hamiltonian)
    errors, energies = [], []
    for k in range(1, 121):
        z, _ = peer.solve(z, 10.0 / 120, 1e-12)
        errors.append(np.abs(z - exact_pendulum(2.5, 0.0, 10.0 * k / 120)).max())
        energies.append(abs(truth.energy(z[:1], z[1:]) - truth.energy([2.5], [0.0])))
    # 120 states of 960 find most of the largest.
    assert model.path == pytest.approx(max(errors), rel=0.1)
    assert model.energy == pytest.approx(max(energies), rel=0.1)


def test_error_of_a_model_is_known_as_far_as_gradients_let_a_path_reach():
    problem = problem_of('pendulum')
    whole = make_reference(problem.hamiltonian, problem.q, problem.p, 1.0)
    part = dataclasses.replace(whole, states=whole.states[:600])
    errors = [floor_of(reference, problem.hamiltonian, problem.q, problem.p).model.path
              for reference in (part, whole)]
    assert 0.0 < errors[0] < errors[1]


def test_error_of_a_model_does_not_depend_on_the_instants_of_the_reference():
    problem, errors = problem_of('pendulum'), []
    for base in (0.1, 1.0):
        reference = best_reference(problem, 1.0, base, survey(problem, 1.0, base), math.inf)
        errors.append(floor_of(reference, problem.hamiltonian, problem.q, problem.p).model.path)
    # Paths are compared at hundreds of instants.
    assert errors[0] == pytest.approx(errors[1], rel=0.01)


def test_scipy_peer_is_measured_with_our_gradient():
    problem = problem_of('exact_pendulum')
    reference = make_reference(problem.hamiltonian, problem.q, problem.p, 10.0)
    rows = [peer_row(peer, 1e-8, problem, reference)
            for peer in scipy_peers(problem.hamiltonian)]
    assert [row.method for row in rows] == [
        'scipy DOP853 tolerance=1e-08', 'scipy RK45 tolerance=1e-08']
    # A tolerance of 1e-8 a step, amplified over 10 s next to the separatrix.
    assert all(1e-10 < row.path_error < 1e-4 and row.status == 'ok' for row in rows)
    assert all(np.isnan(row.step_size) for row in rows)
    # The method of order 8 takes fewer gradients; seconds depend on what else the machine does.
    best = min(rows, key=lambda row: row.gradients_per_simulated_second)
    assert best.method.startswith('scipy DOP853')


def test_peer_that_fails_is_a_row_with_its_reason():
    problem = problem_of('exact_pendulum')
    reference = make_reference(problem.hamiltonian, problem.q, problem.p, 1.0)
    peer = Peer('a peer', False, lambda z, duration, setting: (np.nan * z, 1))
    row = peer_row(peer, 0.1, problem, reference)
    assert row.failed and row.status == 'not finite after t = 0 s'
    assert np.isnan([row.path_error, row.seconds_per_simulated_second]).all()


def test_path_error_of_a_peer_is_the_largest_of_ten_instants():
    problem = problem_of('exact_pendulum')
    reference = make_reference(problem.hamiltonian, problem.q, problem.p, 1.0)
    (exact, _), durations = scipy_peers(problem.hamiltonian), []

    def solve(z, duration, setting):
        """Err in the middle of the path alone."""
        durations.append(duration)
        end, gradients = exact.solve(z, duration, 1e-12)
        return end + 0.01 * (len(durations) == 5), gradients

    assert 0.009 < peer_row(Peer('a peer', True, solve), 1e-8, problem, reference).path_error
    assert durations[:10] == 10 * [0.1] and durations[10] == 1.0


def test_slow_peers_are_stopped_after_a_row_and_others_are_measured_whole(monkeypatch):
    """The clock is one of calls: a millisecond for the fast peer, a hundred for the slow one."""
    problem, clock = problem_of('exact_pendulum'), [0.0]
    (inner, _) = scipy_peers(problem.hamiltonian)
    monkeypatch.setattr(cost, 'INTEGRATORS', {'rk4': INTEGRATORS['rk4']})
    study = cost.measure_costs(problem, 1.0, 1.0)
    study.costs.clear()
    monkeypatch.setattr(measuring, 'measure_costs', lambda *_, **__: study)
    monkeypatch.setattr(measuring.time, 'process_time', lambda: clock[0])

    def peer(name, seconds):
        def solve(z, duration, setting):
            clock[0] += seconds * duration
            return inner.solve(z, duration, setting)
        return Peer(name, True, solve)

    rows, _ = measure_rows(problem, [peer('a fast', 1e-3), peer('a slow', 0.1)], 1.0, 1.0)
    counts = Counter(row.family for row in rows)
    assert counts['a fast'] == len(measuring.TOLERANCES) and counts['a slow'] == 1


def test_peers_refuse_a_network_that_is_not_of_tanh():
    checkpoint = random_checkpoint([2, 8, 1], seed=1)
    card = checkpoint.card.model_copy(update={'activation': 'sine'})
    with refused(ParameterError):
        create_peers(NeuralHamiltonian(dataclasses.replace(checkpoint, card=card)))


@pytest.mark.long
@pytest.mark.parametrize('scene, more', [
    ('pendulum', {'torchdiffeq dopri5', 'torchdiffeq dopri8', 'torchdiffeq rk4'}),
    ('kepler', {'diffrax SemiImplicitEuler'})])
def test_peers_solve_the_same_motion(scene, more):
    for package in ('torchdiffeq', 'diffrax'):
        pytest.importorskip(package, reason=f'{package} is not installed; see `make bench`')
    problem = problem_of(scene)
    reference = make_reference(problem.hamiltonian, problem.q, problem.p, 1.0)
    rows = [peer_row(peer, 1e-8 if peer.adaptive else 1e-3, problem, reference)
            for peer in create_peers(problem.hamiltonian)]
    assert {row.method.partition(' tolerance=')[0] for row in rows} == more | {
        'scipy DOP853', 'scipy RK45', 'diffrax Tsit5', 'diffrax Dopri8'}
    for row in rows:
        # Order 1 with h = 1e-3; the others at a tolerance of 1e-8 or h^4 = 1e-12, of which
        # torchdiffeq's dopri8 makes 1.6e-5.
        assert row.path_error < (1e-2 if 'Euler' in row.method else 1e-4)
        assert row.status == 'ok' and row.gradients_per_simulated_second > 0.0


def test_formula_in_jax_is_the_compiled_one():
    jax = pytest.importorskip('jax', reason='jax is not installed; see `make bench`')
    for name in HAMILTONIANS:
        hamiltonian = HAMILTONIANS[name]()
        if hamiltonian.rotations:
            continue
        z = np.random.default_rng(1).uniform(0.1, 1.0, 2 * hamiltonian.dimension)
        gradient = np.asarray(jax.grad(jax_energy(hamiltonian))(z))
        exact = np.concatenate(hamiltonian.gradient(*np.split(z, 2)))
        assert np.abs(gradient - exact).max() <= 1e-12 * max(1.0, np.abs(exact).max()), name


BOX_ERROR = EnergyError(against='true energy', rms=2e-4, rms_interval=[1e-4, 3e-4], sup=8e-4,
                        spread=2.0, states=2000)


def invent(scene: str) -> Results:
    """Return rows whose errors and times follow from the order of each method."""
    model = None if scene in ('kepler', 'henon_heiles') or scene.startswith('exact') \
        else ModelDiscrepancy(1e-3, 1e-4, BOX_ERROR)
    rows = []
    for horizon in (10.0, 1000.0):
        for method, order, price, drift in (
                ('variational_euler', 1, 3.0, 0.0), ('rk4', 4, 4.0, 1.0), ('gauss8', 8, 20.0, 0.0),
                ('scipy DOP853 tolerance=1e-06', 8, 80.0, 1.0)):
            for h in (0.1, 0.05) if '=' not in method else (float('nan'),):
                size = 0.1 if '=' in method else h
                error = size ** order * horizon / 10.0
                band = size ** order * (horizon / 10.0) ** drift
                seconds = 1e-6 * price / size
                rows.append(StudyRow(method, h, horizon, error, band, seconds, seconds,
                                     price / size, 'ok'))
    floors = {horizon: Floor('exact: invented', 1e-12, model) for horizon in (10.0, 1000.0)}
    return Results({'scene': scene, 'version': '0', 'machine': 'none', 'number of --runs': '3'},
                   ['abc1234'], floors, rows)


def test_page_says_of_each_method_what_its_rows_say(tmp_path):
    results = {scene: invent(scene) for scene in SCENES}
    results['kepler'].commits = ['0therone']
    keep_results(tmp_path / accuracy_page.FOLDER, results)
    written = accuracy_page.write_pages(tmp_path)
    assert len(written) == 3 + 2 * len(SCENES) and all(path.is_file() for path in written)
    text = written[0].read_text()
    # gauss8 at h = 0.1 costs 200 us; variational_euler at its best, h = 0.05, 60, rk4 at 0.1, 40.
    assert 'are 0.05 to 0.05.\n' in text and 'takes 67 to 67 % of its time.' in text
    # rk4's band of 6e-6 J at h = 0.05 has become 6e-4 J.
    assert f'In {len(SCENES)} scenes' in text and 'by a factor of 1e+02 to 1e+02.' in text
    # The peer takes 800 us and reaches 1e-8; rk4 at h = 0.1 takes 40, gauss8 200 and then 400.
    assert ('| pendulum | 10 | rk4 h=0.1: 40 (0.05) | rk4 h=0.1: 40 (0.05) | '
            'gauss8 h=0.1: 200 (0.25) | gauss8 h=0.05: 400 |') in text
    assert 'is faster at some' not in text
    # The picture, the explorer, the commits, and two pictures of each scene.
    assert text.count('](accuracy/') == 3 + 2 * len(SCENES)
    kept = read_results(tmp_path / accuracy_page.FOLDER)
    assert kept['kepler'].commits == ['0therone']
    assert kept['pendulum'].floors == results['pendulum'].floors
    assert '| 0.001 | ' in text and '| 0.0002 (95 %: 0.0001 to 0.0003), 0.0008 |' in text
    assert len(text.splitlines()) <= 400
    # Those to other folders are checked with the pages of the docs.
    for link in re.findall(r'\]\((?!#|\.\./)([^)]+)\)', text):
        assert (tmp_path / link).is_file() or link == 'benchmarks.md'


def test_page_names_scenes_in_which_a_peer_is_faster():
    results = {scene: invent(scene) for scene in ('pendulum', 'kepler')}
    rows = results['kepler'].rows
    rows += [dataclasses.replace(rows[0], method=method, step_size=math.nan, path_error=1e-9,
                                 seconds_per_simulated_second=seconds,
                                 gradients_per_simulated_second=10.0)
             for method, seconds in (('dop853 tolerance=1e-10', 8e-5),
                                     ('diffrax Dopri8 tolerance=1e-10', 4e-5))]
    text = accuracy_page.as_page(results)
    assert 'kepler 2 (T = 10 s, error 1e-06)' in text


def test_results_of_other_scenes_stay(tmp_path):
    keep_results(tmp_path, {'heavy_top': invent('heavy_top')})
    keep_results(tmp_path, {'kepler': invent('kepler')})
    assert read_results(tmp_path).keys() == {'heavy_top', 'kepler'}


def test_page_shows_no_horizon_that_most_rows_were_not_run_to():
    results = {scene: invent(scene) for scene in ('kepler', 'henon_heiles', 'pendulum')}
    for scene, entry in results.items():
        entry.floors[1e5] = Floor('exact: invented', 1e-12)
        late = []
        for row in entry.of(1000.0):
            row = dataclasses.replace(row, horizon=1e5)
            arrived = scene == 'henon_heiles' or (scene == 'kepler' and row.method == 'gauss8')
            late.append(row if arrived else dataclasses.replace(
                row, path_error=np.nan, energy_band=np.nan, status='too long: about 9 s'))
        results[scene] = Results(entry.identity, entry.commits, entry.floors,
                                 [*entry.rows, *late])
    text = accuracy_page.as_page(results)
    # The page of all scenes shows no longer horizons. Of kepler a third was run: what lacks would
    # read as if nothing were good enough.
    assert '| henon_heiles | 1000 |' in text and '| henon_heiles | 100000 |' not in text
    assert '(accuracy/henon_heiles_100000s.png) | 100000 |' in text
    assert '(accuracy/kepler_100000s.png)' not in text
    assert re.search(r'Not shown anywhere: T = 100000 s of kepler, pendulum;', text)
