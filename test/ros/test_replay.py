# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Replay as a process: what a listener hears of a bag, when, and what the services do."""

from collections.abc import Iterator
from pathlib import Path
import re
import signal

from executables import Executable
from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.replay.replay_node import find_type, recorded_qos
from hnn_vi_ros.ros.topics.messages import qos_yaml
from hnn_vi_ros.ros.topics.outputs import LATCHED
from messages import assert_message, refused
import numpy as np
from peer import Listener, peer
from processes import finish, refusal, start_executable
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from recorded import QUEUE, record_run, recorded_messages, writing
from rosgraph_msgs.msg import Clock
from scene_files import write_scene
from std_msgs.msg import String
from std_srvs.srv import SetBool

SCENE = '/hnn_simulator/scene'


def start_replay(bag: Path, *options: object) -> Executable:
    return start_executable('replay', bag, *options)


@pytest.fixture
def listener() -> Iterator[Listener]:
    with peer(Listener) as found:
        yield found


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a bag of two seconds, five messages each 10 ms, and a scene."""
    return record_run(tmp_path_factory.mktemp('run') / 'bag', load_scene('exact_pendulum'), 200,
                      qos=QUEUE)


def test_listener_receives_the_same_bytes_in_the_same_order(bag, listener):
    replay = start_replay(bag, '--discovery-time', 20)
    listener.spin_until(lambda: replay.poll() is not None)
    listener.spin_until(lambda: listener.counts == {200})
    status, _, log = finish(replay)
    assert status == 0
    assert listener.received == recorded_messages(bag)
    assert '1001 messages published' in log
    # How late is told; a busy machine is late.
    assert re.search(r'late by median [\d.]+ ms, p99 [\d.]+ ms', log)


def test_unfinished_bag_is_replayed(tmp_path, listener):
    live = record_run(tmp_path / 'live', load_scene('exact_pendulum'), 60, close=False)
    path = tmp_path / 'cut.mcap'
    path.write_bytes((live / 'live_0.mcap').read_bytes()[:-1])
    expected = recorded_messages(path)
    replay = start_replay(path, '--discovery-time', 20)
    listener.spin_until(lambda: replay.poll() is not None)
    for _ in range(20):
        listener.spin_until(lambda: True)
    assert finish(replay)[0] == 0
    assert listener.received == expected
    assert len(expected['/joint_states']) == 60


def test_services_pause_step_and_go_on_with_the_clock_of_the_bag(bag, listener):
    stamps = []
    listener.node.create_subscription(
        Clock, '/clock', lambda m: stamps.append(m.clock.sec * 10**9 + m.clock.nanosec),
        QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    replay = start_replay(bag, '--start-paused', '--discovery-time', 20, '--ros-args',
                          '-p', 'publish_clock:=true')
    answers = []
    # Refused until playing has begun.
    listener.spin_until(lambda: answers.append(listener.trigger('/hnn_replay/step'))
                        or answers[-1].success)
    # The scene, which is stamped with the initial state.
    assert answers[-1].message == 't = 0.000000000 s' and listener.counts == {0}
    for count in (1, 2):
        step = listener.trigger('/hnn_replay/step')
        listener.spin_until(lambda: listener.counts == {count})
        assert step.message == f't = {0.01 * count:.9f} s'
    playing = listener.call(SetBool, '/hnn_replay/set_pause', data=False)
    assert (playing.success, playing.message) == (True, 'playing')
    step = listener.trigger('/hnn_replay/step')
    assert not step.success and 'paused' in step.message
    listener.spin_until(lambda: listener.counts == {200})
    assert finish(replay)[0] == 0
    # Best effort: some may be lost, none comes twice or late.
    assert len(stamps) > 20 and stamps == sorted(set(stamps)) and stamps[0] > 0


def test_window_topics_and_rate_are_chosen_by_parameters(bag, listener):
    replay = start_replay(
        bag, '--topics', '/joint_states, /hnn_simulator/energy', '--discovery-time', 20,
        '--ros-args', '-p', 'rate:=2', '-p', 'start_offset:=0.5', '-p', 'duration:=1')
    listener.spin_until(lambda: replay.poll() is not None)
    status, _, log = finish(replay)
    assert status == 0 and '202 messages published' in log
    listener.spin_until(lambda: len(listener.heard['/hnn_simulator/energy']) == 101)
    assert listener.heard['/hnn_simulator/q'] == []
    walls = [wall for wall, _ in listener.heard['/joint_states']]
    # Every 10 ms, at twice the pace.
    assert np.median(np.diff(walls)) < 7.5e6 and walls[-1] - walls[0] > 0.25e9


def test_loop_goes_on_until_sigint_and_exits_0(bag, listener):
    # At a pace that a busy machine hears, too.
    replay = start_replay(bag, '--loop', '--rate', 4, '--discovery-time', 20)
    listener.spin_until(lambda: min(listener.counts) > 420)
    replay.send_signal(signal.SIGINT)
    assert finish(replay)[0] == 0
    energies = listener.received['/hnn_simulator/energy']
    assert energies[:400] == recorded_messages(bag)['/hnn_simulator/energy'] * 2


@pytest.mark.parametrize('options', [[], ['--start-offset', 1.5, '--duration', 0.2]])
def test_who_subscribes_while_a_bag_is_played_gets_its_scene(bag, listener, options):
    replay = start_replay(bag, '--discovery-time', 0, '--loop', *options)
    listener.spin_until(lambda: listener.heard['/joint_states'])
    scenes = listener.hear(String, SCENE, LATCHED)
    listener.spin_until(lambda: scenes)
    replay.send_signal(signal.SIGINT)
    assert finish(replay)[0] == 0
    assert scenes[0].data.encode() == BagReader(bag).attachment('scene.yaml')


@pytest.mark.parametrize('options, published', [
    ([], 11), (['--topics', f'{SCENE}, /hnn_simulator/commands'], 3)])
def test_commands_are_played_only_if_they_are_named(tmp_path, options, published):
    scene = write_scene(
        tmp_path / 'scene.yaml', effects='{kind: external_force, coordinates: [x]}')
    driven = record_run(tmp_path / 'bag', load_scene(scene), 2,
                        commands={0: [[1.0], WrenchStamped()], 1: [[2.0]]}, refuse=True)
    status, _, log = finish(start_replay(driven, '--discovery-time', 0, *options))
    assert status == 0 and f'{published} messages published' in log
    for topic in ('commands', 'wrench'):
        assert (f'/hnn_simulator/{topic} is omitted' in log) == (not options)


def foreign_bag(path: Path, *types: str, encoding: str = 'cdr') -> Path:
    with writing(path) as writer:
        for i, kind in enumerate(types):
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(f'/topic{i}', encoding, schema, {
                'topic_type_hash': 'RIHS01_0'} if kind == 'std_msgs/msg/Int8' else {})
            writer.add_message(channel, 5, b'\0\1\0\0\0\0\0\0', 5)
    return path


def test_topic_whose_type_is_not_installed_is_left_out_with_a_warning(tmp_path):
    path = foreign_bag(tmp_path / 'a.mcap', 'nobody_msgs/msg/Nothing', 'std_msgs/msg/Nothing',
                       'std_msgs/msg/Int8', 'std_msgs/msg/Int32')
    status, _, log = finish(start_replay(path, '--discovery-time', 0))
    assert status == 0
    assert '/topic0 is omitted: its type nobody_msgs/msg/Nothing is not installed' in log
    assert '/topic1 is omitted' in log
    assert '/topic2 is omitted: the installed definition of std_msgs/msg/Int8 differs' in log
    assert '1 messages published' in log


def test_mistake_is_one_line_with_the_remedy(bag, tmp_path):
    foreign = foreign_bag(tmp_path / 'a.mcap', 'std_msgs/msg/Int32', encoding='json')
    for words in (['nothing'], ['--rate', '1'], ['--rate', '0', bag], ['--rate', '-1', bag],
                  [bag, '--topics', '/nothing'], [bag, '--start-offset', '5'],
                  [bag, '--ros-args', '-p', 'rate:=fast'], [foreign], [foreign, '--verify'],
                  [bag, '--node', 'left']):
        assert_message(refusal('replay', *words))


@pytest.mark.parametrize('qos', [
    QoSProfile(depth=7), QoSProfile(history=HistoryPolicy.KEEP_ALL),
    QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL,
               reliability=ReliabilityPolicy.BEST_EFFORT, lifespan=Duration(seconds=2)),
], ids=['default', 'keep all', 'latched'])
def test_recorded_qos_is_published_again(qos):
    assert qos_yaml(recorded_qos(qos_yaml(qos))) == qos_yaml(qos) or (
        qos.history == HistoryPolicy.KEEP_ALL
        and recorded_qos(qos_yaml(qos)).history == HistoryPolicy.KEEP_ALL)


def test_qos_that_is_unknown_is_that_of_a_default_publisher():
    for text in ('', '[]', '{', '- 3', '[{history: unknown, depth: 0}]',
                 '[{history: 3, reliability: 0, durability: 5}]'):
        qos = recorded_qos(text)
        assert (qos.history, qos.depth, qos.reliability, qos.durability) == (
            HistoryPolicy.KEEP_LAST, 10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def test_qos_by_number_is_that_of_older_bags():
    qos = recorded_qos('- {history: 1, depth: 3, reliability: 2, durability: 1}')
    assert (qos.depth, qos.reliability, qos.durability) == (
        3, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL)


def test_type_that_is_no_message_is_refused():
    for name in ('', 'std_msgs', 'std_msgs/msg/Nothing', '../x', 'os/msg/path', 'os/path',
                 'std_msgs/msg/_string', 'std_msgs/msg/__name__'):
        with refused(RecordingError):
            find_type(name)


def test_replay_ends_in_time_when_it_is_terminated_before_it_begins(bag):
    replay = start_replay(bag, '--discovery-time', 60)
    with peer() as other:
        other.spin_until(lambda: other.node.count_publishers('/joint_states'))
    replay.send_signal(signal.SIGTERM)
    assert finish(replay, 45.0)[0] == 0
