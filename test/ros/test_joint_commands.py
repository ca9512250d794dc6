# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Joints as robots are told what they are to do: by positions, velocities, efforts and paths."""

from pathlib import Path

from builtin_interfaces.msg import Duration, Time
from hnn_vi_ros import load_scene
from hnn_vi_ros.effects.servo import Servo
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.free_particle import FreeParticle
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.plumbing.executor import LONGEST_REASON
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.run.command_messages import read_joints, read_path
from hnn_vi_ros.ros.topics.messages import encode_feedback
from hnn_vi_ros.run import Sampler
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build, Simulation
from messages import refused
import numpy as np
from peer import simulating, SIMULATOR, stamp
from processes import read_bag, standard_error
import pytest
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from recorded import as_received, assert_agrees, record_run
from scene_files import write_scene
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

SERVO = ('{kind: servo, coordinates: [angle2, angle1], stiffness: [60.0, 90.0], '
         'damping: [4.0, 9.0], effort_limit: 40.0}')
FORCE = '{kind: external_force, coordinates: [angle1], timeout: 0.05}'
NAMES = ['angle1', 'angle2']


@pytest.fixture
def arm(tmp_path: Path):
    return scene_of(tmp_path, SERVO, FORCE)


def scene_of(folder: Path, *effects: str) -> Scene:
    return load_scene(write_scene(folder / 'arm.yaml', 'double_pendulum', ', '.join(effects),
                                  step_size=0.0025, q=[0.3, -0.2], p=[0.0, 0.0]))


def seconds(t: float) -> dict[str, int]:
    whole, nanoseconds = divmod(round(t * 1e9), 10**9)
    return {'sec': whole, 'nanosec': nanoseconds}


def joints(names=NAMES, **lists: list[float]) -> JointState:
    return JointState(name=names, **lists)


def path(*points: tuple, names=NAMES, begin: float = 0.0) -> JointTrajectory:
    """Return the message of points: their time, then positions, velocities and so on."""
    return JointTrajectory(
        header=Header(stamp=Time(**seconds(begin))), joint_names=names, points=[
            JointTrajectoryPoint(
                time_from_start=Duration(**seconds(t)), **dict(zip(
                    ('positions', 'velocities', 'accelerations', 'effort'), lists, strict=False)))
            for t, *lists in points])


def test_joint_command_has_a_number_for_each_name_or_none():
    command = read_joints(joints(position=[1.0, float('nan')], effort=[2.0, 3.0]), 0)
    assert command.names == tuple(NAMES)
    np.testing.assert_array_equal(
        [command.position, command.velocity, command.effort],
        [[1.0, np.nan], [np.nan, np.nan], [2.0, 3.0]])
    with refused(ValueError):
        read_joints(joints(velocity=[1.0]), 0)


def test_path_of_a_message_begins_now_or_at_its_stamp():
    points = [(0.5, [1.0, 2.0], [0.5, 0.0]), (2.25, [3.0, 4.0], [0.0, 0.0])]
    found = read_path(path(*points), 7 * 10**9)
    assert (found.names, found.delay, found.times.tolist()) == (tuple(NAMES), 0.0, [0.5, 2.25])
    assert found.positions.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert found.velocities.tolist() == [[0.5, 0.0], [0.0, 0.0]]
    assert found.accelerations is None
    assert read_path(path(*points, begin=7.25), 7 * 10**9).delay == 0.25
    assert read_path(JointTrajectory(), 0).times.size == 0


def test_path_whose_points_do_not_fit_together_is_refused():
    for points in ([(1.0, [1.0])],
                   [(1.0, [1.0, 2.0], [0.0, 0.0]), (2.0, [1.0, 2.0])],
                   [(1.0, [1.0, 2.0], [], [], [3.0, 4.0])]):
        with refused(ValueError):
            read_path(path(*points), 0)


@pytest.mark.parametrize('given', [
    lambda others: read_joints(joints(['j' * 200], position=[1.0]), 0),
    lambda others: read_path(path((1.0, [0.0] * len(others)), names=others), 0)])
def test_reason_with_the_names_of_twelve_joints_is_told_to_its_end(given):
    names = [f'left_arm_of_the_robot_{i}' for i in range(12)]
    simulation = Simulation(FreeParticle(1.0, names), INTEGRATORS['generalized_leapfrog'](), 0.01,
                            [0.0] * 12, [0.0] * 12, [Servo(names, 1.0)])
    with refused(ValueError) as caught:
        simulation.set_command(given(names[1:]))
    assert len(str(caught.value)) <= LONGEST_REASON


COMMANDS = {
    0: [joints(position=[0.1, 0.2])], 41: [joints(['angle2'], velocity=[1.0])],
    57: [joints(effort=[3.0, float('nan')], position=[0.2, 0.1]), path((0.25, [0.5, -0.5]))],
    101: [[1.5]], 150: [path((0.1, [0.3, 0.1], [0.2, 0.0], [0.0, 1.0]),
                             (0.3, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]), begin=0.39)]}


