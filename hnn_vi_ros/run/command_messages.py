# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of commands, and the conversion of their messages, from ROS or decoded from a bag."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects import (
    Command, EFFORT, JointCommand, JointPath, LINK_WRENCH, LinkWrench, NUMBERS, OBSERVATION,
    Observation, PATH, PAYLOAD, POSITION, VELOCITY)
from hnn_vi_ros.errors import counted
from hnn_vi_ros.hamiltonians import Payload, payload_of
from hnn_vi_ros.recording import ARRAY, INERTIA, JOINT_STATE, TRAJECTORY, WRENCH
import numpy as np

# Key of the remapping of topics in ~/scene and in a bag.
REMAPPED = 'remapped'


def nanoseconds(time: Any) -> int:
    """Convert a time or duration of ROS to nanoseconds; ValueError if negative or invalid."""
    if time.sec < 0 or time.nanosec >= 10**9:
        raise ValueError(f'a time of {time.sec} s and {time.nanosec} ns: expected at least 0 s '
                         'and less than 10^9 ns')
    return int(time.sec * 10**9 + time.nanosec)


class CommandTopic(NamedTuple):
    """
    A topic of commands of the simulator.

    Parameters
    ----------
    topic : str
        Name relative to the node.
    kind : str
        Type of the messages.
    holds : frozenset of str
        Kinds of commands that it can carry; a scene accepts some of them, see commands.contents.
    read : callable
        ``read(message, stamp)`` converts a message to a command, or raises ValueError; `stamp` is
        that of the state at its arrival [ns].

    """

    topic: str
    kind: str
    holds: frozenset[str]
    read: Callable[[Any, int], Command]


def read_numbers(message: Any, stamp: int) -> Command:
    """Return the numbers of a command: forces, or inputs of a motor model."""
    return list(message.data)


def read_joints(message: Any, stamp: int) -> JointCommand:
    """Return a joint command; each list has one number per name, or is empty."""
    return JointCommand(tuple(message.name), *_lists(message, (POSITION, VELOCITY, EFFORT)))


def read_observation(message: Any, stamp: int) -> Observation:
    """Return an observation of a machine; a header stamp of zero means now."""
    seen = nanoseconds(message.header.stamp)
    return Observation(tuple(message.name), (seen - stamp) / 1e9 if seen else 0.0,
                       *_lists(message, (POSITION, VELOCITY)))


def _lists(message: Any, fields: Sequence[str]) -> list[np.ndarray]:
    """Return lists of joint states, one number per name; an empty list becomes NaN."""
    count, lists = len(message.name), []
    for name in fields:
        values = np.array(getattr(message, name), dtype=np.float64)
        if values.size not in (0, count):
            raise ValueError(f'{name} has {counted(values.size, "number")} for '
                             f'{counted(count, "name")}: send one for '
                             'each, or none')
        lists.append(values if values.size else np.full(count, np.nan))
    return lists


def read_path(message: Any, stamp: int) -> JointPath:
    """Return the joint path; it begins at the header stamp, or now if that is zero."""
    begin = nanoseconds(message.header.stamp)
    points, columns = message.points, []
    for name in ('positions', 'velocities', 'accelerations', 'effort'):
        rows = [getattr(point, name) for point in points]
        lengths = {len(row) for row in rows}
        if len(lengths) > 1 or lengths - {0, len(message.joint_names)}:
            raise ValueError(f'{name} must have a number for each of joint_names in every point, '
                             'or none')
        columns.append(np.array(rows, dtype=np.float64) if lengths - {0} else None)
    positions, velocities, accelerations, effort = columns
    if effort is not None:
        raise ValueError('efforts in a trajectory are not supported: remove them')
    if positions is None:
        positions = np.empty((len(points), 0))
    times = [nanoseconds(point.time_from_start) for point in points]
    return JointPath(tuple(message.joint_names), (begin - stamp) / 1e9 if begin else 0.0,
                     np.array(times) / 1e9, positions, velocities, accelerations)


def read_wrench(message: Any, stamp: int) -> LinkWrench:
    """Return a wrench on a link; its stamp is not used."""
    return LinkWrench(message.header.frame_id, *([part.x, part.y, part.z] for part in (
        message.wrench.force, message.wrench.torque)))


MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


def read_payload(message: Any, stamp: int) -> Payload:
    """Return the payload on the link `frame_id`; its stamp is not used."""
    own = message.inertia
    return payload_of({'link': message.header.frame_id, 'mass': own.m,
                       'centre': [own.com.x, own.com.y, own.com.z],
                       'inertia': [getattr(own, name) for name in MOMENTS]})


COMMAND_TOPICS = (
    CommandTopic('~/commands', ARRAY, frozenset({NUMBERS}), read_numbers),
    CommandTopic('~/joint_commands', JOINT_STATE, frozenset({POSITION, VELOCITY, EFFORT}),
                 read_joints),
    CommandTopic('~/observations', JOINT_STATE, frozenset({OBSERVATION}), read_observation),
    CommandTopic('~/joint_trajectory', TRAJECTORY, frozenset({PATH}), read_path),
    CommandTopic('~/wrench', WRENCH, frozenset({LINK_WRENCH}), read_wrench),
    CommandTopic('~/payload', INERTIA, frozenset({PAYLOAD}), read_payload),
)
