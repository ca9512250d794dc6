# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages, bags and pictures of bodies that turn, whose q has other columns than p."""

from dataclasses import replace

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros import load_scene
from hnn_vi_ros.hamiltonians import HAMILTONIANS, MECHANISMS
from hnn_vi_ros.phase_space import Coordinate, momentum_rates, rotations
from hnn_vi_ros.recording import decode_state, RerunSink, Sample
from hnn_vi_ros.ros.initial_state import initial_state
from hnn_vi_ros.ros.topics.inputs import body_of, command_of
from hnn_vi_ros.ros.topics.poses import OdometryEncoder
from messages import refused
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from recorded import assert_agrees, encode_sample, record_run, SAMPLED
from rerun_reader import read
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

MIXED = [Coordinate('slide', 'm'), Coordinate('body', kind='pose'), Coordinate('angle', 'rad'),
         Coordinate('wheel', kind='rotation')]


def sample_of(q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray) -> Sample:
    return Sample(step=3, stamp=5, q=q, p=p, dH_dq=dH_dq, dH_dp=dH_dp, energy=1.5,
                  modified_energy=np.nan, energy_error=0.0, work=0.5)


def test_messages_of_a_mixed_system_hold_every_column_by_name():
    rng = np.random.default_rng(3)
    q, dH_dq, (p, dH_dp) = *rng.normal(size=(2, 13)), rng.normal(size=(2, 11))
    motors = rng.normal(size=11)
    sample = replace(sample_of(q, p, dH_dq, dH_dp), motors=motors)
    encoded = encode_sample(MIXED)(sample)
    state, q_told, p_told, energy, joints = (
        deserialize_message(data, output.message_type) for data, output in
        zip(encoded, SAMPLED, strict=True))
    assert list(q_told.data) == q.tolist() and list(p_told.data) == p.tolist()
    assert q_told.layout.dim[0].label.split(',')[4:8] == [
        'body_qx', 'body_qy', 'body_qz', 'body_qw']
    assert energy.data == 1.5
    told = dict(zip(state.name, state.position, strict=True))
    assert (told['wheel_qw'], told['p_wheel_rz'], told['p_angle']) == (q[12], p[10], p[7])
    assert (told['H'], told['work']) == (1.5, 0.5)
    # No joint turns by a quaternion.
    assert joints.name == ['slide', 'angle']
    assert list(joints.position) == [q[0], q[8]] and list(joints.velocity) == [dH_dp[0], dH_dp[7]]
    assert list(joints.effort) == [motors[0], motors[7]]
    decoded = decode_state(encoded[0])
    assert decoded.q.tolist() == q.tolist() and decoded.p.tolist() == p.tolist()
    rates = momentum_rates(rotations(MIXED), q, p, dH_dq, dH_dp)
    assert decoded.dp_dt.tolist() == rates.tolist() and rates.shape == (11,)
    assert rates[1:4].tolist() == (-dH_dq[1:4]).tolist()
    assert (decoded.energy, decoded.work) == (1.5, 0.5)


