# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of commands and wrenches, and the conversion of their messages, live or from a bag."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import InertiaStamped, WrenchStamped
from hnn_vi_ros.effects import (
    Command, EFFORT, JointCommand, JointPath, LINK_WRENCH, LinkWrench, NUMBERS, OBSERVATION,
    Observation, PATH, PAYLOAD, POSITION, printable, VELOCITY)
from hnn_vi_ros.errors import counted, listed
from hnn_vi_ros.hamiltonians import Payload, payload_of
from hnn_vi_ros.phase_space import Coordinate, leaders
from hnn_vi_ros.ros.plumbing.stamps import nanoseconds
import numpy as np
from rclpy.qos import qos_profile_sensor_data, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory


def places_of(coordinates: Sequence[Coordinate], given: Sequence[str], field: str) -> list[int]:
    """Return each coordinate's index in a message's names; followers may be among them."""
    names, following = [coordinate.name for coordinate in coordinates], leaders(coordinates)
    if sorted(name for name in given if name not in following) != sorted(names):
        raise ValueError(f'{field} = [{printable(given)}] must contain the coordinates '
                         f'{listed(names)}, each once')
    return [list(given).index(name) for name in names]


def body_of(coordinates: Sequence[Coordinate], names: Sequence[str]) -> str | None:
    """
    Return the body along whose axes all numbers of a command act, or None if there is none.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Coordinates of the system.
    names : sequence of str
        Meanings of the numbers of a command; see ExternalForce.

    """
    for coordinate in coordinates:
        kinds = {'scalar': '', 'rotation': 'r', 'pose': 'fr'}[coordinate.kind]
        own = {f'{coordinate.name}_{kind}{axis}' for kind in kinds for axis in 'xyz'}
        if names and set(names) <= own:
            return coordinate.name
    return None


def command_of(message: WrenchStamped, body: str, names: Sequence[str]) -> list[float]:
    """
    Convert a wrench to a command.

    Parameters
    ----------
    message : WrenchStamped
        Wrench in the frame of the body; its stamp is not used.
    body : str
        Name of the body, from `body_of`.
    names : sequence of str
        Meanings of the numbers of the command.

    Raises
    ------
    ValueError
        The wrench is in another frame, or has a non-zero component that no command number drives.

    """
    if message.header.frame_id != body:
        raise ValueError(f'frame_id = {message.header.frame_id[:80]!r}: expected {body!r}, since '
                         'commands act along the axes of the body')
    wrench = message.wrench
    components = {f'{body}_{kind}{axis}': getattr(vector, axis)
                  for kind, vector in (('f', wrench.force), ('r', wrench.torque))
                  for axis in 'xyz'}
    idle = [name for name, value in components.items() if name not in names and value != 0.0]
    if idle:
        raise ValueError(f'{idle[0]} = {components[idle[0]]}: nothing drives it; valid: '
                         f'{", ".join(names)}; send 0 for all others')
    return [components[name] for name in names]


class Input(NamedTuple):
    """
    A topic that the simulator subscribes to.

    Parameters
    ----------
    topic : str
        Name relative to the node.
    message_type : type
        Class of the messages.
    holds : frozenset of str
        Kinds of commands that it can carry; a scene accepts some of them, see commands.contents.
        Empty for topics without commands, whose subscription is created elsewhere.
    read : callable or None
        ``read(message, stamp)`` converts a message to a command, or raises ValueError; `stamp` is
        that of the state at its arrival [ns].
    qos : QoSProfile
        QoS profile of the subscription.

    """

    topic: str
    message_type: type
    holds: frozenset[str]
    read: Callable[[Any, int], Command] | None
    qos: QoSProfile


def read_numbers(message: Float64MultiArray, stamp: int) -> Command:
    """Return the numbers of a command: forces, or inputs of a motor model."""
    return list(message.data)


def read_joints(message: JointState, stamp: int) -> JointCommand:
    """Return a joint command; each list has one number per name, or is empty."""
    return JointCommand(tuple(message.name), *_lists(message, (POSITION, VELOCITY, EFFORT)))


def read_observation(message: JointState, stamp: int) -> Observation:
    """Return an observation of a machine; a header stamp of zero means now."""
    seen = nanoseconds(message.header.stamp)
    return Observation(tuple(message.name), (seen - stamp) / 1e9 if seen else 0.0,
                       *_lists(message, (POSITION, VELOCITY)))


def _lists(message: JointState, fields: Sequence[str]) -> list[np.ndarray]:
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


def read_path(message: JointTrajectory, stamp: int) -> JointPath:
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


def read_wrench(message: WrenchStamped, stamp: int) -> LinkWrench:
    """Return a wrench on a link; its stamp is not used."""
    return LinkWrench(message.header.frame_id, *([part.x, part.y, part.z] for part in (
        message.wrench.force, message.wrench.torque)))


_MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


def read_payload(message: InertiaStamped, stamp: int) -> Payload:
    """Return the payload on the link `frame_id`; its stamp is not used."""
    own = message.inertia
    return payload_of({'link': message.header.frame_id, 'mass': own.m,
                       'centre': [own.com.x, own.com.y, own.com.z],
                       'inertia': [getattr(own, name) for name in _MOMENTS]})


def write_payload(payload: Payload) -> InertiaStamped:
    """Return the message of a payload."""
    message = InertiaStamped()
    message.header.frame_id, message.inertia.m = payload.link, float(payload.mass)
    own = message.inertia.com
    own.x, own.y, own.z = map(float, payload.centre)
    for name, value in zip(_MOMENTS, payload.inertia, strict=True):
        setattr(message.inertia, name, float(value))
    return message


NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
OBSERVATIONS = Input('~/observations', JointState, frozenset({OBSERVATION}), read_observation,
                     qos_profile_sensor_data)
WRENCH = Input('~/wrench', WrenchStamped, frozenset({LINK_WRENCH}), read_wrench, NEWEST)
PAYLOADS = Input('~/payload', InertiaStamped, frozenset({PAYLOAD}), read_payload, NEWEST)
INITIAL_STATE = Input('~/initial_state', JointState, frozenset(), None, NEWEST)
# A best-effort subscription also receives from reliable publishers, such as ros2_control.
JOINT_COMMANDS = Input('~/joint_commands', JointState, frozenset({POSITION, VELOCITY, EFFORT}),
                       read_joints, qos_profile_sensor_data)
INPUTS = (
    Input('~/commands', Float64MultiArray, frozenset({NUMBERS}), read_numbers, NEWEST),
    JOINT_COMMANDS, OBSERVATIONS,
    Input('~/joint_trajectory', JointTrajectory, frozenset({PATH}), read_path, NEWEST),
    WRENCH, PAYLOADS, INITIAL_STATE,
)
