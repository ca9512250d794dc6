# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The executables: a missing package and an error of the user's are one line each."""

import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from types import SimpleNamespace
import warnings
from xml.etree import ElementTree

from hnn_vi_ros import cli
from hnn_vi_ros.commands import parser_of
from hnn_vi_ros.files import ENDING
from hnn_vi_ros.learning import arguments as learning
from hnn_vi_ros.models import SMOOTH
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.version import __version__
import pytest
from sources import ROOT, run_without
from urdf_robots import chain

EXECUTABLES = re.findall(r"'(\w+) = hnn_vi_ros\.cli:\1'", (ROOT / 'setup.py').read_text())
# What is installed in place of any missing package of ROS: all of its wheels at once.
ROS = 'ros-jazzy-rclpy[fastrtps]" "ros-jazzy-common-interfaces'
# One of another version would break what records.
RERUN = 'rerun-sdk>=0.41,<0.42'
# What help can do without: these take seconds to import.
HEAVY = {'torch', 'numba', 'rclpy', 'numpy', 'scipy', 'matplotlib', 'rerun', 'pydantic', 'yaml'}

# Each executable in a copy of one process, which has imported what they share.
COPIES = """
import os, sys
from hnn_vi_ros import cli
for name in {executables!r}:
    if not (copy := os.fork()):
        for number, path in enumerate({outputs!r}, 1):
            os.dup2(os.open(path.format(name=name), os.O_WRONLY | os.O_CREAT), number)
        sys.argv = [name, *{words!r}]
        {before}
        getattr(cli, name)()
    print(name, os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]), flush=True)
"""


