# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A quadrotor that a controller in a process of its own holds at a place, and its bag."""

import signal

from geometry_msgs.msg import Quaternion
from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.hover_node import commands_of, matrix
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.replay.replay_check import check_replay
from hnn_vi_ros.ros.topics.poses import OdometryEncoder
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.simulation.build import build
from nav_msgs.msg import Odometry
import numpy as np
from peer import peer, SIMULATOR
from processes import finish, start, start_executable
import pytest
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import Float64MultiArray

PLACE = np.array([0.5, -0.5, 10.5])


def test_matrix_of_the_controller_takes_the_body_to_space():
    x, y, z, w = q = np.array([0.1, -0.3, 0.5, 0.7]) / np.sqrt(0.84)
    expected = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(matrix(Quaternion(x=x, y=y, z=z, w=w)), expected, atol=1e-15)


@pytest.mark.parametrize('late', [0, 3])
def test_controller_brings_the_quadrotor_to_a_place_also_by_commands_that_come_late(late: int):
    run = build(load_scene('quadrotor'))
    sampler, encoder = Sampler(run, 50.0), OdometryEncoder(run.hamiltonian.coordinates, 'map')
    place, told, heights = np.array([8.0, -5.0, 14.0]), [], []
    for _ in range(800):
        run.advance(sampler.every)
        (payload,) = encoder.encode(sampler.sample())
        told.append(commands_of(deserialize_message(payload, Odometry), place))
        run.set_command(told[max(0, len(told) - 1 - late)])
        heights.append(run.q[2])
    # Of the slowest mode there is exp(-0.8 t) left, of the way exp(-5).
    assert abs(run.q[:3] - place).max() < 0.02 and abs(run.p[:3]).max() < 0.02
    assert min(heights) > 9.5 and max(heights) < 14.5


def test_quadrotor_is_held_at_a_place_over_commands_and_its_bag_is_verified(tmp_path):
    """In lockstep: a step is asked for when its command has come, however long that takes."""
    simulator = start(tmp_path, scene='quadrotor', record_path='bag', rerun_sink='none',
                      publish_rate=50.0)
    controller = start_executable('hover', '--ros-args', *(
        word for name, value in zip('xyz', PLACE.tolist(), strict=True)
        for word in ('-p', f'{name}:={value}')), folder=tmp_path)
    with peer() as other:
        heard: list[Float64MultiArray] = []
        seen: list[Odometry] = []
        other.node.create_subscription(
            Float64MultiArray, f'{SIMULATOR}/commands', heard.append, 100)
        other.node.create_subscription(Odometry, f'{SIMULATOR}/odometry', seen.append, 100)
        other.spin_until(lambda: heard and seen)
        assert other.pause().success
        assert other.set_parameters(step_count=10).successful
        # From the initial state, in a bag of its own.
        assert other.trigger('reset').success
        there = 0
        for _ in range(1500):
            commands, poses = len(heard), len(seen)
            assert other.trigger('step').success
            other.spin_until(lambda: len(heard) > commands and len(seen) > poses)
            at = seen[-1].pose.pose.position
            there = there + 1 if abs(np.array([at.x, at.y, at.z]) - PLACE).max() < 0.05 else 0
            if there == 50:
                break
        assert there == 50
        for process in (controller, simulator):
            process.send_signal(signal.SIGINT)
            assert finish(process)[0] == 0
    bag = tmp_path / 'bag-2'
    verdict = check_replay(bag)
    assert verdict.good, verdict.text
    commands = [*RecordedRun(bag).commands()]
    assert len(commands) > 100
    assert {topic for _, topic, _ in commands} == {f'{SIMULATOR}/commands'}
