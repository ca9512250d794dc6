# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Serialise messages, and decode those of a simulator, without ROS."""

from collections.abc import Sequence
import re
import struct
from types import SimpleNamespace
from typing import Any, final, NamedTuple

import numpy as np

# Prefixes of a coordinate's name: for its momentum, and for the rate of the momentum.
MOMENTUM, RATE = 'p_', 'dp_dt_'
_SCALARS = ('H', 'work')


class StateMessage(NamedTuple):
    """
    A sample as published on ~/state.

    Parameters
    ----------
    stamp : int
        Simulated time [ns].
    q, p, dp_dt : np.ndarray, shape (d,)
        Coordinates, momenta, and their rates; these have fewer columns if q contains quaternions.
    energy, work : float
        H(q, p), and the work of the effects on the system since the start [J].

    """

    stamp: int
    q: np.ndarray
    p: np.ndarray
    dp_dt: np.ndarray
    energy: float
    work: float


def state_names(names: Sequence[str], momenta: Sequence[str] | None = None) -> list[str]:
    """Return the names of ~/state: q, p, dp/dt of the coordinates, H and the work."""
    momenta = names if momenta is None else momenta
    return [*names, *(MOMENTUM + name for name in momenta), *(RATE + name for name in momenta),
            *_SCALARS]


def decode_state(data: bytes) -> StateMessage:
    """Return the sample in a serialised message of ~/state; raise ValueError if it is invalid."""
    joints = decode_joint_state(data)
    names, count = list(joints.names), len(joints.names) - len(_SCALARS)
    d = _momenta(names, count)
    if d is None or len(joints.position) != len(names):
        raise ValueError('its names are not those of ~/state')
    q, p, dp_dt = np.split(joints.position[:count], [count - 2 * d, count - d])
    return StateMessage(joints.stamp, q, p, dp_dt, *joints.position[count:].tolist())


def _momenta(names: list[str], count: int) -> int | None:
    """Return the number of momenta in ~/state with these names; None if they do not fit."""
    d = count // 3
    if names == state_names(names[:d]):
        return d
    # A quaternion has four columns and three momenta.
    rates = sum(name.startswith(RATE) for name in names)
    momenta = [name.removeprefix(RATE) for name in names[count - rates:count]]
    return rates if names == state_names(names[:count - 2 * rates], momenta) else None


# Byte order of the numbers, keyed by the second byte of the message.
_ORDERS = {0: '>', 1: '<'}
_PREFIX = 4


class JointStates(NamedTuple):
    """
    A sensor_msgs/msg/JointState.

    Parameters
    ----------
    stamp : int
        Stamp of the header [ns].
    names : tuple of str
        Names of the joints.
    position, velocity, effort : np.ndarray
        Values for each joint, or empty.

    """

    stamp: int
    names: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


@final
class _Cursor:
    """Position of the decoder; reading beyond the end raises ValueError."""

    def __init__(self, data: bytes):
        if len(data) < _PREFIX or data[0] != 0 or data[1] not in _ORDERS:
            raise ValueError('it is not plain CDR')
        self._data, self._order, self._place = data, _ORDERS[data[1]], _PREFIX

    def number(self, code: str) -> Any:
        """Return a number, of a code of ``struct``."""
        size = struct.calcsize(code)
        self._align(size)
        (value,) = struct.unpack(self._order + code, self._take(size))
        return value

    def count(self) -> int:
        """Return the length of a sequence with entries of at least four bytes each."""
        count: int = self.number('I')
        if 4 * count > len(self._data):
            raise ValueError(f'it declares {count} entries, more than it contains')
        return count

    def text(self) -> str:
        """Return a string."""
        return self._take(self.number('I'))[:-1].decode()

    def doubles(self) -> np.ndarray:
        """Return a sequence of doubles."""
        count: int = self.number('I')
        if count:
            self._align(8)
        return np.frombuffer(self._take(8 * count), self._order + 'f8').astype(np.float64)

    def _align(self, size: int) -> None:
        self._place += (_PREFIX - self._place) % size

    def _take(self, size: int) -> bytes:
        part = self._data[self._place:self._place + size]
        if len(part) != size:
            raise ValueError(f'it ends after {len(self._data)} bytes')
        self._place += size
        return part


# Fields of the types of messages that a simulator takes, and of its scene: names, each with a code
# of ``struct``, 'text', 'doubles', the fields of a message, or a list with the kind of an entry.
_STAMP = ('sec', 'i'), ('nanosec', 'I')
_HEADER = ('header', (('stamp', _STAMP), ('frame_id', 'text')))
_VECTOR = tuple((axis, 'd') for axis in 'xyz')
_POINT = (*((name, 'doubles') for name in ('positions', 'velocities', 'accelerations', 'effort')),
          ('time_from_start', _STAMP))
_DIMENSION = ('label', 'text'), ('size', 'I'), ('stride', 'I')
STRING, ARRAY, JOINT_STATE, TRAJECTORY, WRENCH, INERTIA = (
    'std_msgs/msg/String', 'std_msgs/msg/Float64MultiArray', 'sensor_msgs/msg/JointState',
    'trajectory_msgs/msg/JointTrajectory', 'geometry_msgs/msg/WrenchStamped',
    'geometry_msgs/msg/InertiaStamped')
_FIELDS: dict[str, Any] = {
    STRING: (('data', 'text'),),
    ARRAY: (('layout', (('dim', [_DIMENSION]), ('data_offset', 'I'))), ('data', 'doubles')),
    JOINT_STATE: (_HEADER, ('name', ['text']), ('position', 'doubles'), ('velocity', 'doubles'),
             ('effort', 'doubles')),
    TRAJECTORY: (_HEADER, ('joint_names', ['text']), ('points', [_POINT])),
    WRENCH: (_HEADER, ('wrench', (('force', _VECTOR), ('torque', _VECTOR)))),
    INERTIA: (_HEADER, ('inertia', (('m', 'd'), ('com', _VECTOR), *(
        (name, 'd') for name in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))))),
}


