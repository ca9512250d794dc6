# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Replay as a process: what a listener hears of a bag, when, and what the services do."""

from collections.abc import Iterator
from pathlib import Path
import re
import signal
import subprocess
import time

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros import load_scene
from hnn_vi_ros.bags.mcap_reader import BagReader
from hnn_vi_ros.errors import ParameterError, RecordingError
from hnn_vi_ros.ros.replay.replay_node import find_type, main, recorded_qos
from hnn_vi_ros.ros.topics.messages import qos_yaml
from hnn_vi_ros.ros.topics.outputs import LATCHED
from mcap.writer import Writer
import numpy as np
from peer import nodes_of, wait_for_way_back
from processes import finish, start_executable, wait_until
import pytest
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from recorded import QUEUE, record_run
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

TYPES = {'/hnn_simulator/state': JointState, '/hnn_simulator/q': Float64MultiArray,
         '/hnn_simulator/p': Float64MultiArray, '/hnn_simulator/energy': Float64,
         '/joint_states': JointState}
SCENE = '/hnn_simulator/scene'


def start_replay(bag: Path, *options: object) -> subprocess.Popen:
    return start_executable('replay', bag, *options)


class Listener:
    """A node that keeps the serialised messages of all topics, with the time of each."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor):
        self.node, self._executor = node, executor
        self.heard: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in TYPES}
        for topic, kind in TYPES.items():
            node.create_subscription(
                kind, topic, lambda data, topic=topic: self.heard[topic].append(
                    (time.monotonic_ns(), bytes(data))), QUEUE, raw=True)

    def spin_until(self, condition, timeout: float = 120.0) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, 'timed out'
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, kind: type, name: str, request: object):
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready)
        wait_for_way_back(self.node, self.spin_until, name.rpartition('/')[0])
        future = client.call_async(request)
        self.spin_until(future.done)
        self.node.destroy_client(client)
        return future.result()

    @property
    def counts(self) -> set[int]:
        return {len(messages) for messages in self.heard.values()}


@pytest.fixture
def listener() -> Iterator[Listener]:
    with nodes_of('listener') as ((node,), executor):
        yield Listener(node, executor)


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a bag of two seconds, five messages each 10 ms, and a scene."""
    return record_run(tmp_path_factory.mktemp('run') / 'bag', load_scene('exact_pendulum'), 200,
                      qos=QUEUE)


def recorded_messages(bag: Path) -> dict[str, list[bytes]]:
    reader = BagReader(bag)
    messages = {topic: [] for topic in [*TYPES, SCENE]}
    for message in reader.messages():
        messages[reader.channels[message.channel].topic].append(message.data)
    del messages[SCENE]
    return messages


def test_listener_receives_the_same_bytes_in_the_same_order(bag, listener):
    replay = start_replay(bag, '--discovery-time', 20)
    listener.spin_until(lambda: replay.poll() is not None)
    listener.spin_until(lambda: listener.counts == {200})
    status, _, log = finish(replay)
    assert status == 0
    assert {topic: [data for _, data in messages] for topic, messages
            in listener.heard.items()} == recorded_messages(bag)
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
    assert {topic: [data for _, data in messages] for topic, messages
            in listener.heard.items()} == expected
    assert len(expected['/joint_states']) == 60


