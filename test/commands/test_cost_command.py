# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command that tells what accuracy costs: its table, its files, and what it refuses."""

from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
import csv
from io import StringIO
from pathlib import Path
import re
import sys

from hnn_vi_ros.commands import cost, cost_figure
from hnn_vi_ros.errors import CalibrationError, HnnViRosError
from hnn_vi_ros.files import parse_yaml, standard_streams
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import InitialValueProblem, Method, Tolerance
from hnn_vi_ros.simulation.accuracy import cost as core
from hnn_vi_ros.simulation.accuracy.automatic_choice import calibrate
from hnn_vi_ros.simulation.accuracy.trials import CalibrationTask
from messages import refused
import numpy as np
from PIL import Image
import pytest
from python_process import run_code
from scene_files import write_scene

KINDS = ('gauss8', 'stormer_verlet', 'rk4', 'lie_leapfrog')


@pytest.fixture(scope='module', autouse=True)
def few() -> Iterator[None]:
    """Measure few methods, so that little is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core, 'INTEGRATORS', {kind: INTEGRATORS[kind] for kind in KINDS})
        yield


@pytest.fixture(scope='module')
def study(few, tmp_path_factory) -> tuple[str, Path, Path]:
    """Return what a study prints, its picture and its rows."""
    folder = tmp_path_factory.mktemp('study')
    picture, rows = folder / 'cost.png', folder / 'cost.csv'
    with (redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err,
          pytest.MonkeyPatch.context() as patch):
        # A busy machine takes longer than nothing is said for.
        patch.setattr(standard_streams, '_LOG_INTERVAL', np.inf)
        assert cost.main(['exact_pendulum', '--error', '1e-6', '--duration', '5', '--plot',
                          str(picture), '--csv', str(rows)]) == 0
    assert err.getvalue() == ''
    return out.getvalue(), picture, rows


def test_table_picture_and_rows_are_of_one_study(study):
    out, picture, rows = study
    assert 'exact_pendulum: path errors up to 5 s' in out
    assert 'reference: exact: Jacobi elliptic functions, accurate to ' in out
    assert re.search(r'omitted, because each needs rotations .*: lie_leapfrog\n', out)
    with rows.open() as file:
        lines = list(csv.DictReader(file))
    assert {line['method'] for line in lines} == {*KINDS} - {'lie_leapfrog'}
    # Each cell of the table is the cheapest row of its method within the error of its column.
    head = next(line for line in out.splitlines() if line.startswith('error'))
    errors = [float(word) for word in head.split()[1:]]
    for kind in ('gauss8', 'stormer_verlet', 'rk4'):
        cells = re.split(r' {2,}', next(
            line for line in out.splitlines() if line.startswith(f'{kind} ')).strip())[1:]
        for error in errors:
            good = [line for line in lines if line['method'] == kind and line['status'] == 'ok'
                    and float(line['path_error']) <= error]
            if not good:
                assert cells.pop(0) == '-'
                continue
            best = min(good, key=lambda line: float(line['seconds_per_simulated_second']))
            step, time = cells.pop(0), cells.pop(0).strip('*')
            assert step == f'{float(best["step_size"]):.3g}'
            assert float(time) == pytest.approx(
                1e6 * float(best['seconds_per_simulated_second']), rel=0.01)
    # In each column one is the cheapest.
    assert out.count('*') == len(errors) + 1
    with Image.open(picture) as image:
        assert image.width >= 1500
        # Lines of several colours on white.
        assert len(image.convert('RGB').getcolors(10**6)) > 100


def test_what_is_recommended_can_be_pasted_and_holds(study):
    text = study[0].partition('Recommended for ')[2].partition('\n\n')[2]
    chosen = parse_yaml(text, 'what was printed', HnnViRosError)[0]
    scene = load_scene('exact_pendulum').changed(chosen)
    hamiltonian = scene.create_hamiltonian()
    start = np.array(scene.initial_state.q), np.array(scene.initial_state.p)
    own = scene.integrator.model_dump(exclude={'kind'}, exclude_defaults=True)
    problem = InitialValueProblem(hamiltonian, (), *start)
    simulation = problem.simulation(Method(scene.integrator.kind, own), scene.known_step_size)
    steps = round(5.0 / scene.known_step_size)
    q, p = simulation.record(steps, 1)
    t = scene.known_step_size * np.arange(1, steps + 1)
    exact = hamiltonian.exact_motion(*start, t).path
    assert np.abs(np.hstack([q, p]) - exact).max() <= 1e-6


def test_recommendation_is_the_choice_of_auto_for_the_same_question(capsys):
    scene = load_scene('exact_pendulum')
    assert cost.main(['exact_pendulum', '--error', '1e-5', '--duration', '4', '--rate', '20',
                      '--seconds', '1']) == 0
    text = capsys.readouterr().out.partition('Recommended for ')[2].partition('\n\n')[2]
    chosen = parse_yaml(text, 'what was printed', HnnViRosError)[0]
    problem = InitialValueProblem(scene.create_hamiltonian(), (), *map(
        np.array, (scene.initial_state.q, scene.initial_state.p)))
    choice = calibrate(CalibrationTask(problem, Tolerance('path_error', 1e-5, 4.0), 0.05))
    assert chosen == {'integrator': {'kind': choice.method, **choice.arguments},
                      'step_size': choice.step_size}
    parts = 0.05 / choice.step_size
    assert parts == pytest.approx(round(parts), rel=1e-12)


def test_steps_for_a_rate_divide_its_interval(tmp_path):
    rows = tmp_path / 'rows.csv'
    assert cost.main(['exact_pendulum', '--duration', '1', '--rate', '30', '--seconds', '5',
                      '--csv', str(rows)]) == 0
    with rows.open() as file:
        parts = [1.0 / (30.0 * float(line['step_size'])) for line in csv.DictReader(file)]
    assert len(parts) > 3 and parts == pytest.approx(np.round(parts), rel=1e-12)
    assert min(parts) >= 1.0 - 1e-12


def test_error_that_nothing_holds_is_refused_after_the_table_and_the_files(capsys, tmp_path):
    rows = tmp_path / 'rows.csv'
    with pytest.raises(CalibrationError, match='path_error 1e-15 up to 1 s: .* round-off'):
        cost.main(['exact_pendulum', '--error', '1e-15', '--duration', '1', '--csv', str(rows)])
    assert 'gauss8' in capsys.readouterr().out and 'gauss8' in rows.read_text()


def test_first_method_has_results_however_little_time_there_is(capsys):
    assert cost.main(['exact_pendulum', '--seconds', '1e-6']) == 0
    out = capsys.readouterr().out
    assert re.search(r'^gauss8 +[0-9.]+  [0-9.]+\*', out, re.M), out
    assert 'no time for: stormer_verlet, rk4; run it again' in out


@pytest.mark.parametrize(('model', 'line'), [
    ('pendulum', 'H by 0.00028 J (RMS in its box), of a spread of 12 J'),
    ('emps_drive', 'coordinates by 0.0016 after 0.5 s (RMS of held-out motions), H by 0.46 J')])
def test_error_of_a_learned_model_is_beside_those_of_methods(model, line, capsys):
    assert cost.main([model, '--seconds', '1e-6', '--duration', '0.1']) == 0
    found, = re.findall(r'error of the model .* itself, which no method reduces: .*',
                        capsys.readouterr().out)
    assert line in found


@pytest.mark.long
def test_scene_with_auto_effects_and_events_is_measured(tmp_path, capsys):
    path = tmp_path / 'mine.yaml'
    path.write_text(
        'hamiltonian: {kind: pendulum}\nintegrator: {kind: auto, energy_error: 1.0e-3, '
        'horizon: 10.0}\neffects: [{kind: damping, rate: 0.1}]\n'
        'events: [{when: angle = 0, then: log}]\ninitial_state: {q: [1.0], p: [0.0]}\n')
    assert cost.main([str(path), '--duration', '2']) == 0
    out = capsys.readouterr().out
    assert 'events of the scene are not detected' in out
    assert re.search(r'^gauss8 ', out, re.M)


@pytest.mark.parametrize('words', [
    'nothing', 'exact_pendulum --error 0', 'exact_pendulum --error nan',
    'exact_pendulum --rate 0', 'exact_pendulum --duration -1',
    'exact_pendulum --seconds inf', 'exact_pendulum --plot a.jpg',
    'exact_pendulum --csv no/folder.csv', 'exact_pendulum --csv there.csv', 'mine.yaml'])
def test_bad_input_is_one_line_before_any_time_is_spent(words, monkeypatch, tmp_path):
    monkeypatch.setattr(cost, 'measure_costs', lambda *arguments: pytest.fail('it was measured'))
    monkeypatch.chdir(tmp_path)
    Path('there.csv').touch()
    write_scene(Path('mine.yaml'), 'double_pendulum', '', 'stormer_verlet', q=[1.0, 0.0],
                p=[0.0, 0.0])
    with refused(HnnViRosError):
        cost.main(words.split())


def test_file_that_cannot_be_written_is_one_line(tmp_path, monkeypatch):
    def full(*arguments: object) -> None:
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr(cost, '_write_csv', full)
    with pytest.raises(OSError, match='No space') as found:
        cost.main(['exact_pendulum', '--seconds', '1e-6', '--csv', str(tmp_path / 'a.csv')])
    assert found.value.filename == str(tmp_path / 'a.csv')
    assert [*tmp_path.iterdir()] == []


def test_every_method_has_a_line_of_its_own():
    assert cost_figure.STYLES.keys() == INTEGRATORS.keys()
    # Those that are made for rotations are in no picture with the others.
    for turning in (True, False):
        looks = [style for kind, style in cost_figure.STYLES.items()
                 if kind.startswith('lie_') == turning]
        assert len(set(looks)) == len(looks)


def test_exact_scene_needs_no_torch_and_without_a_picture_no_matplotlib():
    """As of a pip install without the extra of training, which lacks tqdm as well."""
    code = ('import sys\nfor name in ("torch", "tqdm", "matplotlib", "rclpy"):\n'
            '    sys.modules[name] = None\n'
            'sys.argv = ["hnn", "cost", "exact_pendulum", "--duration", "1", "--seconds", "1"]\n'
            'from hnn_vi_ros.cli import main\nmain()')
    result = run_code(code)
    assert result.returncode == 0, result.stderr
    assert 'exact_pendulum: path errors up to 1 s' in result.stdout


def test_progress_is_a_bar_on_a_terminal_and_elsewhere_a_line_now_and_then(monkeypatch, capsys):
    clock = iter([0.0, 1.0, 11.0, 12.0, 22.0])
    monkeypatch.setattr(standard_streams.time, 'monotonic', lambda: next(clock))
    line = standard_streams.ProgressLine()
    for share in (0.1, 0.2, 0.3, 0.4):
        line.show(share, 'rk4')
    line.close()
    # After 10 s at the earliest, and 10 s from one to the next.
    assert capsys.readouterr().err == ' 20%  rk4\n 40%  rk4\n'
    clock = iter([0.0, 1.0])
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    bar = standard_streams.ProgressLine()
    bar.show(0.5, 'gauss8')
    bar.close()
    assert capsys.readouterr().err == f'\r\x1b[K[{"#" * 12}{"." * 12}]  50%  gauss8\r\x1b[K'
