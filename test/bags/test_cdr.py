# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding messages without ROS, against what ROS serialises."""

import struct

from hnn_vi_ros.bags.cdr import decode_float64_multi_array, decode_joint_state
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

NUMBERS = st.lists(st.floats(), max_size=5)


@given(names=st.lists(st.text('abcé1_', max_size=9), max_size=4), frame=st.text('ab', max_size=5),
       seconds=st.integers(-2**31, 2**31 - 1), values=st.tuples(NUMBERS, NUMBERS, NUMBERS))
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


@given(labels=st.lists(st.text('abc', max_size=9), max_size=3), values=NUMBERS)
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
