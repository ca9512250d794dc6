# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Subscribed topics of commands and wrenches, and wrenches on the body of a command."""

from collections.abc import Sequence
from typing import NamedTuple

from geometry_msgs.msg import InertiaStamped, WrenchStamped
from hnn_vi_ros.effects import printable
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import Payload
from hnn_vi_ros.phase_space import Coordinate, leaders
from hnn_vi_ros.recording import ARRAY, INERTIA, JOINT_STATE, TRAJECTORY, WRENCH
from hnn_vi_ros.run import COMMAND_TOPICS, CommandTopic, MOMENTS
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
    qos : QoSProfile
        QoS profile of the subscription.
    content : CommandTopic, optional
        What its messages hold; nothing for topics without commands, whose subscription is created
        elsewhere.

    """

    topic: str
    message_type: type
    qos: QoSProfile
    content: CommandTopic | None = None

    @property
    def holds(self) -> frozenset[str]:
        """Return the kinds of commands that it can carry; see CommandTopic."""
        return frozenset() if self.content is None else self.content.holds


def write_payload(payload: Payload) -> InertiaStamped:
    """Return the message of a payload."""
    message = InertiaStamped()
    message.header.frame_id, message.inertia.m = payload.link, float(payload.mass)
    own = message.inertia.com
    own.x, own.y, own.z = map(float, payload.centre)
    for name, value in zip(MOMENTS, payload.inertia, strict=True):
        setattr(message.inertia, name, float(value))
    return message


NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
_CLASSES = {ARRAY: Float64MultiArray, JOINT_STATE: JointState, TRAJECTORY: JointTrajectory,
            WRENCH: WrenchStamped, INERTIA: InertiaStamped}
# A best-effort subscription also receives from reliable publishers, such as ros2_control.
_SENSOR_TOPICS = ('~/joint_commands', '~/observations')
INPUTS = (*(Input(one.topic, _CLASSES[one.kind], qos_profile_sensor_data if one.topic in
                  _SENSOR_TOPICS else NEWEST, one) for one in COMMAND_TOPICS),
          Input('~/initial_state', JointState, NEWEST))
(COMMANDS, JOINT_COMMANDS, OBSERVATIONS, _TRAJECTORIES, WRENCHES, PAYLOADS,
 INITIAL_STATE) = INPUTS
