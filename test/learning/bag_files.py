# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as others record them: joint states, arrays, and their files."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from mcap.writer import Writer
import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

ARRAY, JOINTS = 'std_msgs/msg/Float64MultiArray', 'sensor_msgs/msg/JointState'
Message = tuple[str, str, float, bytes]


def state(time: float, names: Sequence[str], q: Sequence[float], v: Sequence[float] = (),
          tau: Sequence[float] = (), topic: str = '/joint_states') -> Message:
    """Return joint states of a time [s] in their header."""
    message = JointState(name=[*names], position=[*q], velocity=[*v], effort=[*tau])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time * 1e9), 10**9)
    return topic, JOINTS, time, serialize_message(message)


def array(t: np.ndarray, values: np.ndarray, topic: str) -> list[Message]:
    """Return rows of numbers, which have no header."""
    return [(topic, ARRAY, time, serialize_message(Float64MultiArray(data=np.atleast_1d(row))))
            for time, row in zip(t, values, strict=True)]


def write(path: Path, messages: Iterable[Message]) -> Path:
    """Write (topic, type, log time [s], bytes) as others' recorders do."""
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=8192)
        writer.start('ros2')
        channels: dict[tuple[str, str], int] = {}
        for topic, kind, time, data in messages:
            if (topic, kind) not in channels:
                channels[topic, kind] = writer.register_channel(
                    topic, 'cdr', writer.register_schema(kind, 'ros2msg', b''))
            writer.add_message(channels[topic, kind], round(time * 1e9), data, 0)
        writer.finish()
    return path