def run(executable: str, hidden: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run an executable in a process from which one package cannot be imported."""
    code = f'from hnn_vi_ros import cli; sys.argv[0] = {executable!r}; cli.{executable}()'
    return run_without({hidden}, code, *arguments)


def run_all(folder: Path, *words: str, before: str = 'pass', output: str = '{name}.out'
            ) -> dict[str, tuple[int, str, str]]:
    """Return the status, the output and the errors of every executable, with the same words."""
    outputs = [output, '{name}.err']
    code = COPIES.format(executables=EXECUTABLES, words=words, outputs=outputs, before=before)
    ran = subprocess.run([sys.executable, '-c', code], stdout=subprocess.PIPE, text=True,
                         timeout=240, check=True, cwd=folder)
    statuses = dict(line.split() for line in ran.stdout.splitlines())
    assert [*statuses] == EXECUTABLES
    return {name: (int(status), *((folder / path.format(name=name)).read_text()
                                  if '{' in path else '' for path in outputs))
            for name, status in statuses.items()}


@pytest.mark.parametrize('executable, hidden, command', [
    ('simulator', 'rclpy', re.escape(f'-m pip install "{ROS}"')),
    pytest.param('train', 'torch', 'make -C .* build TORCH=any|-m pip install "plotly" "torch"',
                 marks=pytest.mark.long)])
def test_missing_package_is_one_line_with_the_command(executable, hidden, command):
    result = run(executable, hidden)
    assert result.returncode == 1 and result.stderr.count('\n') == 1
    assert re.search(f'with: .*({command})', result.stderr)


def test_missing_package_is_named_as_pip_knows_it(monkeypatch):
    for name, package in (
            ('numba', 'numba'), ('mcap', 'mcap'), ('yaml', 'pyyaml'), ('zstandard', 'zstandard'),
            ('pydantic', 'pydantic'), ('pyarrow', 'pyarrow'),
            ('rclpy', ROS), ('std_msgs', ROS), ('std_srvs', ROS), ('rerun', RERUN)):
        def lack(module: str, name: str = name) -> None:
            raise ModuleNotFoundError(f'No module named {name!r}', name=f'{name}.part')
        monkeypatch.setattr(cli, 'import_module', lack)
        said = cli.run_module('hnn_vi_ros.commands.doctor', [], 'doctor')
        assert said.startswith(f'doctor: the Python package {name} ') and '\n' not in said
        assert f'-m pip install "{package}"' in said


@pytest.mark.parametrize('made_by_make', [True, False])
def test_remedy_for_a_package_of_training_suits_the_environment(
        made_by_make, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    if made_by_make:
        (tmp_path / '.installed').write_text('wheels /a/checkout\nrun 1-2\n')
    expected = ('make -C /a/checkout build TORCH=cpu' if made_by_make
                else f'{sys.executable} -m pip install "plotly" "torch"')
    assert f'with: {expected}' in cli._missing('torch')
    # Without an index, pip on Linux installs CUDA: 5 GB instead of 1 GB.
    assert made_by_make or 'https://download.pytorch.org/whl/cpu' in cli._missing('torch')
    assert '-m pip install "numba"' in cli._missing('numba')


LOST = [('>&-', 74, 'Bad file descriptor'), ('> /dev/full', 74, 'No space left on device'),
        # As of any tool that a broken pipe has ended, and as quiet.
        ('> >(true)', 141, ''), ('2>&- > /dev/null', 0, ''), ('<&- > /dev/null', 0, '')]


@pytest.mark.parametrize('words, redirection, status, reason', [
    *(('scene --help', *row) for row in LOST), ('scene --schema', *LOST[1]),
    *(pytest.param(words, *row, marks=pytest.mark.long) for words, rows in (
        ('scene --schema', LOST[:1] + LOST[2:]),) for row in rows)])
def test_output_that_does_not_arrive_is_one_line_at_most(words, redirection, status, reason):
    name, option = words.split()
    code = f'from hnn_vi_ros import cli; cli.{name}()'
    result = subprocess.run(
        ['/bin/bash', '-c', f'"{sys.executable}" -u -c "{code}" {option} {redirection}'],
        capture_output=True, text=True, timeout=120, check=False)
    # On a busy machine the reader may be there still.
    assert result.returncode in ({141, 0} if status == 141 else {status})
    assert result.stderr.count('\n') == bool(reason) and reason in result.stderr


def test_help_that_does_not_arrive_has_the_status_of_lost_output(tmp_path):
    for name, (status, _, err) in run_all(tmp_path, '--help', output='/dev/full').items():
        # None by which an executable tells what it found, such as 1 for lost messages.
        assert status == os.EX_IOERR, name
        assert err.count('\n') == 1 and err.startswith(f'hnn {name}: ')


def test_working_directory_that_was_removed_is_one_line(tmp_path):
    leave = 'os.mkdir(name); os.chdir(name); os.rmdir(f"../{name}")'
    for name, (status, _, err) in run_all(tmp_path, before=leave).items():
        assert status == 1 and err.count('\n') == 1, name
        assert 'working directory was removed' in err


@pytest.mark.parametrize('limit, variable', [
    ('-v 300000', ''), ('-s 64', ''), *(('-c 0', word) for word in (
        'NUMBA_DISABLE_JIT=1', 'NUMBA_NUM_THREADS=0', 'NUMBA_CPU_FEATURES=fast'))])
def test_shell_in_which_libraries_end_the_process_is_one_line(limit, variable, tmp_path):
    found = subprocess.run(
        ['/bin/bash', '-c', f'ulimit {limit}; {variable} exec "$0" -m hnn_vi_ros run '
         'exact_pendulum --duration 0.1', sys.executable],
        capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path)
    assert found.returncode == 1 and found.stdout == ''
    assert found.stderr.startswith('hnn run: ') and found.stderr.count('\n') == 1


@pytest.mark.timeout(120)
def test_files_of_the_working_folder_configure_no_library(tmp_path):
    # A FIFO would hold up whoever reads it.
    os.mkfifo(tmp_path / 'matplotlibrc')
    (tmp_path / '.numba_config.yaml').write_text('opt: [')
    (tmp_path / 'rc').write_text('savefig.facecolor: red\n')
    code = ('import sys; sys.argv = ["hnn", "run", "exact_pendulum", "--duration", "0.1", '
            '"--plot", "a.png"]; from hnn_vi_ros import cli; cli.main()')
    for variables in ({}, {'MATPLOTLIBRC': 'rc'}):
        subprocess.run([sys.executable, '-P', '-c', code], cwd=tmp_path, check=True,
                       env=os.environ | variables)
        (tmp_path / 'a.png').rename(tmp_path / f'{len(variables)}.png')
    # The file that the user names is read.
    assert (tmp_path / '0.png').read_bytes() != (tmp_path / '1.png').read_bytes()


@pytest.mark.parametrize('problem, said', [
    (OSError(28, 'No space left on device', 'a.csv'),
     'hnn run: a.csv: No space left on device; name another place'),
    (MemoryError(), 'hnn run: the memory is not enough; free some, or give a smaller input')])
def test_full_disk_or_memory_is_one_line(problem, said, monkeypatch):
    def fail(argv: list[str]) -> None:
        raise problem
    monkeypatch.setitem(sys.modules, 'full', SimpleNamespace(main=fail))
    before = [signal.getsignal(number) for number in ENDING]
    try:
        assert cli.run_module('full', [], 'hnn run') == said
    finally:
        for number, handler in zip(ENDING, before, strict=True):
            signal.signal(number, handler)


def test_missing_ray_is_one_line_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'ray', None)
    argv = ['pendulum_lengths', '--ray', 'local', '--out', str(tmp_path / 'out')]
    said = cli.run_module('hnn_vi_ros.sweeps.running', argv, 'sweep')
    assert said.startswith('sweep: the Python package ray is missing') and '\n' not in said
    assert said.endswith('-m pip install "ray"')
    assert not (tmp_path / 'out').exists()


def test_missing_viewer_is_one_line_with_the_pip_command(tmp_path):
    result = run('simulator', 'rerun', '--ros-args', '-p', f'rerun_path:={tmp_path}/a.rrd',
                 '-p', f'record_path:={tmp_path}/bag')
    assert result.returncode == 1
    assert 'Traceback' not in result.stderr
    line = result.stderr.splitlines()[-1]
    assert 'rerun_sink = file (none: no visualisation) needs the Python package rerun' in line
    assert line.endswith(f'-m pip install "{RERUN}"')
    # Nor is a bag begun.
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_simulator_without_a_picture_takes_no_viewer(tmp_path):
    result = run('simulator', 'rerun', '--ros-args', '-p', 'rerun_sink:=none', '-p',
                 f'record_path:={tmp_path}/bag', '-p', 'duration:=0.5')
    assert result.returncode == 0 and (tmp_path / 'bag' / 'metadata.yaml').exists()


def test_help_comes_without_the_libraries_that_the_work_takes(tmp_path):
    imported = 'import atexit; atexit.register(lambda: print(*sys.modules))'
    found = run_all(tmp_path, 'x', '--help', '-p', 'y', before=imported)
    for name, (status, out, err) in found.items():
        assert (status, err) == (0, ''), name
        *text, modules = out.splitlines()
        assert text[0].startswith(f'usage: hnn {name} ')
        assert 'examples:' in text
        assert any(line.startswith(f'  hnn {name}') for line in text)
        assert not HEAVY & set(modules.split())
    assert run('scene', 'torch', '-h').stdout.startswith('usage: hnn scene ')


def test_help_tells_every_option():
    for executable in EXECUTABLES:
        text = parser_of(executable).format_help()
        for action in parser_of(executable).known:
            assert action.help, f'{executable}: {action.dest}'
        # Command lines can be pasted: they are not broken.
        assert all(len(line) <= 99 or line.startswith('  hnn ') for line in text.splitlines())


@pytest.mark.parametrize('executable, table', [
    ('simulator', parameters.PARAMETERS), ('replay', parameters.REPLAY_PARAMETERS)])
def test_help_tells_every_parameter_with_unit_values_and_default(executable, table):
    entries = parser_of(executable).format_help().split('NAME:=VALUE):\n')[1]
    for item in table:
        entry = re.search(rf'^  {item.name}\n((?:      .*\n)+)', entries, re.M)[1]
        text = ' '.join(entry.split())
        assert text.startswith(item.description)
        assert all(choice in text for choice in item.choices)
        assert f'[{item.unit}]' in text or not item.unit
        shown = str(item.default).lower() if isinstance(item.default, bool) else item.default
        assert text.endswith(f'default: {"empty" if shown == "" else shown}')


def test_help_of_the_simulator_names_every_topic_and_service():
    rights = ElementTree.parse(ROOT / 'config' / 'security' / 'simulator.policy.xml').getroot()
    text = parser_of('simulator').format_help()
    own = {name.text for name in rights.iter() if name.tag in ('topic', 'service')
           and not re.search('parameter|rosout|transition|get_|change_st|simulation|world',
                             name.text)}
    assert own >= {'~/q', '~/step', '~/commands', 'joint_states', '/clock'}
    assert {name for name in own if name not in text} == set()


def test_version_is_told(tmp_path):
    for status, out, _ in run_all(tmp_path, '--version').values():
        assert (status, out) == (0, f'hnn_vi_ros {__version__}\n')


def test_misspelt_option_is_one_line_with_the_nearest(capsys):
    for executable in EXECUTABLES:
        found = parser_of(executable)
        option = next((name for name in reversed(found.options)
                       if name.startswith('--') and len(name) > 4), '--version')
        for misspelt in (option[:-1], f'{option}x', f'{option[:-1]}=3'):
            with pytest.raises(SystemExit, match='2'):
                found.parse_args([misspelt])
            error = capsys.readouterr().err
            assert error.startswith(f'hnn {executable}: unknown option ')
            assert error.count('\n') == 1
            assert 'did you mean' in error and f'see hnn {executable} --help' in error


def test_parameter_given_as_an_option_is_one_line_that_says_how_to_give_it(capsys):
    with pytest.raises(SystemExit):
        parser_of('simulator').parse_args(['--scene', 'pendulum'])
    assert ('unknown option --scene; scene is a parameter: --ros-args -p scene:=VALUE'
            in capsys.readouterr().err)


@pytest.mark.parametrize('words, what', [
    (['--config'], 'expected one argument'), (['--out'], 'expected one argument'),
    (['--config', 'a', 'b'], "'b'"), (['--config', 'a', '--seed', 'x'], 'x'),
    (['--config', 'a', '--device', 'tpu'], 'cuda')])
def test_error_of_the_command_line_is_one_line_with_the_name(words, what, capsys):
    with pytest.raises(SystemExit, match='2'):
        parser_of('train').parse_args(words)
    error = capsys.readouterr().err
    assert error.startswith('hnn train: ') and error.count('\n') == 1 and what in error


def test_activations_of_the_command_line_are_those_that_can_be_imported():
    assert set(learning.ACTIVATIONS) == set(SMOOTH)


def test_warning_is_one_line_and_stands_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path('robot.urdf').write_text(chain([1.0], [1.0]).replace(
        '<link name="l0"/>', '<link name="l0"><inertial><mass value="-1"/><inertia ixx="1" '
        'ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'))
    Path('robot.yaml').write_text(
        'hamiltonian: {kind: urdf, file: robot.urdf}\nintegrator: {kind: generalized_leapfrog}\n'
        'step_size: 0.01\ninitial_state: {q: [1.0], p: [0.0]}\n')
    argv = ['--check', 'robot.yaml', 'robot.yaml']
    with warnings.catch_warnings():
        warnings.simplefilter('always')
        assert cli.run_module('hnn_vi_ros.commands.scene_tool', argv, 'scene') == 0
    assert capsys.readouterr().err == (
        "scene: warning: robot.urdf:1: link 'l0': mass = -1 kg must not be negative; simulated "
        'nevertheless, because it is at rest\n')


def test_letter_that_an_output_cannot_show_is_printed_escaped():
    result = subprocess.run(
        [sys.executable, '-c', 'from hnn_vi_ros.cli import main; main()', 'list', 'scenes'],
        env=os.environ | {'PYTHONIOENCODING': 'ascii'}, capture_output=True, timeout=240,
        check=False)
    assert (result.returncode, result.stderr) == (0, b'')
    assert r'H\xe9non' in result.stdout.decode('ascii')
