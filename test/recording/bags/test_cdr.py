# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages as CDR: decoded and written without ROS, as ROS does, with zeros where it only pads."""

from itertools import zip_longest
import struct

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import InertiaStamped, Vector3, WrenchStamped
from hnn_vi_ros.recording import (
    decode, decode_float64_multi_array, decode_joint_state, decode_state, serialize, Template)
from hnn_vi_ros.ros.topics.inputs import INPUTS
from hnn_vi_ros.ros.topics.messages import array_message
from hypothesis import given, settings, strategies as st
from messages import refused
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import (
    Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String)
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

TEXTS = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)
NUMBERS = st.lists(st.floats(allow_nan=False), max_size=5)


def diagnostics(texts: list[str]) -> DiagnosticArray:
    message = DiagnosticArray()
    message.header.frame_id = texts[0] if texts else ''
    message.status = [DiagnosticStatus(
        level=bytes([i % 4]), name=text, values=[KeyValue(key=text, value='v')] * i)
        for i, text in enumerate(texts)]
    return message


def odometry(text: str, number: float) -> Odometry:
    message = Odometry(child_frame_id=text)
    message.pose.pose.position.y = message.twist.covariance[35] = number
    return message


MESSAGES = st.one_of(
    st.builds(lambda text: String(data=text), TEXTS),
    st.builds(lambda number: Float64(data=number), st.floats(allow_nan=False)),
    st.builds(array_message, st.lists(TEXTS, max_size=4)),
    st.builds(lambda data: Float64MultiArray(data=data), NUMBERS),
    st.builds(lambda names, position, velocity: JointState(
        name=names, position=position, velocity=velocity), st.lists(TEXTS), NUMBERS, NUMBERS),
    st.builds(odometry, TEXTS, st.floats(allow_nan=False)),
    st.builds(diagnostics, st.lists(TEXTS, max_size=4)))


@given(MESSAGES)
def test_serialized_message_is_that_of_ros_with_zeros_for_padding(message):
    ours, theirs = serialize(message), serialize_message(message)
    assert all(a in (b, 0) for a, b in zip_longest(ours, theirs, fillvalue=0) if a)
    # ROS reserves room for the padding of sequences without entries, and sends it unused.
    assert -4 < len(theirs) - len(ours) <= 3 * 4 and len(ours) % 4 == 0
    # None of those zeros is part of a field.
    assert deserialize_message(ours, type(message)) == message
    assert ours == serialize(message)


def test_message_of_an_unknown_kind_of_field_is_an_error():
    with refused(TypeError):
        serialize(SolidPrimitive(dimensions=[1.0]))


@given(st.lists(TEXTS, min_size=1, max_size=4, unique=True))
def test_template_with_its_numbers_filled_is_the_message_of_those_numbers(names):
    numbers = np.arange(1.0, len(names) + 1.0)
    message = JointState(name=names, position=numbers, velocity=-numbers)
    template = Template(JointState(name=names, position=0 * numbers, velocity=0 * numbers))
    position, velocity = template.numbers
    position[:], velocity[:] = numbers, -numbers
    message.header.stamp.sec, message.header.stamp.nanosec = 1, 2
    template.set_stamp(1_000_000_002)
    assert template.serialized() == serialize(message)


@pytest.mark.parametrize('message', [
    JointState(), JointState(name=['x', 'p_x', 'dp_dt_x', 'H', 'work']),
    JointState(name=['a', 'b', 'c', 'd', 'e'], position=[0.0] * 5)])
def test_joint_states_that_are_no_state_are_refused(message):
    with refused(ValueError):
        decode_state(serialize(message))


@given(names=st.lists(TEXTS, max_size=4), frame=TEXTS, seconds=st.integers(-2**31, 2**31 - 1),
       values=st.tuples(*[st.lists(st.floats(), max_size=5)] * 3))
@settings(max_examples=100)
def test_joint_state_is_decoded_as_ros_serialises_it(names, frame, seconds, values):
    message = JointState(name=names, position=values[0], velocity=values[1], effort=values[2])
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, 999_999_999
    state = decode_joint_state(serialize_message(message))
    assert state.names == tuple(names)
    assert state.stamp == seconds * 10**9 + 999_999_999
    for found, expected in zip(state[2:], values, strict=True):
        assert np.array_equal(found, expected, equal_nan=True)


