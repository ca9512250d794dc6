# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What the work-precision study reports is what was asked for, and agrees with other sources."""

import csv
import dataclasses
from pathlib import Path
import re

from helpers import exact_pendulum, random_checkpoint
from hnn_vi_ros.errors import HnnViRosError, ParameterError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.models.box_error import EnergyError
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.scene import load_scene
from messages import refused
import numpy as np
from PIL import Image
import pytest
from studies import accuracy_page, explore_page, work_precision, work_precision_report
from studies.measuring import measure_row, PeerRun, StudyRow, whole_steps
from studies.peers import create_peers, jax_energy, scipy_peers
from studies.references import Floor, make_reference, ModelDiscrepancy, true_hamiltonian
from studies.results import read_rows, Results
from studies.work_precision import SCENES

COLUMNS = ['method', 'step_size', 'horizon', 'path_error', 'energy_band',
           'seconds_per_simulated_second', 'p95_seconds', 'gradients_per_simulated_second',
           'status']


@pytest.fixture(autouse=True)
def few_pictures(request, monkeypatch):
    """Draw where a picture is looked at, lacks a reference, or has a failure: it takes seconds."""
    def touch(path: Path, *arguments) -> Path:
        path.touch()
        return path
    if not re.search('columns|chaotic|failed', request.node.name):
        monkeypatch.setattr(work_precision_report, 'draw', touch)


def study(folder: Path, scene: str, *options: str) -> list:
    """Run a study of few runs; return its rows."""
    assert work_precision.main(['--scene', scene, '--out', str(folder), '--runs', '3',
                                *options]) == 0
    return read_rows(folder / 'work_precision.csv')


def rk4(field, z: np.ndarray, h: float, steps: int, every: int) -> np.ndarray:
    """Take steps of the classical method; return every so many of the states."""
    path = []
    for n in range(1, steps + 1):
        a = field(z)
        b = field(z + 0.5 * h * a)
        c = field(z + 0.5 * h * b)
        z = z + h / 6.0 * (a + 2.0 * b + 2.0 * c + field(z + h * c))
        if n % every == 0:
            path.append(z)
    return np.array(path)


def test_errors_agree_with_an_independent_computation(tmp_path):
    (row,) = study(tmp_path, 'exact_pendulum', '--methods', 'rk4', '--steps', '0.05', '--horizons',
                   '10')
    start = load_scene('exact_pendulum').initial_state
    path = rk4(lambda z: np.array([z[1], -9.81 * np.sin(z[0])]), np.array([*start.q, *start.p]),
               0.05, 200, 1)
    # 200 steps meet 40 of the 960 instants; the table has six digits.
    states = np.array([exact_pendulum(2.5, 0.0, 0.25 * k) for k in range(1, 41)])
    assert row.path_error == pytest.approx(np.abs(path[4::5] - states).max(), rel=1e-5)
    q, p = np.vstack([[*start.q, *start.p], path]).T
    energies = 0.5 * p ** 2 + 9.81 * (1.0 - np.cos(q))
    assert row.energy_band == pytest.approx(np.abs(energies - energies[0]).max(), rel=1e-5)
    assert row.gradients_per_simulated_second == 80.0


@pytest.mark.long
def test_chaotic_horizon_has_energies_only(tmp_path):
    rows = study(tmp_path, 'exact_double_pendulum', '--methods', 'gauss8', '--steps', '0.1',
                 '--horizons', '10', '500')
    assert [row.status for row in rows] == ['ok', 'energy only']
    assert np.isfinite(rows[0].path_error) and np.isnan(rows[1].path_error)
    assert all(0.0 < row.energy_band < 1e-2 for row in rows)
    assert 'No reference: the motion is chaotic' in (tmp_path / 'work_precision.md').read_text()
    # The second run reads the reference that is none from the folder.
    study(tmp_path, 'exact_double_pendulum', '--methods', 'gauss8', '--steps', '0.2',
          '--horizons', '10', '500')