def test_services_pause_step_and_go_on_with_the_clock_of_the_bag(bag, listener):
    stamps = []
    listener.node.create_subscription(
        Clock, '/clock', lambda m: stamps.append(m.clock.sec * 10**9 + m.clock.nanosec),
        QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    replay = start_replay(bag, '--start-paused', '--discovery-time', 20, '--ros-args',
                          '-p', 'publish_clock:=true')
    step = listener.call(Trigger, '/hnn_replay/step', Trigger.Request())
    wait_for_step = time.monotonic() + 120.0
    while not step.success:
        # Playing has not begun yet.
        assert time.monotonic() < wait_for_step
        step = listener.call(Trigger, '/hnn_replay/step', Trigger.Request())
    # The scene, which is stamped with the initial state.
    assert step.message == 't = 0.000000000 s' and listener.counts == {0}
    for count in (1, 2):
        step = listener.call(Trigger, '/hnn_replay/step', Trigger.Request())
        listener.spin_until(lambda: listener.counts == {count})
        assert step.message == f't = {0.01 * count:.9f} s'
    playing = listener.call(SetBool, '/hnn_replay/set_pause', SetBool.Request(data=False))
    assert (playing.success, playing.message) == (True, 'playing')
    refused = listener.call(Trigger, '/hnn_replay/step', Trigger.Request())
    assert not refused.success and 'paused' in refused.message
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
    listener.spin_until(lambda: min(listener.counts) > 450)
    replay.send_signal(signal.SIGINT)
    assert finish(replay)[0] == 0
    energies = [data for _, data in listener.heard['/hnn_simulator/energy']]
    assert energies[:400] == recorded_messages(bag)['/hnn_simulator/energy'] * 2


@pytest.mark.parametrize('options', [[], ['--start-offset', 1.5, '--duration', 0.2]])
def test_who_subscribes_while_a_bag_is_played_gets_its_scene(bag, listener, options):
    replay = start_replay(bag, '--discovery-time', 0, '--loop', *options)
    listener.spin_until(lambda: listener.heard['/joint_states'])
    scenes = []
    listener.node.create_subscription(String, SCENE, scenes.append, LATCHED)
    listener.spin_until(lambda: scenes)
    replay.send_signal(signal.SIGINT)
    assert finish(replay)[0] == 0
    assert scenes[0].data.encode() == BagReader(bag).attachment('scene.yaml')


@pytest.mark.parametrize('options, published', [
    ([], 11), (['--topics', f'{SCENE}, /hnn_simulator/commands'], 3)])
def test_commands_are_played_only_if_they_are_named(tmp_path, options, published):
    (tmp_path / 'scene.yaml').write_text(
        'hamiltonian: {kind: free_particle, mass: 1.0, names: [x]}\n'
        'effects: [{kind: external_force, coordinates: [x]}]\nstep_size: 0.01\n'
        'integrator: {kind: generalized_leapfrog}\ninitial_state: {q: [0.0], p: [0.0]}\n')
    driven = record_run(tmp_path / 'bag', load_scene(tmp_path / 'scene.yaml'), 2,
                        commands={0: [[1.0], WrenchStamped()], 1: [[2.0]]})
    status, _, log = finish(start_replay(driven, '--discovery-time', 0, *options))
    assert status == 0 and f'{published} messages published' in log
    for topic in ('commands', 'wrench'):
        assert (f'/hnn_simulator/{topic} is left out' in log) == (not options)


def foreign_bag(path: Path, *types: str, encoding: str = 'cdr') -> Path:
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        for i, kind in enumerate(types):
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(f'/topic{i}', encoding, schema, {
                'topic_type_hash': 'RIHS01_0'} if kind == 'std_msgs/msg/Int8' else {})
            writer.add_message(channel, 5, b'\0\1\0\0\0\0\0\0', 5)
        writer.finish()
    return path


def test_topic_whose_type_is_not_installed_is_left_out_with_a_warning(tmp_path):
    path = foreign_bag(tmp_path / 'a.mcap', 'nobody_msgs/msg/Nothing', 'std_msgs/msg/Nothing',
                       'std_msgs/msg/Int8', 'std_msgs/msg/Int32')
    status, _, log = finish(start_replay(path, '--discovery-time', 0))
    assert status == 0
    assert '/topic0 is left out: its type nobody_msgs/msg/Nothing is not installed' in log
    assert '/topic1 is left out' in log
    assert '/topic2 is left out: std_msgs/msg/Int8 was recorded with another definition' in log
    assert '1 messages published' in log


@pytest.mark.parametrize('arguments, told', [
    (['nothing'], 'No such file'), (['--rate', '1'], 'required: BAG'),
    (['--rate', '0', 'BAG'], 'rate'),
    (['BAG', '--topics', '/nothing'], "'/nothing' is not in the bag; it holds: /hnn_simulator"),
    (['BAG', '--start-offset', '5'], 'the bag is 2 s long'),
    (['BAG', '--ros-args', '-p', 'rate:=fast'], 'rate'),
    (['FOREIGN'], 'no topic that can be published'),
    (['FOREIGN', '--verify'], 'holds no topic state of a simulator'),
    (['BAG', '--node', 'left'], '--node: chooses what --verify checks; --topics chooses'),
])
def test_mistake_is_one_line_with_the_remedy(bag, tmp_path, arguments, told):
    foreign = foreign_bag(tmp_path / 'a.mcap', 'std_msgs/msg/Int32', encoding='json')
    words = [{'BAG': bag, 'FOREIGN': foreign}.get(word, word) for word in arguments]
    status, _, error = finish(start_replay(*(words or [''])))
    assert status != 0
    assert told in error.splitlines()[-1]


@pytest.mark.parametrize('qos', [
    QoSProfile(depth=7), QoSProfile(history=HistoryPolicy.KEEP_ALL),
    QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL,
               reliability=ReliabilityPolicy.BEST_EFFORT, lifespan=Duration(seconds=2)),
], ids=['default', 'keep all', 'latched'])
def test_recorded_qos_is_published_again(qos):
    assert qos_yaml(recorded_qos(qos_yaml(qos))) == qos_yaml(qos) or (
        qos.history == HistoryPolicy.KEEP_ALL
        and recorded_qos(qos_yaml(qos)).history == HistoryPolicy.KEEP_ALL)


@pytest.mark.parametrize('text', ['', '[]', '{', '- 3', '[{history: unknown, depth: 0}]',
                                  '[{history: 3, reliability: 0, durability: 5}]'])
def test_qos_that_is_unknown_is_that_of_a_default_publisher(text):
    qos = recorded_qos(text)
    assert (qos.history, qos.depth, qos.reliability, qos.durability) == (
        HistoryPolicy.KEEP_LAST, 10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def test_qos_by_number_is_that_of_older_bags():
    qos = recorded_qos('- {history: 1, depth: 3, reliability: 2, durability: 1}')
    assert (qos.depth, qos.reliability, qos.durability) == (
        3, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize('name', ['', 'std_msgs', 'std_msgs/msg/Nothing', '../x', 'os/msg/path'])
def test_type_that_is_no_message_is_refused(name):
    with pytest.raises(RecordingError, match='not installed'):
        find_type(name)


def test_option_out_of_its_range_is_a_parameter_error(bag):
    with pytest.raises(ParameterError, match='rate'):
        main([str(bag), '--rate', '-1'])


def test_replay_ends_in_time_when_it_is_terminated_before_it_begins(bag):
    replay = start_replay(bag, '--discovery-time', 60)
    time.sleep(2.0)
    replay.send_signal(signal.SIGTERM)
    wait_until(lambda: replay.poll() is not None, 45.0)
    assert finish(replay)[0] in (0, -signal.SIGTERM)


@pytest.mark.parametrize('name', ['std_msgs/msg/_string', 'std_msgs/msg/__name__', 'os/path'])
def test_name_of_what_is_no_message_type_is_refused(name):
    with pytest.raises(RecordingError, match='is not installed'):
        find_type(name)
