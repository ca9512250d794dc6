# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording holds from its start on, and what becomes of one that cannot go on."""

from collections.abc import Callable
from pathlib import Path
import resource
import shutil
import signal

from diagnostic_msgs.msg import DiagnosticArray
from executables import Executable
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.recording.bags.mcap_recovery import recover
from hnn_vi_ros.run.recorded_run import RecordedRun
from peer import peer, simulating
from processes import finish, read_bag, standard_error, start, wait_until
import pytest


def limit_files(process: Executable, size: int) -> None:
    """Let no file of a process grow beyond a size, as on a disk that is full."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, size))


def fill_disk(process: Executable, bag: Path) -> None:
    limit_files(process, (bag / 'bag_0.mcap').stat().st_size)


def remove_folder(process: Executable, bag: Path) -> None:
    shutil.rmtree(bag)


@pytest.mark.parametrize('reset', [False, True])
def test_simulator_killed_before_its_first_step_leaves_a_bag_with_its_scene(
        tmp_path: Path, reset: bool):
    process = start(tmp_path, start_paused='true', record_path='bag')
    bag = tmp_path / ('bag-2' if reset else 'bag')
    with peer() as other:
        other.wait_for_state('active')
        if reset:
            assert other.trigger('reset').success
        process.kill()
        process.wait()
    assert recover(bag).changed
    assert RecordedRun(bag).scene.step_size == 0.01
    ((stamp, message),) = read_bag(bag)['/hnn_simulator/scene']
    assert stamp == 0 and message.data.encode() == BagReader(bag).attachment('scene.yaml')


def test_bag_of_a_run_that_starts_by_itself_is_begun_when_its_first_step_is_due(tmp_path: Path):
    """Not before the wait for subscribers: the bag's age is then that of its first sample."""
    process = start(tmp_path, discovery_time=60, record_path='bag')
    wait_until(lambda: 'configuring: waiting for subscribers' in standard_error(process))
    assert not (tmp_path / 'bag').exists()
    with peer() as other:
        other.spin_until(lambda: other.states)
    assert (tmp_path / 'bag' / 'bag_0.mcap').exists()


def failures(heard: list[DiagnosticArray]) -> list[str]:
    """Return what /diagnostics says of a recorder that has failed."""
    return [status.message for message in heard for status in message.status
            if status.name == 'hnn_simulator: recorder' and status.level == b'\x02']


@pytest.mark.parametrize('spoil, reason', [
    (fill_disk, 'File too large'), (remove_folder, 'No such file or directory')])
def test_recording_that_fails_is_an_error_diagnostic_while_the_simulation_goes_on(
        tmp_path: Path, spoil: Callable[[Executable, Path], None], reason: str):
    process = start(tmp_path, record_path='bag')
    with peer() as other:
        heard = other.hear(DiagnosticArray, '/diagnostics')
        other.spin_until(lambda: len(other.states) > 50)
        assert not failures(heard)
        spoil(process, tmp_path / 'bag')
        other.spin_until(lambda: failures(heard))
        assert reason in failures(heard)[0]
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 50)
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    # The process ends with the status of an incomplete recording, and says why once.
    assert status == 1
    assert error.count('the simulation continues') == 1 and reason in error
    # Of what is there still, something is left to be done; of what is not, nothing.
    bag = tmp_path / 'bag'
    assert error.count(f'hnn recover_bag {bag}') == bag.exists()


def test_disk_that_is_full_at_the_end_is_told_without_words_of_the_library(tmp_path: Path):
    process = start(tmp_path, record_path='bag', rerun_path='picture.rrd')
    with peer() as other:
        other.spin_until(lambda: len(other.states) > 50)
        assert other.pause().success
        # Nothing is written until the end, for which there is no room then.
        limit_files(process, 4096)
        process.send_signal(signal.SIGINT)
        status, out, error = finish(process)
    assert status == 1
    assert 'the simulation continues' not in error
    # One line for each file, which the node says, and what to do about the bag.
    assert sum('[ERROR]' in line for line in error.splitlines()) == 2
    assert f'recover_bag {tmp_path / "bag"}' in error and 'picture.rrd' in error
    assert all('[hnn_simulator]' in line for line in error.splitlines())
    assert 'is not complete' in out


def test_picture_that_cannot_be_written_is_told_while_the_simulation_goes_on(tmp_path: Path):
    process = start(tmp_path, rerun_path='picture.rrd')
    with peer() as other:
        heard = other.hear(DiagnosticArray, '/diagnostics')
        other.spin_until(lambda: len(other.states) > 50)
        limit_files(process, 4096)
        other.spin_until(lambda: failures(heard))
        assert 'picture.rrd: the rerun recording stopped' in failures(heard)[0]
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    assert status == 1 and error.count('the simulation continues') == 1


def test_recording_into_a_folder_that_cannot_be_made_is_refused_and_the_simulation_goes_on(
        tmp_path: Path):
    (tmp_path / 'file').write_text('')
    with simulating(tmp_path, record='false', record_path='file/bag') as (other, _):
        other.spin_until(lambda: other.states)
        answer = other.trigger('start_recording')
        assert not answer.success and str(tmp_path / 'file') in answer.message, answer.message
        assert '\n' not in answer.message
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 50)