def decode(kind: str, data: bytes) -> Any:
    """
    Return a serialised message with the fields of ROS, in which sequences of numbers are arrays.

    Parameters
    ----------
    kind : str
        Name of the type, such as ``'sensor_msgs/msg/JointState'``; see _FIELDS.
    data : bytes
        The message.

    Raises
    ------
    ValueError
        The bytes are invalid.

    """
    return _decoded(_Cursor(data), _FIELDS[kind])


def _decoded(cursor: _Cursor, kind: Any) -> Any:
    if kind == 'text':
        return cursor.text()
    if kind == 'doubles':
        return cursor.doubles()
    if isinstance(kind, str):
        return cursor.number(kind)
    if isinstance(kind, list):
        return [_decoded(cursor, kind[0]) for _ in range(cursor.count())]
    return SimpleNamespace(**{name: _decoded(cursor, own) for name, own in kind})


def decode_joint_state(data: bytes) -> JointStates:
    """Return a sensor_msgs/msg/JointState; raise ValueError if the bytes are invalid."""
    found = decode(JOINT_STATE, data)
    stamp = found.header.stamp
    return JointStates(stamp.sec * 10**9 + stamp.nanosec, tuple(found.name), found.position,
                       found.velocity, found.effort)


def decode_joint_trajectory(
        data: bytes) -> tuple[tuple[str, ...], list[tuple[float, np.ndarray, np.ndarray]]]:
    """
    Return the joints of a trajectory_msgs/msg/JointTrajectory, and its points.

    A point is (time from start [s], positions, velocities). ValueError if the bytes are invalid.
    """
    found = decode(TRAJECTORY, data)
    return tuple(found.joint_names), [
        (point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec, point.positions,
         point.velocities) for point in found.points]


def decode_float64_multi_array(data: bytes) -> np.ndarray:
    """Return the data of a std_msgs/msg/Float64MultiArray; raise ValueError if invalid."""
    found = decode(ARRAY, data)
    numbers: np.ndarray = found.data[found.layout.data_offset:]
    return numbers


# Header of plain little-endian CDR; alignment is relative to its end.
_ENCAPSULATION = b'\0\1\0\0'
_CODES = {'boolean': '?', 'octet': 'c', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H',
          'int32': 'i', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float': 'f', 'double': 'd'}
_SEQUENCE = 'sequence<'
_FIXED = re.compile(rf'({"|".join(_CODES)})\[\d+\]')


def serialize(message: Any) -> bytes:
    """
    Return a message as CDR, equal to ``serialize_message`` with zeros for padding.

    The end is padded to a multiple of four bytes as well, as the middleware does.

    Raises
    ------
    TypeError
        A field has a type that this package's messages never use, such as a wide string.

    """
    data = _Writer(message).data
    return bytes(data) + bytes(-len(data) % 4)


@final
class Template:
    """
    Serialised message in which only numbers change; each message costs one copy.

    Parameters
    ----------
    message : message
        Message with the strings and lengths of all messages.

    Attributes
    ----------
    numbers : list of np.ndarray
        Views of its double fields and sequences, in the order of its fields; assign to them.

    """

    def __init__(self, message: Any):
        written = _Writer(message)
        self._data = written.data
        self.numbers = [np.frombuffer(self._data, '<f8', count, start)
                        for start, count in written.doubles]

    def set_stamp(self, stamp: int) -> None:
        """Set the stamp [ns] of a message that starts with a header."""
        struct.pack_into('<iI', self._data, len(_ENCAPSULATION), *divmod(stamp, 10**9))

    def serialized(self) -> bytes:
        """Return the message with the current numbers."""
        return bytes(self._data)


class _Writer:
    """Builder of a message's CDR, with the first byte and the count of its double fields."""

    def __init__(self, message: Any):
        self.data = bytearray(_ENCAPSULATION)
        self.doubles: list[tuple[int, int]] = []
        self._put_message(message)

    def _put_message(self, message: Any) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            self._put(kind, getattr(message, name))

    def _put(self, kind: str, value: Any) -> None:
        if kind.startswith(_SEQUENCE):
            self._put_sequence(kind.removeprefix(_SEQUENCE).removesuffix('>'), value)
        elif kind in _CODES:
            self._put_numbers(kind, [value])
        elif (array := _FIXED.fullmatch(kind)) is not None:
            self._put_numbers(array[1], value)
        elif kind == 'string':
            text = value.encode() + b'\0'
            self._put_numbers('uint32', [len(text)])
            self.data += text
        elif hasattr(value, 'get_fields_and_field_types'):
            self._put_message(value)
        else:
            raise TypeError(f'a field of the type {kind} cannot be serialised')

    def _put_sequence(self, kind: str, values: Sequence[Any]) -> None:
        self._put_numbers('uint32', [len(values)])
        if kind in _CODES:
            self._put_numbers(kind, values)
        else:
            for value in values:
                self._put(kind, value)

    def _put_numbers(self, kind: str, values: Sequence[Any]) -> None:
        # An empty sequence gets no alignment.
        if len(values):
            code = _CODES[kind]
            self.data += bytes((len(_ENCAPSULATION) - len(self.data)) % struct.calcsize(code))
            if kind == 'double':
                self.doubles.append((len(self.data), len(values)))
            self.data += struct.pack(f'<{len(values)}{code}', *values)
