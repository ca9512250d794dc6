# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Processes started for real: their end, whatever interrupts them or becomes of their streams."""

from datetime import datetime
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import ENDING
from hnn_vi_ros.ros.plumbing.starting import record_signals
from hnn_vi_ros.run import run_folder
from messages import refused
from peer import ACTIVATE, CONFIGURE, DEACTIVATE, peer, simulating
from processes import finish, read_bag, refusal, simulator_words, start, start_executable
import pytest

SCENE = 'exact_harmonic_oscillator'
# Says when the files are open, and lets the process be stopped before the node has them.
SLOW_TO_HAND_OVER = """
import sys, time
from hnn_vi_ros.ros import simulator_node
prepare = simulator_node.prepare
def slowly(*arguments):
    prepared = prepare(*arguments)
    print('opened', flush=True)
    time.sleep(2.0)
    return prepared
simulator_node.prepare = slowly
from hnn_vi_ros.cli import simulator
simulator()
"""
# Says when the main module begins to be imported.
BEGUN = """
import sys
from hnn_vi_ros.cli import {executable}
class Teller:
    def find_spec(self, name, path=None, target=None):
        sys.meta_path.remove(self)
        print('begun', file=sys.stderr, flush=True)
sys.meta_path.insert(0, Teller())
{executable}()
"""


def interrupt_until_it_ends(process: subprocess.Popen) -> int:
    """Send SIGINT every millisecond; return how often."""
    count, deadline = 0, time.monotonic() + 60.0
    while process.poll() is None:
        assert time.monotonic() < deadline
        process.send_signal(signal.SIGINT)
        count += 1
        time.sleep(1e-3)
    return count


def test_simulator_that_is_interrupted_again_and_again_completes_its_bag(tmp_path):
    process = start(tmp_path, record_path='bag', rerun_path='a.rrd')
    with peer() as other:
        other.spin_until(lambda: len(other.states) > 20)
    assert interrupt_until_it_ends(process) > 10
    status, out, _ = finish(process)
    assert status == 0 and 'bag ' in out
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    assert len(read_bag(tmp_path / 'bag')['/hnn_simulator/q']) > 20


def test_hangup_is_noted_like_other_signals_unless_it_is_ignored():
    before = {number: signal.getsignal(number) for number in ENDING}
    try:
        for handler, noted in ((signal.SIG_DFL, [signal.SIGHUP]), (signal.SIG_IGN, [])):
            signal.signal(signal.SIGHUP, handler)
            received = record_signals()
            signal.raise_signal(signal.SIGHUP)
            assert received == noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# The moment in which each executable is interrupted by `make test` [s].
MOMENTS = {'simulator': 1.5, 'replay': 0.5, 'listener': 0.5,
           'controller': 1.5, 'train': 0.0, 'scene': 0.0}


@pytest.mark.parametrize('executable, delay', [
    pytest.param(executable, delay, marks=[
        pytest.mark.long] * (executable != 'simulator' and delay != moment))
    for executable, moment in MOMENTS.items() for delay in (0.0, 0.5, 1.5)])
def test_executable_that_is_interrupted_at_its_start_ends_without_a_traceback(
        tmp_path, executable, delay):
    words = {'simulator': ['--ros-args', '-p', f'scene:={SCENE}'], 'replay': ['bag'],
             'train': ['--config', 'pendulum'], 'scene': ['--schema']}.get(executable, [])
    code = BEGUN.format(executable=executable)
    with subprocess.Popen([sys.executable, '-c', code, *words], cwd=tmp_path,
                          stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
                          ) as process:
        assert process.stderr.readline() == 'begun\n'
        time.sleep(delay)
        interrupt_until_it_ends(process)
        error = process.stderr.read()
    assert 'Traceback' not in error and 'KeyboardInterrupt' not in error, error
    # 1: the bag that there is not was found missing first.
    assert process.returncode in (0, 130) or (executable == 'replay' and process.returncode == 1)