def test_columns_and_files_are_those_of_the_interface(tmp_path):
    rows = study(tmp_path, 'exact_pendulum', '--methods', 'rk4', 'gauss8', '--steps', '0.1',
                 '0.05', '--horizons', '1', '2')
    with (tmp_path / 'work_precision.csv').open() as file:
        table = list(csv.reader(file))
    assert table[0] == COLUMNS
    assert len(table) == 9 and all(len(line) == 9 for line in table)
    assert {row.key for row in rows} == {
        (method, h, T) for method in ('rk4', 'gauss8') for h in (0.1, 0.05) for T in (1.0, 2.0)}
    assert all(0.0 < row.seconds_per_simulated_second <= row.p95_seconds for row in rows)
    for name in ('work_precision_1s.png', 'work_precision_2s.png'):
        with Image.open(tmp_path / name) as image:
            assert image.width >= 900
            assert len(image.convert('L').getcolors(256)) > 20
    assert re.search(r'\| 0.0001 \| (rk4|gauss8) \|', (tmp_path / 'work_precision.md').read_text())


def test_interrupted_study_keeps_its_rows_and_measures_none_twice(tmp_path, monkeypatch):
    options = ['--scene', 'exact_pendulum', '--methods', 'rk4', '--steps', '0.1', '0.05', '0.025',
               '--horizons', '1', '--runs', '1', '--out', str(tmp_path)]
    measured = []

    def stop_at_the_third(run, *arguments):
        if len(measured) == 2:
            raise KeyboardInterrupt
        measured.append(run.step_size)
        return measure_row(run, *arguments)

    monkeypatch.setattr(work_precision, 'measure_row', stop_at_the_third)
    with refused(KeyboardInterrupt):
        work_precision.main(options)
    first = read_rows(tmp_path / 'work_precision.csv')
    # A crash in the middle of a line costs that line.
    with (tmp_path / 'work_precision.csv').open('a') as file:
        file.write('rk4,0.025,1.0,0.1,0.1,0.1,0.1,0.1,o')
    measured.append('go on')
    assert work_precision.main(options) == 0
    assert measured == [0.1, 0.05, 'go on', 0.025]
    rows = read_rows(tmp_path / 'work_precision.csv')
    assert rows[:2] == first and rows[2].status == 'ok'


def test_failed_run_is_a_row_with_its_reason(tmp_path):
    # Energies grow beyond 1/6, the orbit escapes and overflows.
    rows = study(tmp_path, 'henon_heiles', '--methods', 'explicit_euler', '--steps', '1', '0.5',
                 '--horizons', '100', '200')
    assert len(rows) == 4
    for row in rows:
        assert re.fullmatch(r'not finite at t = \d+(\.\d+)? s', row.status) and row.failed
        assert np.isnan([row.path_error, row.energy_band]).all()
        assert row.seconds_per_simulated_second > 0.0
    assert (tmp_path / 'work_precision_200s.png').is_file()


def test_run_that_would_take_too_long_is_left_until_the_limit_allows_it(tmp_path):
    options = ['exact_pendulum', '--methods', 'rk4', '--steps', '0.1', '--horizons', '1', '10']
    rows = study(tmp_path, *options, '--limit', '1e-9')
    assert [row.status.partition(':')[0] for row in rows] == ['ok', 'too long']
    assert not rows[1].failed
    assert [row.status for row in study(tmp_path, *options)] == ['ok', 'ok']


@pytest.mark.parametrize('options', [
    '--scene nothing', '--scene kepler --methods euler', '--scene kepler --methods gauss8@tight',
    '--scene kepler --methods gauss8@0', '--scene kepler --methods rk4@1e-4',
    '--scene kepler --methods gauss8@float32', '--scene pendulum --methods stormer_verlet',
    '--scene kepler --methods discrete_euler_lagrange',
    '--scene kepler --horizons 10 --steps 0.3', '--scene kepler --horizons 0.03',
    '--scene kepler --horizons -1', '--scene kepler --steps nan', '--scene damped_driven_pendulum',
    '--scene kepler --out /dev/null/x'])
def test_bad_input_is_one_line_before_any_time_is_spent(options, monkeypatch, tmp_path):
    monkeypatch.setattr(work_precision, 'measure', lambda study: pytest.fail('it was measured'))
    monkeypatch.chdir(tmp_path)
    with refused(HnnViRosError):
        work_precision.main(options.split())


def test_results_of_something_else_are_refused(tmp_path):
    options = ['--methods', 'rk4', '--steps', '0.1', '--horizons', '1']
    study(tmp_path, 'exact_pendulum', *options)
    with refused(HnnViRosError):
        study(tmp_path, 'kepler', *options)
    with refused(HnnViRosError):
        study(tmp_path, 'exact_pendulum', *options, '--runs', '4')
    (tmp_path / 'work_precision.json').write_text('{')
    with refused(HnnViRosError):
        study(tmp_path, 'exact_pendulum', *options)
    (tmp_path / 'work_precision.json').unlink()
    with refused(HnnViRosError):
        study(tmp_path, 'exact_pendulum', *options)


