# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that were remapped, and those of two simulators, each in a namespace of its own."""

from dataclasses import replace
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.controller_node import ControllerNode
from hnn_vi_ros.ros.listener_node import Listener
from hnn_vi_ros.ros.replay.picture import write_picture
from hnn_vi_ros.run.recorded_run import RecordedRun, resume
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.ros.replay.replay_node import ReplayNode
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.scene import Scene
from lifecycle_msgs.srv import GetState
from peer import peer, ros, wait_for_way_back
from processes import finish, read_bag, start
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
import recorded
from recorded import as_received, record_run
from scene_files import write_scene
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

CALLED = {'/hnn_simulator/commands': '/forces', '/hnn_simulator/state': '/robot/full_state',
          '/joint_states': '/robot/joints'}


@pytest.fixture
def driven(tmp_path: Path) -> Scene:
    return load_scene(write_scene(
        tmp_path / 'driven.yaml', effects='{kind: external_force, coordinates: [x]}'))


@pytest.fixture
def calling(monkeypatch):
    """Let runs be recorded under other names than their own."""
    topic = recorded._topic

    def called(name: str, kind: type, qos: QoSProfile):
        found = topic(name, kind, qos)
        return replace(found, name=CALLED.get(found.name, found.name))

    monkeypatch.setattr(recorded, '_topic', called)


def test_scene_tells_what_remapped_topics_are_called():
    context = Context()
    rclpy.init(context=context, args=['--ros-args', '-r', '__ns:=/a', '-r', '__node:=sim', *(
        word for own, called in CALLED.items() if own != '/joint_states' for word in
        ('-r', f'{own.replace("/hnn_simulator", "~")}:={called}'))])
    try:
        node = Node('hnn_simulator', context=context)
        assert Topics(node, Settings()).descriptions.remapped == {
            '/a/sim/commands': '/forces', '/a/sim/state': '/robot/full_state'}
        other = Node('other', context=context, use_global_arguments=False)
        assert not Topics(other, Settings()).descriptions.remapped
    finally:
        context.try_shutdown()


def test_run_whose_topics_were_remapped_agrees_bit_by_bit(tmp_path, driven, calling):
    bag = record_run(tmp_path / 'bag', driven, 100, commands={0: [[0.5]], 40: [[1.0]]},
                     remapped=CALLED)
    verdict = check_replay(bag)
    assert verdict.good, verdict.text
    assert 'H and work of 100 samples are bit-identical' in verdict.text
    assert resume(as_received(bag, tmp_path / 'a.mcap')).step == 100
    assert {'state', 'commands', 'joint_states'} <= set(RecordedRun(bag).names.values())


@pytest.mark.parametrize('told', [{'/hnn_simulator/state': '/none', 'y': 3}, [1], None])
def test_name_that_is_told_and_is_not_there_changes_nothing(tmp_path, driven, told):
    assert check_replay(record_run(tmp_path / 'bag', driven, 5, remapped=told)).good


def test_picture_shows_and_replay_leaves_out_what_was_remapped(tmp_path, driven, calling):
    bag = record_run(tmp_path / 'bag', driven, 100, commands={5: [[0.5]]}, remapped=CALLED)
    assert write_picture(bag, tmp_path / 'a.rrd') == (100, '')
    with ros():
        topics = {publisher.topic_name for publisher in ReplayNode(bag, {}, []).publishers}
        assert '/robot/joints' in topics and '/forces' not in topics


SCENES = {'left': 'exact_pendulum', 'right': 'exact_harmonic_oscillator'}


def test_two_simulators_in_two_namespaces_answer_and_do_not_interfere(tmp_path):
    # One of them could be over before the other is discovered.
    processes = [start(tmp_path, scene=scene, duration=2, record_path=namespace, discovery_time=20,
                       start_paused='true', __ns=f'/{namespace}',
                       **{f'qos_overrides./{namespace}/hnn_simulator/q.publisher.depth': 1000})
                 for namespace, scene in SCENES.items()]
    with peer() as other:
        heard = {namespace: other.hear(Float64MultiArray, f'/{namespace}/hnn_simulator/q', 1000)
                 for namespace in SCENES}
        for namespace in SCENES:
            node = f'/{namespace}/hnn_simulator'
            state, pause = (other.node.create_client(kind, f'{node}/{name}') for kind, name in (
                (GetState, 'get_state'), (SetBool, 'set_pause')))
            wait_for_way_back(other.node, other.spin_until, node)
            label = ''
            while label != 'active':
                future = state.call_async(GetState.Request())
                other.spin_until(future.done)
                label = future.result().current_state.label
                assert label in ('configuring', 'inactive', 'activating', 'active')
            future = pause.call_async(SetBool.Request(data=False))
            other.spin_until(future.done)
            assert future.result().success, future.result().message
        other.spin_until(lambda: all(process.poll() is not None for process in processes))
        other.spin(0.5)
    assert [finish(process)[0] for process in processes] == [0, 0]
    for namespace in SCENES:
        recorded = read_bag(tmp_path / namespace)
        assert {topic for topic in recorded if not topic.startswith(f'/{namespace}/')} <= {
            '/diagnostics'}
        assert [message.data.tolist() for message in heard[namespace]] == [
            message.data.tolist() for _, message in recorded[f'/{namespace}/hnn_simulator/q']]
        assert len(heard[namespace]) == 200
    assert heard['left'] != heard['right']


@pytest.mark.parametrize(('name', 'found'), [
    ('hnn_simulator', '/left/hnn_simulator'), ('/right/arm', '/right/arm')])
def test_nodes_beside_a_simulator_take_that_of_their_own_namespace(tmp_path, name, found):
    words = ['-r', '__ns:=/left', '-p', f'simulator:={name}']
    with ros('--ros-args', *words) as arguments:
        nodes = controller, listener = ControllerNode(arguments), Listener()
        assert controller._topic == f'{found}/joint_commands'
        assert [one.topic_name for one in listener.subscriptions] == ['/left/hnn_simulator/energy']
        for node in nodes:
            node.destroy_node()
