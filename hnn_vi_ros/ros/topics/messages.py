# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Turn samples into serialised ROS messages, and describe the topics that carry them."""

from array import array
from collections.abc import Callable, Sequence
import json
import math
import re
from typing import Any

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, prefixes
from hnn_vi_ros.phase_space import columns, Coordinate, momentum_rates, rotations
from hnn_vi_ros.recording import Sample, state_names, Template, Topic
from hnn_vi_ros.run import Monitor
from hnn_vi_ros.simulation import local_error, Simulation
import numpy as np
from rclpy.duration import Duration, Infinite
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Makes the messages of a sample on one topic, serialised: usually one.
Encode = Callable[[Sample], Sequence[Any]]
_SEPARATOR = '=' * 80
_FIELD = re.compile(r'\s*([A-Za-z][A-Za-z0-9_/]*)[^\s#]*\s+[A-Za-z]')
_PRIMITIVE_TYPES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))


def encode_state(coordinates: Sequence[Coordinate]) -> Encode:
    """Return the encoder of ~/state: q, p, dp/dt, H and the work, by their names."""
    names, momenta = columns(coordinates)
    labels, turning = state_names(names, momenta), rotations(coordinates)
    template = Template(named_numbers(labels))
    q, p, dp_dt, scalars = np.split(
        template.numbers[0], [len(names), len(labels) - 2 - len(momenta), len(labels) - 2])

    def encode(sample: Sample) -> list[bytes]:
        q[:], p[:] = sample.q, sample.p
        dp_dt[:] = momentum_rates(turning, sample.q, sample.p, sample.dH_dq, sample.dH_dp)
        scalars[0], scalars[1] = sample.energy, sample.work
        template.set_stamp(sample.stamp)
        return [template.serialized()]
    return encode


def encode_numbers(message: Any, values: Callable[[Sample], Sequence[Any] | None],
                   stamped: bool = False) -> Encode:
    """
    Return the encoder of a message in which only numbers change.

    Parameters
    ----------
    message : message
        All messages share its strings and lengths.
    values : callable
        Returns what its numbers and lists of numbers are for a sample, in the order of its fields;
        None for no message.
    stamped : bool, optional
        Whether it begins with a header, which takes the stamp of the sample.

    """
    template = Template(message)

    def encode(sample: Sample) -> list[bytes]:
        found = values(sample)
        if found is None:
            return []
        # A message whose lists are all empty has no numbers.
        for numbers, own in zip(template.numbers, found, strict=bool(template.numbers)):
            numbers[:] = own
        if stamped:
            template.set_stamp(sample.stamp)
        return [template.serialized()]
    return encode


def encode_array(names: Sequence[str], values: Callable[[Sample], np.ndarray]) -> Encode:
    """Return the encoder of an array, whose label names its entries."""
    return encode_numbers(array_message(names), lambda sample: [values(sample)])


def encode_joints(coordinates: Sequence[Coordinate]) -> Encode:
    """
    Return the encoder of joint_states, as a robot publishes them.

    Position is q, velocity is q', and effort is what motors make of commands. Only scalar
    coordinates are among them: no joint turns by a quaternion.
    """
    scalar = [c.name for c in coordinates if c.kind == 'scalar']
    # A slice is faster than a list of columns.
    of_q, of_p = (slice(None) if len(scalar) == len(coordinates) else [
        own.index(name) for name in scalar] for own in columns(coordinates))
    zeros = array('d', [0.0] * len(scalar))
    return encode_numbers(
        JointState(name=scalar, position=zeros, velocity=zeros, effort=zeros),
        lambda sample: (sample.q[of_q], sample.dH_dp[of_p], 0.0 if sample.motors is None
                        else sample.motors[of_p]), stamped=True)


def named_numbers(labels: Sequence[str]) -> JointState:
    """Return a list of numbers with names and a stamp, as joint states."""
    return JointState(name=list(labels), position=array('d', [0.0] * len(labels)))


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
    return root[1] + ''.join(f'\n{_SEPARATOR}\nMSG: {name}\n{text}' for name, text in others)


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