def test_rate_of_a_body_momentum_is_that_of_eulers_equations():
    top = HAMILTONIANS['heavy_top']([1.0, 1.4, 0.8])
    q, p = np.array([0.1, -0.5, 0.7, 0.5]), np.array([0.3, -0.2, 1.1])
    rates = momentum_rates((0,), q, p, *top.gradient(q, p))
    x, y, z, w = q
    # The vertical as the body sees it: the third row of R.
    vertical = np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x),
                         1.0 - 2.0 * (x * x + y * y)])
    omega = p / np.array(top.inertia)
    expected = np.cross(p, omega) + top.moment * np.cross(vertical, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(rates, expected, rtol=0.0, atol=1e-14)


def test_joint_states_are_no_initial_state_of_a_body_that_turns():
    with refused(ValueError):
        initial_state(JointState(), HAMILTONIANS['heavy_top'](), np.zeros(3))


@pytest.mark.parametrize('kind, place', [('heavy_top', []), ('quadrotor', [0.0, 0.0, 2.0])])
def test_picture_of_a_body_that_turns_has_its_columns_its_axes_and_its_path(
        tmp_path, kind: str, place: list[float]):
    body, q = HAMILTONIANS[kind](), np.array([*place, 0.6, 0.0, 0.0, 0.8])
    p, path = np.ones(q.size - 1), tmp_path / 'body.rrd'
    box = tuple(np.column_stack([part - 1.0, part + 1.0]) for part in (q, p))
    for mechanism in (None, MECHANISMS['turning_body']):
        sink = RerunSink('body', path, body, q, p, box=box, mechanism=mechanism)
        sink.write(sample_of(q, p, *body.gradient(q, p)))
        sink.close()
        assert path.stat().st_size > 1000
        if mechanism is not None:
            # What stands still has no time.
            parts = {part for part in read(path) if part.startswith('/world/')}
            assert parts == {f'/world/{name}' for name in (
                'body', 'x_axis', 'y_axis', 'z_axis', 'path')}
        path.unlink()


def test_odometry_has_poses_in_space_and_twists_in_the_frames_of_the_bodies():
    rng = np.random.default_rng(4)
    q, (p, dH_dp) = rng.normal(size=13), rng.normal(size=(2, 11))
    for start in (4, 9):
        q[start:start + 4] /= np.linalg.norm(q[start:start + 4])
    body, wheel = (deserialize_message(payload, Odometry) for payload in
                   OdometryEncoder(MIXED, 'map').encode(sample_of(q, p, q, dH_dp)))
    assert [body.child_frame_id, wheel.child_frame_id] == ['body', 'wheel']
    for message in (body, wheel):
        assert (message.header.frame_id, message.header.stamp.nanosec) == ('map', 5)
        assert not message.pose.covariance.any() and not message.twist.covariance.any()

    def numbers(part: object, *names: str) -> list[float]:
        return [getattr(part, name) for name in names]
    assert numbers(body.pose.pose.position, 'x', 'y', 'z') == q[1:4].tolist()
    assert numbers(body.pose.pose.orientation, 'x', 'y', 'z', 'w') == q[4:8].tolist()
    np.testing.assert_allclose(numbers(body.twist.twist.linear, 'x', 'y', 'z'),
                               Rotation.from_quat(q[4:8]).inv().apply(dH_dp[1:4]), rtol=1e-13)
    # H_p of a rotation is the angular velocity in the frame of the body already.
    assert numbers(body.twist.twist.angular, 'x', 'y', 'z') == dH_dp[4:7].tolist()
    assert numbers(wheel.pose.pose.position, 'x', 'y', 'z') == [0.0] * 3
    assert numbers(wheel.pose.pose.orientation, 'x', 'y', 'z', 'w') == q[9:].tolist()
    assert numbers(wheel.twist.twist.linear, 'x', 'y', 'z') == [0.0] * 3
    assert numbers(wheel.twist.twist.angular, 'x', 'y', 'z') == dH_dp[8:].tolist()


def test_wrench_is_the_command_of_a_body_or_refused():
    names = ['body_fz', 'body_rx', 'body_ry', 'body_rz']
    assert body_of(MIXED, names) == 'body' and body_of(MIXED, ['wheel_rx']) == 'wheel'
    # Along other axes, of two bodies, of none, or by a model.
    for other in (['body_x'], ['body_rx', 'wheel_rx'], ['slide'], ['wheel_fx'], []):
        assert body_of(MIXED, other) is None
    message = WrenchStamped()
    message.header.frame_id = 'body'
    message.wrench.force.z, message.wrench.torque.y = 2.0, -0.5
    assert command_of(message, 'body', names) == [2.0, 0.0, -0.5, 0.0]
    message.wrench.force.x = float('nan')
    with refused(ValueError):
        command_of(message, 'body', names)
    message.header.frame_id = 'map'
    with refused(ValueError):
        command_of(message, 'body', names)


def test_commands_of_a_quadrotor_are_recorded_and_it_flies_again_bit_by_bit(tmp_path):
    hover = [0.8 * 9.81, 0.0, 0.0, 0.0]
    assert_agrees(record_run(
        tmp_path / 'bag', load_scene('quadrotor'), 20, rate=100.0,
        commands={0: [hover], 40: [[9.0, 1e-3, -2e-3, 3e-3]]}), 20)