def filled(text: str, numbers: list[float]) -> dict[str, object]:
    """Return a message of each type of commands, by type."""
    x, y, z = (*numbers, 0.5, 1.5, 2.5)[:3]
    point = JointTrajectoryPoint(positions=numbers, velocities=numbers[:1])
    point.time_from_start.sec, point.time_from_start.nanosec = -3, 7
    inertia = InertiaStamped()
    inertia.inertia.m, inertia.inertia.com, inertia.inertia.iyz = x, Vector3(x=x, y=y, z=z), z
    wrench = WrenchStamped()
    wrench.wrench.torque, wrench.header.frame_id = Vector3(x=x, y=y, z=z), text
    wrench.header.stamp.nanosec = 5
    return {
        'std_msgs/msg/String': String(data=text),
        'std_msgs/msg/Float64MultiArray': Float64MultiArray(data=numbers, layout=MultiArrayLayout(
            dim=[MultiArrayDimension(label=text, size=3, stride=4)], data_offset=1)),
        'sensor_msgs/msg/JointState': JointState(name=[text, ''], velocity=numbers),
        'trajectory_msgs/msg/JointTrajectory': JointTrajectory(
            joint_names=[text], points=[point, JointTrajectoryPoint()]),
        'geometry_msgs/msg/WrenchStamped': wrench, 'geometry_msgs/msg/InertiaStamped': inertia}


def equal(found: object, message: object) -> bool:
    """Return whether a decoded message equals that of ROS, field by field."""
    if hasattr(message, 'get_fields_and_field_types'):
        fields = message.get_fields_and_field_types()
        return {*fields} == {*vars(found)} and all(
            equal(getattr(found, name), getattr(message, name)) for name in fields)
    if isinstance(found, list):
        return len(found) == len(message) and all(map(equal, found, message))
    return np.array_equal(found, message)


@given(text=TEXTS, numbers=NUMBERS)
@settings(max_examples=30)
def test_each_command_is_decoded_as_ros_serialises_it(text, numbers):
    messages = filled(text, numbers)
    assert {one.content.kind for one in INPUTS if one.content is not None} < {*messages}
    for kind, message in messages.items():
        assert equal(decode(kind, serialize_message(message)), message), kind


@pytest.mark.parametrize('kind', filled('', []))
def test_damaged_command_raises_value_error(kind):
    whole = serialize(filled('abc', [1.0, 2.0])[kind])
    for size in range(len(whole)):
        with pytest.raises(ValueError):
            decode(kind, whole[:size])


@given(labels=st.lists(TEXTS, max_size=3), values=st.lists(st.floats(), max_size=5))
@settings(max_examples=100)
def test_array_is_decoded_as_ros_serialises_it(labels, values):
    message = Float64MultiArray(data=values, layout=MultiArrayLayout(
        dim=[MultiArrayDimension(label=label, size=3, stride=3) for label in labels]))
    assert np.array_equal(decode_float64_multi_array(serialize_message(message)), values,
                          equal_nan=True)


def test_array_of_the_other_byte_order_begins_at_its_offset():
    data = b'\0\0\0\0' + struct.pack('>IIII', 0, 1, 2, 0)[:12] + struct.pack('>dd', 1.0, 2.5)
    # The count of 2 ends 12 bytes after the prefix: four of padding before the numbers.
    data = data[:16] + bytes(4) + data[16:]
    assert decode_float64_multi_array(data).tolist() == [2.5]


@pytest.mark.parametrize('decode, message', [
    (decode_joint_state, JointState(name=['a', 'b'], position=[1.0, 2.0])),
    (decode_float64_multi_array, Float64MultiArray(data=[1.0, 2.0]))])
def test_damaged_message_raises_value_error(decode, message):
    whole = serialize_message(message)
    # ROS may add some bytes that belong to nothing.
    for size in range(len(whole) - 8):
        with pytest.raises((ValueError, UnicodeDecodeError)):
            decode(whole[:size])
    for damaged in (b'\0\x07' + whole[2:], b'', whole[:8] + b'\xff' * (len(whole) - 8)):
        with pytest.raises((ValueError, UnicodeDecodeError)):
            decode(damaged)
