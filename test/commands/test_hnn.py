# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The one command: it runs every executable, and what it has besides does what it says."""

import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from hnn_vi_ros import cli
from hnn_vi_ros.commands import COMMANDS, doctor, EXECUTABLES, run, scene_tool
from hnn_vi_ros.commands.table import GROUPS
from hnn_vi_ros.errors import AlarmWarning, ParameterError, SceneError
from hnn_vi_ros.files import shipped_file, shipped_names, standard_streams
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import simulate
from hnn_vi_ros.version import __version__
from messages import assert_message, refused
import numpy as np
import pytest
from python_process import run_code

SETUP = (Path(__file__).resolve().parents[2] / 'setup.py').read_text()


def ask(executable: str, *words: str) -> subprocess.CompletedProcess:
    """Run an executable; what it has imported is the last line that it prints."""
    code = ('import atexit, sys; atexit.register(lambda: print(*sys.modules)); '
            f'from hnn_vi_ros.cli import {executable}; {executable}()')
    return subprocess.run([sys.executable, '-c', code, *words], capture_output=True, text=True,
                          timeout=240, check=False)


def test_every_executable_is_a_command():
    assert set(EXECUTABLES) == set(re.findall(r"'(\w+) = hnn_vi_ros\.cli:\1'", SETUP))
    assert {*COMMANDS} - {*EXECUTABLES} == {
        'run', 'list', 'cost', 'check', 'export', 'doctor'}


def test_help_tells_all_commands_in_groups_without_what_they_take():
    result = ask('main', '--help')
    assert (result.returncode, result.stderr) == (0, '')
    *text, imported = result.stdout.splitlines()
    assert text[0].startswith('usage: hnn ')
    assert all(any(line.startswith(f'  {name} ') for line in text) for name in COMMANDS)
    assert [*GROUPS][:5] == ['simulate', 'learn', 'control', 'ROS', 'data']
    assert {f'{group}:' for group in GROUPS} <= {*text}
    assert not {'numpy', 'numba', 'rclpy', 'yaml', 'pydantic'} & set(imported.split())
    assert ask('main', '--version').stdout.startswith(f'hnn_vi_ros {__version__}\n')


@pytest.mark.parametrize('variables, colour', [
    ({'TERM': 'xterm'}, True), ({'TERM': 'dumb'}, False),
    ({'TERM': 'xterm', 'NO_COLOR': '1'}, False)])
def test_errors_are_coloured_on_terminals_alone(variables, colour):
    reader, terminal = os.openpty()
    command = [sys.executable, '-m', 'hnn_vi_ros', 'trian']
    subprocess.run(command, stderr=terminal, check=False, env={**os.environ, **variables})
    assert os.read(reader, 1000).startswith(b'\033[1;31mhnn\033[0m: ') == colour
    os.close(reader)
    os.close(terminal)
    piped = subprocess.run(command, capture_output=True, check=False,
                           env={**os.environ, **variables})
    assert b'\033' not in piped.stderr


@pytest.mark.parametrize('name', ['recover-bag', 'run', 'train'])
def test_help_of_a_command_names_it_as_it_was_called(name):
    *text, _ = ask('main', name, '--help').stdout.splitlines()
    shown = name.replace('-', '_')
    assert text[0].startswith(f'usage: hnn {shown} ')
    assert any(line.startswith(f'  hnn {shown} ') for line in text)
    assert 'ros2 run' not in '\n'.join(text)


@pytest.mark.parametrize('words, status', [
    (['trian'], 2), (['run', 'pendulumm'], 1), (['recover_bag', '/nowhere'], 1),
    (['run', 'pendulum', '--integrator', 'rk4', '--integrator', 'gauss8'], 2)])
def test_mistake_is_one_line_with_the_command(words, status):
    result = ask('main', *words)
    assert result.returncode == status
    assert_message(result.stderr.removesuffix('\n'))


