# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An arm that another process drives as ros2_control does, and what launches both."""

import json
from pathlib import Path
import runpy
import signal
import subprocess
import sys
from types import SimpleNamespace

from ament_index_python import packages
from hnn_vi_ros import load_scene
from hnn_vi_ros.simulation import build
from launch_stand_ins import stand_in
import numpy as np
from processes import finish, read_bag, simulator_words, start_executable
import pytest
from recorded import assert_agrees
from scene_files import write_scene
import yaml

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ROOT / 'config' / 'robots'


def test_controller_in_its_own_process_moves_an_arm_from_a_to_b(tmp_path):
    servo = ('{kind: servo, coordinates: [shoulder, elbow], stiffness: [400.0, 100.0], '
             'damping: [20.0, 4.0], effort_limit: [40.0, 15.0], position: [0.0, 0.0]}')
    scene = write_scene(
        tmp_path / 'arm.yaml', f'urdf, file: {ROBOTS / "two_joint_arm.urdf"}', servo,
        step_size=0.001, q=[0.0, 0.0], p=[0.0, 0.0])
    process = start_executable(
        'simulator', *simulator_words(scene=scene, publish_rate=250.0, record_path='bag'),
        '-r', 'joint_states:=/robot_joint_states',
        '-r', '~/joint_commands:=/robot_joint_commands',
        '-r', 'robot_description:=/arm/description', folder=tmp_path)
    target = {'elbow': 0.9, 'shoulder': -0.7}
    ended = subprocess.run(
        [sys.executable, Path(__file__).parent / 'controller_stand_in.py',
         json.dumps([target, 1.5])], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    # It is silent from now on; what it said last holds.
    try:
        process.wait(1.0)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    assert finish(process)[0] == 0
    topics = read_bag(tmp_path / 'bag')
    ((begun, _),), ((stamp, description),) = (
        topics['/hnn_simulator/scene'], topics['/arm/description'])
    assert stamp == begun
    assert description.data == (ROBOTS / 'two_joint_arm.urdf').read_text()
    states = [message for _, message in topics['/robot_joint_states']]
    last, commands = states[-1], topics['/robot_joint_commands']
    assert last.name == ['shoulder', 'elbow'] and 0 < len(commands) <= found['sent']
    # At rest where the servos carry the weight: k (q_r - q) = V'(q).
    simulation = build(load_scene(scene))
    q = np.array(last.position)
    weight, _ = simulation.hamiltonian.gradient(q, np.zeros(2))
    assert [400.0, 100.0] * (np.array([-0.7, 0.9]) - q) == pytest.approx(weight, abs=1e-3)
    assert last.effort == pytest.approx(weight, abs=1e-3)
    # Some 0.9 N m over 100 N m/rad.
    assert np.abs(q - [-0.7, 0.9]).max() < 0.03
    # Of 1.125 rad/s at most, the damping alone makes up to 0.05 s.
    print(f'tracking error {found["error"]:.3g} rad, first answer after {found["latency"]:.3g} s, '
          f'{found["sent"]} commands')
    assert_agrees(tmp_path / 'bag')


def described(monkeypatch, installed: set[str]) -> tuple[list, list]:
    """Return arguments and entities of robot.launch.py where some packages are installed."""
    stand_in(monkeypatch)

    def share(package: str) -> str:
        if package != 'hnn_vi_ros' and package not in installed:
            raise packages.PackageNotFoundError(package)
        return str(ROOT)

    # Looked up when launching.py is imported, which the launch file does.
    monkeypatch.setattr(packages, 'get_package_share_directory', share)
    description = runpy.run_path(
        str(ROOT / 'launch' / 'robot.launch.py'))['generate_launch_description']()
    *arguments, function = description
    given = {argument.name: argument.default for argument in arguments}
    return arguments, function.function(SimpleNamespace(launch_configurations=given))


ALL = {'robot_state_publisher', 'controller_manager', 'joint_state_topic_hardware_interface',
       'joint_state_broadcaster', 'joint_trajectory_controller', 'rviz2'}


def test_launch_of_a_robot_starts_what_is_installed_and_joins_its_topics(monkeypatch):
    arguments, entities = described(monkeypatch, ALL)
    assert all(Path(argument.default).is_file() for argument in arguments[:3])
    assert [entity.executable for entity in entities] == [
        'simulator', 'robot_state_publisher', 'ros2_control_node', 'spawner', 'rviz2']
    simulator, publisher, manager, spawner, _ = entities
    assert ('~/joint_commands', '/robot_joint_commands') in simulator.remappings
    assert '<ros2_control' in publisher.parameters[0]['robot_description']
    controllers = yaml.safe_load(Path(manager.parameters[1]).read_text())
    assert set(spawner.arguments) <= controllers['controller_manager']['ros__parameters'].keys()


def test_launch_of_a_robot_says_what_is_not_installed(monkeypatch):
    _, entities = described(monkeypatch, {'controller_manager'})
    told = [entity.msg for entity in entities if entity.kind == 'log']
    assert all(any(package in line for line in told) == (package != 'controller_manager')
               for package in ALL)
    node, = (entity for entity in entities if entity.kind == 'node')
    # Its joint states move the picture, where there is one.
    assert node.executable == 'simulator' and node.remappings == []


def test_scene_and_controllers_of_the_launched_arm_fit_its_urdf():
    scene = load_scene(ROBOTS / 'six_joint_arm.yaml')
    names = [coordinate.name for coordinate in scene.create_hamiltonian().coordinates]
    controllers = yaml.safe_load((ROBOTS / 'six_joint_arm.controllers.yaml').read_text())
    joints = controllers['joint_trajectory_controller']['ros__parameters']['joints']
    servo, = scene.effects
    assert names == joints == servo.coordinates
    urdf = (ROBOTS / 'six_joint_arm.urdf').read_text()
    # Its interface begins where the scene does.
    for name, start in zip(names, scene.initial_state.q, strict=True):
        assert f'<joint name="{name}">\n      <command_interface name="position"><param ' \
            f'name="initial_value">{start}</param>' in urdf
    assert servo.position == scene.initial_state.q