def test_steps_divide_a_horizon_or_not():
    for horizon, step_size, steps in [(10.0, 0.2, 50), (1e5, 0.2 / 256, 128_000_000),
                                      (10.0, 0.3, None), (0.1, 0.2, None)]:
        assert whole_steps(horizon, step_size) == steps


@pytest.mark.long
def test_learned_pendulum_carries_the_error_of_the_model(tmp_path):
    hamiltonian = load_scene('pendulum').create_hamiltonian()
    truth = true_hamiltonian(hamiltonian)
    assert isinstance(truth, Pendulum)
    assert (truth.mass, truth.length, truth.gravity) == (1.0, 1.0, 9.81)
    study(tmp_path, 'pendulum', '--methods', 'gauss8', '--steps', '0.1', '--horizons', '10')
    text = (tmp_path / 'work_precision.md').read_text()
    found = re.search(r'causes a path error of (\S+) and an energy error of (\S+) J', text)
    # The learned motion against the formula, from another solver and another formula.
    z = np.array([2.5, 0.0])
    (peer, _) = scipy_peers(hamiltonian)
    errors, energies = [], []
    for k in range(1, 121):
        z, _ = peer.solve(z, 10.0 / 120, 1e-12)
        errors.append(np.abs(z - exact_pendulum(2.5, 0.0, 10.0 * k / 120)).max())
        energies.append(abs(truth.energy(z[:1], z[1:]) - truth.energy([2.5], [0.0])))
    # 120 states of 960 find most of the largest, and the page has two digits.
    assert float(found[1]) == pytest.approx(max(errors), rel=0.1)
    assert float(found[2]) == pytest.approx(max(energies), rel=0.1)
    assert 'Longest steps that reach this error: gauss8 0.1 s' in text


@pytest.mark.long
def test_single_precision_gradients_cost_the_digits_that_they_lack(tmp_path):
    double, single = study(tmp_path, 'pendulum', '--methods', 'rk4', 'rk4@float32', '--steps',
                           '0.005', '--horizons', '10')
    # Gradients of up to 10, in single precision: 6e-7 each, amplified along 10 s.
    assert 1e-7 < single.path_error < 1e-3
    assert double.path_error < 0.1 * single.path_error


def test_scipy_peer_is_measured_with_our_gradient():
    hamiltonian = HAMILTONIANS['pendulum']()
    reference = make_reference(hamiltonian, np.array([2.5]), np.array([0.0]), 10.0)
    rows = [measure_row(PeerRun(peer, 1e-8, hamiltonian, np.array([2.5, 0.0])), reference, 2)
            for peer in scipy_peers(hamiltonian)]
    assert [row.method for row in rows] == [
        'scipy DOP853 tolerance=1e-08', 'scipy RK45 tolerance=1e-08']
    # A tolerance of 1e-8 a step, amplified over 10 s next to the separatrix.
    assert all(1e-10 < row.path_error < 1e-4 and row.status == 'ok' for row in rows)
    assert all(np.isnan(row.step_size) for row in rows)
    # The method of order 8 takes fewer gradients; seconds depend on what else the machine does.
    best = min(rows, key=lambda row: row.gradients_per_simulated_second)
    assert best.method.startswith('scipy DOP853')


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
    loaded = load_scene(scene)
    hamiltonian = loaded.create_hamiltonian()
    start = np.array(loaded.initial_state.q), np.array(loaded.initial_state.p)
    reference = make_reference(hamiltonian, *start, 1.0)
    rows = [measure_row(PeerRun(peer, 1e-8 if peer.adaptive else 1e-3, hamiltonian,
                                np.concatenate(start)), reference, 1)
            for peer in create_peers(hamiltonian)]
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
                        sup_interval=[5e-4, 8e-4], spread=2.0, states=2000)