@pytest.mark.parametrize('strict', [False, True])
def test_run_that_may_be_wrong_ends_with_that_line_and_strictly_with_status_3(strict, capsys):
    words = ['exact_pendulum', '--duration', '20', '--integrator', 'explicit_euler',
             *['--strict'] * strict]
    with pytest.warns(AlarmWarning, match='exceeds 5 % of the energy scale') as told:
        assert run.main(words) == 3 * strict
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == ('the run may be qualitatively wrong: under-resolved, path not resolved, '
                    'separatrix not resolved'
                    + ' (status 3)' * strict)
    # The size of the error stands in the line of the result alone.
    assert not any(' J' in str(one.message) for one in told if 'under' in str(one.message))
    assert run.main(['exact_pendulum', '--duration', '1', '--strict']) == 0
    assert 'wrong' not in capsys.readouterr().out


@pytest.mark.parametrize('words, largest, size', [
    # All energy at the start, m g z = 9.81 J and m g l (1 - cos(2.5)), is lost after these times.
    (['bouncing_mass', '--duration', '12'], 'heat/impact', 9.81),
    (['exact_pendulum', '--integrator', 'rk4', '--step-size', '0.4', '--duration', '100'],
     'error', 9.81 * (1.0 - math.cos(2.5))),
    # The mean power of the drive is that of damping.
    (['driven_duffing', '--duration', '40'], 'work/drive', None)])
@pytest.mark.filterwarnings('ignore')
def test_where_energy_went_is_answered_by_one_command(words, largest, size, tmp_path, capsys):
    assert run.main([*words, '--plot-energy', str(tmp_path / 'energy.png')]) == 0
    line = capsys.readouterr().out.splitlines()[1]
    found = {name: abs(float(value)) for name, value in (
        part.split() for part in line.removeprefix('energy [J]: ').split(', '))}
    # The work of an impact is the negative of its heat.
    assert found[largest] == max(found.values())
    assert size is None or found[largest] == pytest.approx(size, rel=0.02)
    assert size is not None or found['heat/damping'] > 0.5 * found[largest]


def test_run_writes_what_was_asked_for(tmp_path, capsys):
    files = {name: tmp_path / f'motion.{suffix}' for name, suffix in (
        ('csv', 'csv'), ('plot', 'png'), ('portrait', 'svg'), ('plot-energy', 'pdf'))}
    options = [word for name, path in files.items() for word in (f'--{name}', str(path))]
    assert run.main(['exact_harmonic_oscillator', '--duration', '0.5', *options]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0].startswith('Trajectory(exact_harmonic_oscillator, ')
    assert printed.out.splitlines()[1].startswith('energy [J]: stored/hamiltonian ')
    assert printed.out.splitlines()[2:] == [str(path) for path in files.values()]
    assert printed.err == '' and all(path.stat().st_size > 0 for path in files.values())
    header, *_ = files['csv'].read_text().splitlines()
    trajectory = simulate('exact_harmonic_oscillator', 0.5)
    assert header == 't,x,p_x,H'
    # Not a digit is lost.
    assert np.array_equal(np.loadtxt(files['csv'], delimiter=',', skiprows=1), np.column_stack(
        [trajectory.t, trajectory.q, trajectory.p, trajectory.energy]))
    with refused(ParameterError):
        run.main(['exact_harmonic_oscillator', *options])
    assert run.main(['exact_harmonic_oscillator', '--duration', '1', *options, '--force']) == 0
    assert len(files['csv'].read_text().splitlines()) == 2 * len(trajectory.t)
    same, link = str(tmp_path / 'a.png'), tmp_path / 'link.csv'
    link.symlink_to(tmp_path / 'elsewhere' / 'a.csv')
    for wrong in (['--plot', same, '--portrait', same], ['--csv', '/dev/null', '--force'],
                  ['--csv', str(tmp_path / 'nowhere' / 'a.csv')], ['--csv', str(link)]):
        with refused(ParameterError):
            run.main(['exact_harmonic_oscillator', *wrong])


