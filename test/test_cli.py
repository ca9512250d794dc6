# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The executables: a missing package and an error of the user's are one line each."""

import subprocess
import sys

import pytest

EXECUTABLES = ['simulator', 'listener', 'train', 'paper_figures', 'scene', 'work_precision',
               'import_checkpoint', 'bag_to_model']


HIDE = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == {hidden!r}:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)
sys.meta_path.insert(0, Hide())
sys.argv = {arguments!r}
from hnn_vi_ros import cli
cli.{executable}()
"""


def run(executable: str, hidden: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run an executable in a process from which one package cannot be imported."""
    code = HIDE.format(hidden=hidden, arguments=[executable, *arguments], executable=executable)
    return subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          timeout=60, check=False)


@pytest.mark.parametrize('executable, hidden, package', [
    ('simulator', 'rclpy', 'ros-jazzy-rclpy[fastrtps]'), ('simulator', 'numba', 'numba'),
    ('simulator', 'mcap', 'mcap'), ('listener', 'std_msgs', 'ros-jazzy-common-interfaces'),
    ('train', 'torch', 'torch'), ('train', 'yaml', 'pyyaml'),
    ('paper_figures', 'pydantic', 'pydantic'), ('work_precision', 'scipy', 'scipy'),
    ('published_tables', 'tqdm', 'tqdm'),
    ('recover_bag', 'zstandard', 'zstandard'),
    ('replay', 'std_srvs', 'ros-jazzy-common-interfaces'), ('rerun_bridge', 'rerun', 'rerun-sdk'),
])
def test_missing_package_is_one_line_with_the_pip_command(executable, hidden, package):
    result = run(executable, hidden)
    assert result.returncode == 1
    assert result.stderr.count('\n') == 1
    assert f'-m pip install "{package}"' in result.stderr


@pytest.mark.parametrize('redirection, status, reason', [
    ('>&-', 1, 'Bad file descriptor'), ('> /dev/full', 1, 'No space left on device'),
    # As of any tool that a broken pipe has ended, and as quiet.
    ('> >(true)', 141, ''),
    ('2>&- > /dev/null', 0, ''), ('<&- > /dev/null', 0, '')])
@pytest.mark.parametrize('words', ['scene --list', 'scene --help', 'scene --schema'])
def test_output_that_does_not_arrive_is_one_line_at_most(words, redirection, status, reason):
    name, option = words.split()
    code = f'from hnn_vi_ros import cli; cli.{name}()'
    result = subprocess.run(
        ['/bin/bash', '-c', f'"{sys.executable}" -u -c "{code}" {option} {redirection}'],
        capture_output=True, text=True, timeout=120, check=False)
    # On a busy machine the reader may be there still.
    assert result.returncode in ({141, 0} if status == 141 else {status})
    assert result.stderr.count('\n') == bool(reason) and reason in result.stderr


@pytest.mark.parametrize('executable', EXECUTABLES)
def test_working_directory_that_was_removed_is_one_line(executable, tmp_path):
    code = (f'import os; os.rmdir({str(tmp_path / "gone")!r}); from hnn_vi_ros import cli; '
            f'cli.{executable}()')
    (tmp_path / 'gone').mkdir()
    result = subprocess.run([sys.executable, '-c', code], cwd=tmp_path / 'gone',
                            capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 1 and result.stderr.count('\n') == 1
    assert 'working directory was removed' in result.stderr


@pytest.mark.parametrize('hidden', ['torchdiffeq', 'torch'])
def test_missing_peer_is_one_line_before_anything_is_measured(hidden, tmp_path):
    result = run('work_precision', hidden, '--scene', 'pendulum', '--peers', '--out',
                 str(tmp_path / 'out'))
    assert result.returncode == 1
    assert result.stderr.count('\n') == 1
    assert f'-m pip install "{hidden}"' in result.stderr
    assert not (tmp_path / 'out').exists()


def test_missing_viewer_is_one_line_with_the_pip_command(tmp_path):
    result = run('simulator', 'rerun', '--ros-args', '-p', f'rerun_path:={tmp_path}/a.rrd',
                 '-p', 'record:=false')
    assert result.returncode == 1
    assert 'Traceback' not in result.stderr
    assert result.stderr.splitlines()[-1].endswith('-m pip install "rerun-sdk"')


@pytest.mark.parametrize('executable, arguments', [
    ('train', ['--config', 'nothing']), ('simulator', ['--ros-args', '-p', 'scene:=nothing']),
    ('paper_figures', ['--out', '/dev/null/x']), ('scene', ['--check', 'nothing']),
    ('scene', ['--explain', 'nothing']), ('work_precision', ['--scene', 'nothing']),
    ('published_tables', ['--out', '/dev/null/x']),
    ('recover_bag', ['nothing']), ('replay', ['nothing']), ('rerun_bridge', ['nothing']),
])
def test_error_of_the_user_is_one_line_and_no_traceback(executable, arguments):
    result = run(executable, 'a_package_that_nobody_needs', *arguments)
    assert result.returncode == 1
    assert result.stderr.count('\n') == 1
    assert 'nothing' in result.stderr or '/dev/null' in result.stderr
