# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages as CDR: what a subscriber decodes, and zeros where the format only pads."""

from itertools import zip_longest

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros.bags.cdr import decode_state, serialize, Template
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.ros.topics.messages import array_message
from hnn_vi_ros.ros.topics.outputs import encode_sample, SAMPLED
from hnn_vi_ros.simulation import Sample
from hypothesis import given, strategies as st
from messages import refused
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import Float64, Float64MultiArray, String

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


def test_two_encoders_give_the_same_bytes_and_these_decode_to_the_sample():
    # Names of all lengths modulo eight, each of which is padded in another way.
    for length in range(1, 17):
        names = ['x' * length, 'y' * (length + 1)]
        sample = Sample(1, 5, *np.arange(8.0).reshape(4, 2), 9.0, 0.0, 0.0, 10.0)
        first = encode_sample([*map(Coordinate, names)])(sample)
        assert first == encode_sample([*map(Coordinate, names)])(sample)
        assert len(first) == len(SAMPLED)
        state = decode_state(first[0])
        assert (state.stamp, state.energy, state.work) == (5, 9.0, 10.0)
        assert (state.q == sample.q).all() and (state.p == sample.p).all()
        assert (state.dp_dt == -sample.dH_dq).all()


@pytest.mark.parametrize('message', [
    JointState(), JointState(name=['x', 'p_x', 'dp_dt_x', 'H', 'work']),
    JointState(name=['a', 'b', 'c', 'd', 'e'], position=[0.0] * 5)])
def test_joint_states_that_are_no_state_are_refused(message):
    with refused(ValueError):
        decode_state(serialize(message))
