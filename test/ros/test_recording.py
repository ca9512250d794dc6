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
from hnn_vi_ros.bags.mcap_reader import BagReader
from hnn_vi_ros.bags.mcap_recovery import recover
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.topics.outputs import LATCHED
from peer import Peer, peer, simulating
from processes import finish, read_bag, standard_error, start, wait_until
import pytest
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

# Topics of every run: those that are heard here, and the rest.
QUEUE = QoSProfile(depth=1000)
TOPICS = {'/hnn_simulator/scene': (String, LATCHED), '/hnn_simulator/state': (JointState, QUEUE),
          '/hnn_simulator/q': (Float64MultiArray, QUEUE), '/joint_states': (JointState, QUEUE)}
REST = ('/hnn_simulator/p', '/hnn_simulator/energy')


def limit_files(process: Executable, size: int) -> None:
    """Let no file of a process grow beyond a size, as on a disk that is full."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, size))


def fill_disk(process: Executable, bag: Path) -> None:
    limit_files(process, (bag / 'bag_0.mcap').stat().st_size)


def remove_folder(process: Executable, bag: Path) -> None:
    shutil.rmtree(bag)


def test_two_equal_runs_leave_equal_messages_which_are_those_that_were_published(tmp_path: Path):
    found = []
    for name in ('first', 'second'):
        with peer() as other:
            heard = {topic: [] for topic in TOPICS}
            for topic, (kind, qos) in TOPICS.items():
                other.node.create_subscription(
                    kind, topic, lambda data, to=heard[topic]: to.append(bytes(data)), qos,
                    raw=True)
            process = start(tmp_path, duration=1, discovery_time=20, record_path=name,
                            real_time_factor=2)
            other.spin_until(lambda: process.poll() is not None and min(map(len, heard.values())))
            assert finish(process)[0] == 0
        reader = BagReader(tmp_path / name)
        recorded = [(message.time, reader.channels[message.channel].topic, message.data)
                    for message in reader.messages()]
        for topic, messages in heard.items():
            assert messages == [data for _, name, data in recorded if name == topic], topic
        # What /diagnostics tells is of the wall clock; of this run there is no alarm.
        assert {topic for _, topic, _ in recorded} == {*heard, *REST}
        found.append(recorded)
    assert found[0] == found[1]


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


def listen(other: Peer, told: list[str]) -> None:
    """Note what /diagnostics says of a recorder that has failed."""
    def on_diagnostics(message: DiagnosticArray) -> None:
        told.extend(status.message for status in message.status
                    if status.name == 'hnn_simulator: recorder' and status.level == b'\x02')

    other.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)


@pytest.mark.parametrize('spoil, reason', [
    (fill_disk, 'File too large'), (remove_folder, 'No such file or directory')])
def test_recording_that_fails_is_an_error_diagnostic_while_the_simulation_goes_on(
        tmp_path: Path, spoil: Callable[[Executable, Path], None], reason: str):
    process = start(tmp_path, record_path='bag')
    told: list[str] = []
    with peer() as other:
        listen(other, told)
        other.spin_until(lambda: len(other.states) > 50)
        assert told == []
        spoil(process, tmp_path / 'bag')
        other.spin_until(lambda: told)
        assert reason in told[0]
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 50)
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    # The process ends with the status of an incomplete recording, and says why once.
    assert status == 1
    assert error.count('the simulation goes on') == 1 and reason in error
    # Of what is there still, something is left to be done; of what is not, nothing.
    bag = tmp_path / 'bag'
    assert error.count(f'ros2 run hnn_vi_ros recover_bag {bag}') == bag.exists()


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
    assert 'the simulation goes on' not in error
    # One line for each file, which the node says, and what to do about the bag.
    assert sum('[ERROR]' in line for line in error.splitlines()) == 2
    assert f'recover_bag {tmp_path / "bag"}' in error and 'picture.rrd' in error
    assert all('[hnn_simulator]' in line for line in error.splitlines())
    assert 'is not complete' in out


def test_picture_that_cannot_be_written_is_told_while_the_simulation_goes_on(tmp_path: Path):
    process = start(tmp_path, rerun_path='picture.rrd')
    told: list[str] = []
    with peer() as other:
        listen(other, told)
        other.spin_until(lambda: len(other.states) > 50)
        limit_files(process, 4096)
        other.spin_until(lambda: told)
        assert 'picture.rrd: the rerun recording stopped' in told[0]
        process.send_signal(signal.SIGINT)
        status, _, error = finish(process)
    assert status == 1 and error.count('the simulation goes on') == 1


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
