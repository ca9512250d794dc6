# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that were remapped are told, and their bags are read like others."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun, resume
from hnn_vi_ros.ros.replay.replay_check import check_replay
from hnn_vi_ros.ros.replay.replay_node import ReplayNode
from hnn_vi_ros.ros.rerun_bridge import RerunBridge
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.scene import Scene
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
import recorded
from recorded import as_received, record_run

CALLED = {'/hnn_simulator/commands': '/forces', '/hnn_simulator/state': '/robot/full_state',
          '/joint_states': '/robot/joints'}
DRIVEN = """\
hamiltonian: {kind: harmonic_oscillator}
effects: [{kind: external_force, coordinates: [x]}]
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [1.0], p: [0.0]}
"""


@pytest.fixture
def driven(tmp_path: Path) -> Scene:
    (tmp_path / 'driven.yaml').write_text(DRIVEN)
    return load_scene(tmp_path / 'driven.yaml')


@pytest.fixture
def calling(monkeypatch):
    """Let runs be recorded under other names than their own."""
    topic = recorded._topic

    def called(name: str, kind: type, qos: QoSProfile):
        found = topic(name, kind, qos)
        return replace(found, name=CALLED.get(found.name, found.name))

    monkeypatch.setattr(recorded, '_topic', called)


@contextmanager
def ros(*arguments: str) -> Iterator[None]:
    rclpy.init(args=['--ros-args', *arguments])
    try:
        yield
    finally:
        rclpy.try_shutdown()


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
    assert verdict.good and 'H and work of 100 samples agree' in verdict.text, verdict.text
    assert resume(as_received(bag, tmp_path / 'a.mcap')).step == 100
    assert {'state', 'commands', 'joint_states'} <= set(RecordedRun(bag).names.values())


@pytest.mark.parametrize('told', [{'/hnn_simulator/state': '/none', 'y': 3}, [1], None])
def test_name_that_is_told_and_is_not_there_changes_nothing(tmp_path, driven, told):
    assert check_replay(record_run(tmp_path / 'bag', driven, 5, remapped=told)).good


def test_bridge_shows_and_replay_leaves_out_what_was_remapped(tmp_path, driven, calling):
    bag = record_run(tmp_path / 'bag', driven, 100, commands={5: [[0.5]]}, remapped=CALLED)
    with ros('-p', 'rerun_sink:=file', '-p', f'rerun_path:={tmp_path / "a.rrd"}'):
        bridge = RerunBridge()
        assert bridge.show_bag(bag) == 100
        bridge.close()
    with ros():
        topics = {publisher.topic_name for publisher in ReplayNode(bag, {}, []).publishers}
        assert '/robot/joints' in topics and '/forces' not in topics


def test_bag_of_before_the_state_is_shown_by_its_q_and_p_alone(tmp_path, driven, calling):
    bag = record_run(tmp_path / 'bag', driven, 5, state=False)
    with ros('-p', 'rerun_sink:=file', '-p', f'rerun_path:={tmp_path / "a.rrd"}'):
        bridge = RerunBridge()
        assert bridge.show_bag(bag) == 5
        bridge.close()