def test_run_of_joint_commands_agrees_bit_by_bit_by_those_in_its_bag(tmp_path, arm):
    # At 0 and 150 commands were heard before the bag was asked for.
    for begin in (None, 0, 60, 150, 160):
        bag = record_run(tmp_path / f'bag{begin}', arm, 70, commands=COMMANDS, begin=begin)
        assert_agrees(bag, 70 - (begin or 0) // 4)
    run = RecordedRun(tmp_path / 'bagNone')
    assert [(step, topic.rpartition('/')[2]) for step, topic, _ in run.commands()] == [
        (0, 'joint_commands'), (41, 'joint_commands'), (57, 'joint_commands'),
        (57, 'joint_trajectory'), (101, 'commands'), (150, 'joint_trajectory')]


def test_feedback_is_the_reference_what_is_and_their_difference(arm):
    simulation = build(arm)
    simulation.set_command(read_path(path((1.0, [0.5, -0.5])), 0))
    simulation.advance(100)
    sample = Sampler(simulation, 100.0).sample()
    payload, = encode_feedback(simulation)(sample)
    message = deserialize_message(payload, JointTrajectory)
    assert message.joint_names == NAMES[::-1] and stamp(message) == sample.stamp
    reference, actual, error = message.points
    # Of x = 3 s^2 - 2 s^3, a quarter of the way.
    share = np.array([0.15625, 1.125, 3.0])
    ends = np.array([-0.3, 0.2])
    expected = np.outer(share, ends) + np.outer([1.0, 0.0, 0.0], [-0.2, 0.3])
    np.testing.assert_allclose([reference.positions, reference.velocities,
                                reference.accelerations], expected, atol=1e-12)
    assert list(actual.positions) == sample.q[::-1].tolist()
    assert list(actual.velocities) == sample.dH_dp[::-1].tolist()
    dH_dq, _ = HAMILTONIANS['double_pendulum']().gradient(sample.q, sample.p)
    # All that drives p beside H is the servo.
    assert list(actual.effort) == pytest.approx((dH_dq - sample.dH_dq)[::-1], abs=1e-12)
    assert list(error.positions) == pytest.approx(expected[0] - sample.q[::-1], abs=1e-15)
    assert list(error.velocities) == pytest.approx(expected[1] - sample.dH_dp[::-1], abs=1e-15)


def test_simulator_does_what_joints_are_told_and_its_bag_is_verified(tmp_path, arm):
    with simulating(tmp_path, scene='arm.yaml', record_path='bag') as (other, process):
        # Of both kinds, as robots' controllers have them.
        commands = other.publisher(JointState, '~/joint_commands', qos_profile_sensor_data)
        paths = other.publisher(JointTrajectory, '~/joint_trajectory')
        feedback = other.hear(JointTrajectory, '~/joint_trajectory_state')
        other.spin_until(lambda: other.states and commands.get_subscription_count()
                         and paths.get_subscription_count()
                         and other.node.count_publishers(f'{SIMULATOR}/joint_trajectory_state'))
        commands.publish(joints(position=[0.1, 0.1]))
        other.spin_until(lambda: any(other.states[-1].effort))
        assert not feedback
        commands.publish(joints(['wrist'], position=[1.0]))
        paths.publish(path((0.5, [0.4, -0.4]), (1.0, [0.6, 0.0])))
        other.spin_until(lambda: feedback and (
            stamp(feedback[-1]) > stamp(feedback[0]) + 12 * 10**8))
        assert other.trigger('stop_recording').success
        assert other.trigger('start_recording').success
        paths.publish(path((0.5, [0.0, 0.0])))
        count = len(feedback)
        other.spin_until(lambda: len(feedback) > count + 60)
    error = standard_error(process)
    assert "~/joint_commands: message ignored: joint 'wrist' does not accept this" in error
    # It has come to the last point, and stays there.
    assert list(feedback[count - 1].points[0].positions) == [0.0, 0.6]
    for name in ('bag', 'bag-2'):
        assert_agrees(tmp_path / name)
        assert any(True for _ in RecordedRun(tmp_path / name).commands())
    topics = read_bag(tmp_path / 'bag')
    told = {stamp(message): message for message in feedback}
    recorded = topics[f'{SIMULATOR}/joint_trajectory_state']
    assert len(recorded) > 100
    for time, message in recorded:
        if time in told:
            assert list(told[time].points[2].positions) == message.points[2].positions.tolist()
    assert BagReader(tmp_path / 'bag-2').attachment('state.safetensors')


LIMITED = ('{kind: servo, coordinates: [angle1, angle2], stiffness: 60.0, damping: 4.0}',
           '{kind: joint_limits, upper: {angle1: 0.5}}')
BEYOND = {0: [joints(position=[0.1, 0.2])], 21: [joints(position=[0.9, 0.0])],
          50: [path((0.1, [0.8, 0.3]))]}


def test_commands_beyond_limits_that_a_bag_tells_to_have_acted_act_again(tmp_path):
    # As simulators recorded them before they refused such commands: they pressed on the stop.
    scene = scene_of(tmp_path, *LIMITED)
    refusing = build(scene)
    with refused(ValueError):
        refusing.set_command(read_joints(BEYOND[21][0], 0))
    assert_agrees(record_run(tmp_path / 'bag', scene, 40, commands=BEYOND, limited=False))


def test_commands_that_were_refused_are_so_again_where_others_recorded_them(tmp_path):
    # By simulated time, so that log times are stamps; what acted is not told apart.
    scene = scene_of(tmp_path, *LIMITED)
    refused = {
        20: BEYOND[0], 21: BEYOND[21], 30: [joints(['wrist'], position=[0.0])],
        35: [JointState(name=NAMES, position=[1.0])], 50: BEYOND[50],
        60: [path((0.5, [0.1, 0.1], [1.0, 1.0]))]}
    own = record_run(tmp_path / 'own', scene, 40, commands=refused, refuse=True)
    bag = as_received(own, tmp_path / 'others.mcap', jitter=0.0, epoch=0)
    run = RecordedRun(bag)
    assert run.stamped and not run.own
    verdict = check_replay(bag)
    assert '40 samples are bit-identical' in verdict.text
