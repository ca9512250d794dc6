# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Turn samples into serialised ROS messages, and describe the topics that carry them."""

from array import array
from collections.abc import Sequence
import json
import re
from typing import Any, final

from hnn_vi_ros.bags.bag_metadata import Topic
from hnn_vi_ros.bags.state_message import state_names
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.package_uri import prefixes
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.phase_space import columns, Coordinate, momentum_rates, rotations
from hnn_vi_ros.run.serialization import Template
from hnn_vi_ros.simulation.sample import Sample
import numpy as np
from rclpy.duration import Duration, Infinite
from rclpy.qos import LivelinessPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout

# The topics of a tick, in the order in which `MessageEncoder.encode` returns their messages.
TICK_TOPICS: tuple[tuple[str, type], ...] = (
    ('~/state', JointState),
    ('~/q', Float64MultiArray),
    ('~/p', Float64MultiArray),
    ('~/energy', Float64),
    ('joint_states', JointState),
)

_SEPARATOR = '=' * 80
_FIELD = re.compile(r'\s*([A-Za-z][A-Za-z0-9_/]*)[^\s#]*\s+[A-Za-z]')
_PRIMITIVE_TYPES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))


@final
class MessageEncoder:
    """
    Serialise the messages of a tick, once for publishers and log alike.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        In the order of q. A quaternion takes four columns in q, and three in p. Joint states
        cover scalar coordinates alone: no joint turns by a quaternion.

    """

    def __init__(self, coordinates: Sequence[Coordinate]):
        (names, momenta), scalar = columns(coordinates), [
            c.name for c in coordinates if c.kind == 'scalar']
        self._turning, all_scalar = rotations(coordinates), len(scalar) == len(coordinates)
        # Whose columns of q, and of p, joint states have.
        self._of_q, self._of_p = (slice(None) if all_scalar else [
            own.index(name) for name in scalar] for own in (names, momenta))
        labels, zeros = state_names(names, momenta), array('d', [0.0] * len(scalar))
        self._state = Template(JointState(
            name=labels, position=array('d', [0.0] * len(labels))))
        self._q, self._p = Template(array_message(names)), Template(array_message(momenta))
        self._energy = Template(Float64())
        self._joints = Template(JointState(
            name=scalar, position=zeros, velocity=zeros, effort=zeros))
        state, = self._state.numbers
        # Where q, p and dp/dt go, each a slice; behind them are H and the work.
        self._parts = np.split(state, [len(names), len(labels) - 2 - len(momenta),
                                       len(labels) - 2])
        self._scalars = self._parts.pop()

    def encode(self, sample: Sample) -> tuple[bytes, ...]:
        """
        Return the serialised messages of a sample, in the order of `TICK_TOPICS`.

        The joint states' position is q, their velocity q', and their effort what motors make
        of commands, as on a robot.
        """
        q, p, dp_dt = self._parts
        q[:] = self._q.numbers[0][:] = sample.q
        p[:] = self._p.numbers[0][:] = sample.p
        dp_dt[:] = momentum_rates(
            self._turning, sample.q, sample.p, sample.dH_dq, sample.dH_dp)
        if self._joints.numbers:
            # There are none of a message without joints.
            position, velocity, effort = self._joints.numbers
            position[:], velocity[:] = sample.q[self._of_q], sample.dH_dp[self._of_p]
            effort[:] = 0.0 if sample.motors is None else sample.motors[self._of_p]
        self._scalars[0] = self._energy.numbers[0][0] = sample.energy
        self._scalars[1] = sample.work
        self._state.set_stamp(sample.stamp)
        self._joints.set_stamp(sample.stamp)
        return (self._state.serialized(), self._q.serialized(), self._p.serialized(),
                self._energy.serialized(), self._joints.serialized())


def array_message(names: Sequence[str]) -> Float64MultiArray:
    """Return an array of zeros whose one dimension is labelled with the names of its entries."""
    size = len(names)
    dimension = MultiArrayDimension(label=','.join(names), size=size, stride=size)
    return Float64MultiArray(
        layout=MultiArrayLayout(dim=[dimension]), data=array('d', [0.0] * size))