def test_run_without_files_ends_with_places_and_next_commands(capsys):
    assert run.main(['exact_harmonic_oscillator', '--duration', '0.5']) == 0
    *_, place, _, last = capsys.readouterr().out.splitlines()
    assert place.startswith(f'scene: {shipped_file("scene", "exact_harmonic_oscillator")}')
    assert last.split() == ['hnn', 'scene', '--explain', 'exact_harmonic_oscillator']


def test_csv_on_standard_output_is_alone_there(tmp_path, capsys):
    assert run.main(['exact_harmonic_oscillator', '--duration', '0.5', '--csv', '-']) == 0
    printed = capsys.readouterr()
    assert np.loadtxt(printed.out.splitlines(), delimiter=',', skiprows=1).shape == (51, 4)
    assert printed.out.startswith('t,x,p_x,H\n') and 'Trajectory(' in printed.err


@pytest.mark.parametrize('words', [['run', 'pendulumm'], ['sweep', 'nothing'],
                                   ['train', '--config', 'nothing'], ['run', 'bad.yaml']])
def test_file_is_looked_at_before_libraries_are_imported(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'bad.yaml').write_text('hamiltonian: pendulum\nstep_sise: 1\nintegrator: rk4\n')
    result = ask('main', *words)
    assert result.returncode == 1 and len(result.stderr.splitlines()) == 1 + ('bad' in words[1])
    assert not {'numba', 'torch', 'scipy'} & set(result.stdout.split())


def test_new_scene_is_one_that_runs_and_is_checked_by_editors(tmp_path, capsys):
    path = tmp_path / 'mine.yaml'
    assert scene_tool.main(['--new', str(path.with_suffix('')), '--like', 'kepler']) == 0
    assert capsys.readouterr().out.startswith(f'{path}\n')
    assert load_scene(path).model_dump() == load_scene('kepler').model_dump()
    schema = re.search(r'\$schema=(.*)$', path.read_text(), re.M)[1]
    assert Path(schema).is_file()
    # What a scene names beside itself is found from the copy.
    assert scene_tool.main(['--new', str(tmp_path / 'arm.yml'), '--like', 'two_joint_arm']) == 0
    assert load_scene(tmp_path / 'arm.yml').model_digests.keys() == {
        str(shipped_file('scene', '').parents[1] / 'robots' / 'two_joint_arm.urdf')}
    with refused(SceneError):
        scene_tool.main(['--new', str(path)])


def test_new_scene_of_a_formula_runs(tmp_path, capsys):
    path = tmp_path / 'mine.yaml'
    scene_tool.main(['--new', str(path), '--formula',
                     'p_x^2/(2*m) + p1^2/2 + 50*k*(x - q1)^2 + x^4'])
    assert 'parameters set to 1: k, m\n' in capsys.readouterr().out
    scene = load_scene(path)
    assert scene.hamiltonian.coordinates == ['x', 'q1']
    assert scene.hamiltonian.parameters == {'k': 1.0, 'm': 1.0}
    # The springs of 2 x 100 N/m between two masses of 1 kg: sqrt(200) rad/s, a hundred steps.
    assert scene.step_size == 0.002
    assert np.ptp(simulate(scene, 1.0).energy) < 1e-12
    for text in ('p_x^2 + x +', 'x^2', 'p_x^2/2 + log(-x)', 'p_x^2/2 + e^(-x)', 'p_x^2/2 + Pi*x',
                 'p_x^2/2 + x*nan', 'p_x^2/2 - cos(X)'):
        with refused(SceneError):
            scene_tool.main(['--new', str(tmp_path / 'other.yaml'), '--formula', text])