def invent(scene: str) -> Results:
    """Return rows whose errors and times follow from the order of each method."""
    model = None if scene in ('kepler', 'henon_heiles') or scene.startswith('exact') \
        else ModelDiscrepancy(1e-3, 1e-4, BOX_ERROR)
    rows = []
    for horizon in (10.0, 1000.0):
        for method, order, cost, drift in (
                ('variational_euler', 1, 3.0, 0.0), ('rk4', 4, 4.0, 1.0), ('gauss8', 8, 20.0, 0.0),
                ('gauss8@1e-4', 2, 10.0, 1.0), ('scipy DOP853 tolerance=1e-06', 8, 80.0, 1.0)):
            for h in (0.1, 0.05) if '=' not in method else (float('nan'),):
                size = 0.1 if '=' in method else h
                error = size ** order * horizon / 10.0
                band = size ** order * (horizon / 10.0) ** drift
                seconds = 1e-6 * cost / size
                rows.append(StudyRow(method, h, horizon, error, band, seconds, seconds,
                                     cost / size, 'ok'))
    floors = {horizon: Floor('exact: invented', 1e-12, model) for horizon in (10.0, 1000.0)}
    return Results({'scene': scene, 'version': '0', 'machine': 'none', 'number of --runs': '3'},
                   ['abc1234'], floors, rows)


def test_page_says_of_each_method_what_its_rows_say(tmp_path, monkeypatch):
    def draw_some(path: Path, *arguments) -> Path:
        """Draw one picture with and one without the error of a model: the others are the same."""
        if path.name in ('pendulum_10s.png', 'kepler_10s.png'):
            return draw(path, *arguments)
        path.touch()
        return path

    draw = accuracy_page.draw
    monkeypatch.setattr(accuracy_page, 'draw', draw_some)
    # The page to explore is tested by itself, with what it needs.
    monkeypatch.setattr(explore_page, '_plotly', str)
    results = {scene: invent(scene) for scene in SCENES}
    results['kepler'].commits = ['0therone']
    accuracy_page.keep_results(tmp_path, results)
    written = accuracy_page.write_pages(tmp_path)
    assert len(written) == 3 + 3 * len(SCENES) and all(path.is_file() for path in written)
    text = written[0].read_text()
    # gauss8 at h = 0.1 costs 200 us; variational_euler at its best, h = 0.05, 60, rk4 at 0.1, 40.
    assert 'are 0.05 to 0.05.\n' in text and 'takes 67 to 67 % of its time.' in text
    # rk4's band of 6e-6 J at h = 0.05 has become 6e-4 J.
    assert f'In {len(SCENES)} scenes' in text and 'by a factor of 1e+02 to 1e+02.' in text
    # The peer takes 800 us and reaches 1e-8; rk4 at h = 0.1 takes 40, gauss8 200 and then 400.
    assert ('| pendulum | 10 | rk4 h=0.1: 40 (0.05) | gauss8 h=0.1: 200 (0.25) | '
            'gauss8 h=0.05: 400 |') in text
    assert 'is faster at some' not in text
    # The picture, the explorer, the commits, and a page for each scene.
    assert text.count('](accuracy/') == 3 + len(SCENES)
    cards = explore_page.read_cards(tmp_path / accuracy_page.FOLDER)
    assert cards['kepler']['commits'] == ['0therone']
    pages = [path for path in written if path.suffix == '.md']
    pendulum = next(path for path in pages if path.stem == 'pendulum').read_text()
    assert ('Error of the learned H in its training domain: RMS 0.0002 J (95 %: 0.0001 to '
            '0.0003), largest 0.0008 J (95 %: 0.0005 to 0.0008).') in pendulum
    assert 'The learned H causes a path error of 0.001 and' in pendulum
    for page in pages:
        assert len(page.read_text().splitlines()) <= 400
        # Those to other folders are checked with the pages of the docs.
        for link in re.findall(r'\]\((?!#|\.\./)([^)]+)\)', page.read_text()):
            assert (page.parent / link).is_file()


def test_what_other_studies_keep_beside_the_page_stays(tmp_path):
    accuracy_page.keep_results(tmp_path, {'heavy_top': invent('heavy_top')})
    accuracy_page.keep_results(tmp_path, {'kepler': invent('kepler')})
    cards = explore_page.read_cards(tmp_path / accuracy_page.FOLDER)
    assert cards.keys() == {'heavy_top', 'kepler'}
    assert {path.stem for path in (tmp_path / accuracy_page.FOLDER).glob('*.csv')} == {*cards}


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
    assert '| henon_heiles | 1000 |' in text and '| 100000 |' not in text
    pages = {scene: accuracy_page.scene_page(scene, entry) for scene, entry in results.items()}
    assert '## T = 100000 s' in pages['henon_heiles']
    assert '## T = 100000 s' not in pages['kepler']
    assert re.search(r'Not shown anywhere: T = 100000 s of kepler, pendulum;', text)


def test_pages_of_what_is_not_measured_are_refused(tmp_path):
    with refused(HnnViRosError):
        accuracy_page.write_pages(tmp_path)