def describe_topic(name: str, message_type: type, qos: QoSProfile) -> Topic:
    """
    Describe a topic for the log.

    Parameters
    ----------
    name : str
        Fully resolved name.
    message_type : type
        Class of its messages.
    qos : QoSProfile
        Policies that the publisher offers, overrides included.

    Raises
    ------
    RecordingError
        The message's definition is not installed.

    """
    type_name = message_type_name(message_type)
    return Topic(name, type_name, message_definition(type_name), type_hash(type_name),
                 qos_yaml(qos))


def message_type_name(message_type: type) -> str:
    """Return the ROS name of a message class, ``'std_msgs/msg/Float64'``."""
    package, kind = message_type.__module__.split('.')[:2]
    return f'{package}/{kind}/{message_type.__name__}'


def message_definition(type_name: str) -> str:
    """
    Return the text of a type's .msg file, then the texts of the types it uses.

    Parameters
    ----------
    type_name : str
        ``'std_msgs/msg/Float64'``.

    Raises
    ------
    RecordingError
        A definition is not installed.

    """
    # Each type stands once, after the first that uses it, as rosbag2 has them.
    definitions: dict[str, str] = {}
    _collect_definitions(type_name, definitions)
    root, *others = definitions.items()
    return root[1] + ''.join(
        f'\n{_SEPARATOR}\nMSG: {name}\n{text}' for name, text in others)


def _collect_definitions(name: str, definitions: dict[str, str]) -> None:
    text = _read_interface(name, 'msg')
    definitions[name] = text
    package = name.split('/')[0]
    fields = filter(None, (_FIELD.match(line) for line in text.splitlines()))
    used = {field[1] for field in fields} - _PRIMITIVE_TYPES
    for type_name in sorted(used_name if '/' in used_name else f'{package}/{used_name}'
                            for used_name in used):
        if type_name not in definitions:
            _collect_definitions(type_name, definitions)


def type_hash(type_name: str) -> str:
    """
    Return the RIHS01 hash of a message type, as the type's package gives it.

    Raises
    ------
    RecordingError
        The type's description is not installed or does not hold its hash.

    """
    try:
        entries = json.loads(_read_interface(type_name, 'json'))['type_hashes']
        return next(entry['hash_string'] for entry in entries if entry['type_name'] == type_name)
    except (ValueError, LookupError, TypeError, StopIteration) as problem:
        raise RecordingError(f'{type_name}: its installed description holds no type hash; '
                             f'reinstall {type_name.split("/")[0]}') from problem


def _read_interface(name: str, suffix: str) -> str:
    """Read ``share/<package>/msg/<type>.<suffix>`` of ``'package/Type'`` or its long form."""
    package, type_name = name.split('/')[0], name.split('/')[-1]
    for prefix in prefixes():
        path = prefix / 'share' / package / 'msg' / f'{type_name}.{suffix}'
        if path.is_file():
            return path.read_text(encoding='utf-8')
    raise RecordingError(
        f'{package}/msg/{type_name}.{suffix} is not under share/ of '
        f'{", ".join(map(str, prefixes()))}; source ROS 2, or pip install '
        'ros-jazzy-common-interfaces')


def qos_yaml(qos: QoSProfile) -> str:
    """Return a profile as the one-element YAML list that rosbag2 keeps with a topic."""
    # As rosbag2 finds it on the wire: automatic is what the middleware makes of the default.
    unset = qos.liveliness == LivelinessPolicy.SYSTEM_DEFAULT
    liveliness = LivelinessPolicy.AUTOMATIC if unset else qos.liveliness
    profile: dict[str, Any] = {
        'history': qos.history.short_key,
        'depth': qos.depth,
        'reliability': qos.reliability.short_key,
        'durability': qos.durability.short_key,
        'deadline': _offered_duration(qos.deadline),
        'lifespan': _offered_duration(qos.lifespan),
        'liveliness': liveliness.short_key,
        'liveliness_lease_duration': _offered_duration(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions,
    }
    return dump_yaml([profile]).rstrip('\n')


def _offered_duration(duration: Duration) -> dict[str, int]:
    # Zero means "not specified"; publishers and rosbag2 treat it as infinite.
    seconds, nanoseconds = divmod(duration.nanoseconds or Infinite.nanoseconds, 10**9)
    return {'sec': seconds, 'nsec': nanoseconds}