def test_doctor_tells_what_is_here_and_what_is_wrong(capsys, monkeypatch):
    assert doctor.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} <= {'ok', 'absent'}
    assert any(re.match(rf'ok +hnn_vi_ros +{re.escape(__version__)} in /', line)
               for line in lines)
    assert any(re.match(r'ok +kernel cache +\d+ files, ', line) for line in lines)
    real = doctor.find_spec
    monkeypatch.setattr(doctor, 'find_spec', lambda name: None if name == 'numba' else real(name))
    assert doctor.main([]) == 1
    assert re.search(r'^wrong +numba +absent; install it with: .* -m pip install "numba"$',
                     capsys.readouterr().out, re.M)


def test_shells_complete_commands_options_names_and_files(tmp_path):
    pytest.importorskip('argcomplete', reason='argcomplete is not installed')
    (tmp_path / 'pens').mkdir()

    def offered(line: str) -> set[str]:
        found = tmp_path / 'found'
        asked = {'_ARGCOMPLETE': '1', '_ARGCOMPLETE_STDOUT_FILENAME': str(found),
                 '_ARGCOMPLETE_IFS': '\n', 'COMP_LINE': line, 'COMP_POINT': str(len(line))}
        subprocess.run([sys.executable, '-m', 'hnn_vi_ros'], cwd=tmp_path, env=os.environ | asked,
                       timeout=240, check=True)
        return set(found.read_text().split())
    assert set(COMMANDS) <= offered('hnn ')
    assert {'pendulum', 'pens/'} == offered('hnn run pen')
    assert set(shipped_names('sweep')) <= offered('hnn sweep ')
    assert set(shipped_names('training')) <= offered('hnn train --config ')
    assert set(INTEGRATORS) <= offered('hnn run kepler --integrator ')
    # Dashes may stand in names of commands; an option without names has files.
    assert '--weights' in offered('hnn import --')
    assert '--replace' in offered('hnn recover-bag --')
    assert 'pens/' in offered('hnn run kepler --plot ')


def test_long_work_without_a_terminal_says_how_long_it_takes(monkeypatch, capsys):
    monkeypatch.setattr(standard_streams, '_LOG_INTERVAL', 0.02)
    with standard_streams.elapsed('simulating'):
        while 'so far' not in (said := capsys.readouterr().err):
            time.sleep(0.01)
    assert re.match(r'simulating, 0 s so far\n', said)


@pytest.mark.parametrize('words, number', [
    *(('simulator', number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
    ('replay bag', signal.SIGTERM), ('controller', signal.SIGTERM)])
def test_signal_while_a_node_loads_its_libraries_ends_it_with_status_0(words, number):
    assert status_at(number, words) == 0


@pytest.mark.parametrize('words', ['doctor', 'replay bag --verify'])
def test_interrupt_while_a_command_loads_its_libraries_ends_it_with_status_130(words):
    assert status_at(signal.SIGINT, words) == 130


def status_at(number, words):
    """Return the status of hnn if a signal arrives in its first import."""
    return run_code(
        'import os, signal, sys, time; from hnn_vi_ros import cli; '
        f'sys.argv[1:] = {words.split()!r}; cli.check_names = lambda *_: None; '
        f'cli.import_module = lambda _: (os.kill(os.getpid(), {int(number)}), time.sleep(60)); '
        # A run under nohup ignores SIGHUP, and so do its children.
        'signal.signal(signal.SIGHUP, signal.SIG_DFL); cli.main()').returncode


def test_interrupt_says_how_to_go_on(monkeypatch, capsys):
    def interrupted(argv):
        raise KeyboardInterrupt
    monkeypatch.setattr(doctor, 'main', interrupted)
    handler = signal.getsignal(signal.SIGINT)
    try:
        assert cli.run_module('hnn_vi_ros.commands.doctor', [], 'hnn doctor') == 130
    finally:
        signal.signal(signal.SIGINT, handler)
    assert 'the same command starts from the beginning' in capsys.readouterr().err