def test_files_that_are_opened_as_the_simulator_is_stopped_are_closed(tmp_path):
    with subprocess.Popen(
            [sys.executable, '-c', SLOW_TO_HAND_OVER, '--ros-args', '-p', f'scene:={SCENE}',
             '-p', 'record_path:=bag', '-p', 'rerun_sink:=none'],
            cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'opened\n'
        process.send_signal(signal.SIGINT)
        process.stdout.read()
    assert process.returncode == 0
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()


def test_log_tells_lifecycle_changes_pauses_and_where_the_bag_is(tmp_path):
    with simulating(tmp_path, autostart='false', record_path='bag', start_paused='true') as (
            other, process):
        assert other.change_state(CONFIGURE) and other.change_state(ACTIVATE)
        assert other.pause(False).success and other.pause().success
        assert other.trigger('reset').success
        assert other.change_state(DEACTIVATE)
    error = finish(process)[2]
    lines = [line.split(']: ', 1)[1] for line in error.splitlines() if '[INFO]' in line]
    # The time of day in local time.
    assert re.search(r'^\[INFO\] \[2\d{3}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}\] \[', error)
    bag = tmp_path / 'bag'
    told = [f'recording to {bag}', 'unconfigured -> inactive',
            'paused until resumed with ~/set_pause',
            'inactive -> active', 'pause ended', 'paused', f'recording to {bag}-2', 'reset',
            'active -> inactive', 'stopped by SIGINT']
    assert [line for line in lines if line in told] == told
    assert 'path error not measured: too few steps were taken' in lines[lines.index(told[-1]):]


def test_run_folder_is_named_for_the_scene_and_the_second_and_that_of_another_is_left_to_it(
        tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mkdir, made = Path.mkdir, []

    def first_the_other(path: Path, **options: object) -> None:
        if path.parent.name == 'runs' and not made:
            made.append(path)
            mkdir(path)
        mkdir(path, **options)

    monkeypatch.setattr(Path, 'mkdir', first_the_other)
    folder = run_folder.create_run_folder('a', Path())
    assert folder != made[0] and folder.is_dir()
    assert datetime.strptime(made[0].name, 'a-%Y%m%dT%H%M%SZ')


def test_run_folder_beside_a_file_named_runs_is_refused_in_a_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'runs').write_text('')
    with refused(RecordingError):
        run_folder.create_run_folder('a', Path())


def test_security_without_its_libraries_is_one_line(tmp_path, monkeypatch):
    enclaves = tmp_path / 'keys' / 'enclaves'
    enclaves.mkdir(parents=True)
    for name in ('identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem',
                 'governance.p7s', 'permissions.p7s'):
        (enclaves / name).write_text('')
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    for keystore in (tmp_path / 'keys', tmp_path / 'none'):
        monkeypatch.setenv('ROS_SECURITY_KEYSTORE', str(keystore))
        for executable in ('simulator', 'listener'):
            line = refusal(executable)
            assert line.startswith(f'hnn {executable}: ROS: ') and 'ROS_SECURITY_ENABLE' in line


def test_folder_for_logs_that_cannot_be_made_is_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/dev/null/logs')
    status, _, error = finish(start_executable('listener', folder=tmp_path))
    assert status == 1 and error.count('\n') == 1 and 'set ROS_LOG_DIR to' in error


SAMPLES = 100


def simulate(folder: Path, redirection: str) -> subprocess.CompletedProcess:
    """Run a simulator by a shell that redirects its outputs; what is left of them is captured."""
    words = ' '.join(simulator_words(
        duration=SAMPLES / 100, real_time_factor=0.0, record_path='bag',
        rerun_path='picture.rrd'))
    code = 'from hnn_vi_ros.cli import simulator; simulator()'
    return subprocess.run(
        f'"{sys.executable}" -c "{code}" {words} {redirection}', shell=True,
        executable='/bin/bash', cwd=folder, capture_output=True, text=True, timeout=120,
        check=False)


@pytest.mark.parametrize('redirection, reason', [
    ('>/dev/full', 'No space left on device'), ('<&- >&- 2>&-', ''), *(
        pytest.param(*case, marks=pytest.mark.long) for case in (
            ('>&-', 'Bad file descriptor'), ('> >(true)', 'Broken pipe'), ('2>&-', ''),
            ('2>/dev/full', '')))])
def test_bag_is_complete_and_one_line_tells_what_is_lost(tmp_path, redirection, reason):
    result = simulate(tmp_path, redirection)
    # The files are what the run is for, and they are all there.
    assert result.returncode == 0
    assert len(read_bag(tmp_path / 'bag')['/hnn_simulator/q']) == SAMPLES
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    lines = [line for line in result.stderr.splitlines() if 'standard output' in line]
    assert len(lines) == bool(reason) and all(reason in line for line in lines)
    assert 'Traceback' not in result.stdout + result.stderr
    # No file has taken the place of an output that was closed.
    mcap = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    assert mcap.startswith(b'\x89MCAP') and b'[INFO]' not in mcap


def test_bag_is_complete_when_the_working_directory_is_removed(tmp_path):
    folder = tmp_path / 'gone'
    folder.mkdir()
    process = start(folder, record_path=tmp_path / 'bag', rerun_path=tmp_path / 'picture.rrd')
    with peer() as other:
        other.spin_until(lambda: len(other.states) > 20)
        shutil.rmtree(folder)
        assert other.trigger('reset').success
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 20)
    process.send_signal(signal.SIGINT)
    status, out, _ = finish(process)
    assert status == 0
    for name in ('bag', 'bag-2'):
        assert len(read_bag(tmp_path / name)['/hnn_simulator/q']) > 15
        assert str(tmp_path / name) in out