# The entries of its message.
ENTRIES = (
    'H', 'modified_H', 'energy_error', 'work', 'energy_balance', 'residual', 'iterations',
    'modified_energy_band', 'drift_per_hour', 'microseconds_per_step_median',
    'microseconds_per_step_p99', 'gradients_per_step', 'largest_real_time_factor', 'energy_scale',
    'local_error')
# Samples from one estimate of the local error to the next: an estimate takes three steps more.
_ESTIMATED = 64


class AccuracyEncoder:
    """
    Serialise the accuracy of a sample, in the order of ENTRIES.

    ``energy_balance`` is H - H0 - W [J]; ``residual`` is the relative one of the last implicit
    step; ``iterations`` are the gradients that each step since the sample before took, on average.
    What follows them is evaluated now and then; see EnergyRecord and Figures. ``energy_scale`` is
    the size of the energies in play [J], by which an error is judged; see EnergyScale.
    ``local_error`` is the estimated error that a step adds, at the first and then at every 64th
    sample; see local_error. The invariants of the scene follow, each under its name.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    monitor : Monitor
        Its measurements.

    """

    def __init__(self, simulation: Simulation, monitor: Monitor):
        self._simulation, self._monitor = simulation, monitor
        self._energy0 = simulation.energy
        self._last = (simulation.steps, simulation.gradients)
        self._samples, self._local_error = 0, math.nan
        self._invariants = simulation.hamiltonian.invariants
        self._message = Template(array_message((*ENTRIES, *self._invariants)))

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the serialised message that belongs to a sample, the newest one."""
        steps, gradients = self._simulation.steps, self._simulation.gradients
        if self._samples % _ESTIMATED == 0:
            self._local_error = local_error(self._simulation)
        self._samples += 1
        taken, spent = steps - self._last[0], gradients - self._last[1]
        self._last = (steps, gradients)
        record, figures = self._monitor.energy, self._monitor.timing.figures
        self._message.numbers[0][:] = (
            sample.energy, sample.modified_energy, sample.energy_error, sample.work,
            sample.energy - self._energy0 - sample.work, self._simulation.residual,
            spent / taken if taken else 0.0, record.band, record.drift_per_hour,
            figures.microseconds_per_step_median, figures.microseconds_per_step_p99,
            figures.gradients_per_step, figures.largest_real_time_factor,
            self._monitor.energy_scale, self._local_error,
            *(function(sample.q, sample.p) for function in self._invariants.values()))
        return [self._message.serialized()]


def encode_feedback(simulation: Simulation) -> Encode:
    """
    Return the encoder of ~/joint_trajectory_state, while the servo follows a path.

    Its three points are the reference, what is, and their difference.

    Parameters
    ----------
    simulation : Simulation
        With a servo, whose joints are always the same.

    """
    motors = simulation.motors
    assert motors.aim is not None, 'of a servo'
    names = list(motors.aim.names)
    zeros = array('d', [0.0] * len(names))

    def values(sample: Sample) -> tuple[np.ndarray, ...] | None:
        aim = motors.aim
        if aim is None or not aim.on_path:
            return None
        position, velocity = sample.q[aim.columns], sample.dH_dp[aim.columns]
        effort = np.zeros(len(aim.names)) if sample.motors is None else sample.motors[aim.columns]
        return (*aim.targets, position, velocity, effort, aim.targets[0] - position,
                aim.targets[1] - velocity)

    return encode_numbers(JointTrajectory(joint_names=names, points=[
        JointTrajectoryPoint(positions=zeros, velocities=zeros, accelerations=zeros),
        JointTrajectoryPoint(positions=zeros, velocities=zeros, effort=zeros),
        JointTrajectoryPoint(positions=zeros, velocities=zeros)]), values, stamped=True)


CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# Each message costs every node with use_sim_time; 100 Hz of simulated time [ns].
CLOCK_PERIOD = 10_000_000


class ClockEncoder:
    """Encode the stamps [ns] of samples, none twice and at most a hundred per simulated second."""

    def __init__(self) -> None:
        self._last = 0

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the message of a sample, if it is due; one before the last starts over."""
        if 0 <= sample.stamp - self._last < CLOCK_PERIOD:
            return []
        self._last = sample.stamp
        return [clock_message(sample.stamp)]


def clock_message(stamp: int) -> bytes:
    """Return the message of a stamp [ns]."""
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
    return serialize_message(message)
