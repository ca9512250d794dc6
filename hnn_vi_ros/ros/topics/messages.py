# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Serialise samples as ROS messages, and describe the topics that carry them."""

from array import array
from collections.abc import Callable, Sequence
import json
import math
import re
from typing import Any

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, prefixes
from hnn_vi_ros.phase_space import columns, Coordinate, momentum_rates, rotations
from hnn_vi_ros.recording import Sample, state_names, Template, Topic
from hnn_vi_ros.run import joints_of, JointSensor, Monitor
from hnn_vi_ros.simulation import local_error, Simulation
import numpy as np
from rclpy.duration import Duration, Infinite
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Returns the serialised messages of a sample on one topic, usually one.
Encode = Callable[[Sample], Sequence[Any]]
_SEPARATOR = '=' * 80
_FIELD = re.compile(r'\s*([A-Za-z][A-Za-z0-9_/]*)[^\s#]*\s+[A-Za-z]')
_PRIMITIVE_TYPES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))


def encode_state(coordinates: Sequence[Coordinate]) -> Encode:
    """Return the encoder of ~/state: named values of q, p, dp/dt, H and the work."""
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
        Template; all messages share its strings and its lengths of lists.
    values : callable
        Returns the numbers and lists of numbers for a sample, in the order of the fields, or None
        to send no message.
    stamped : bool, optional
        True if the message begins with a header, whose stamp is set to that of the sample.

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
    """Return the encoder of an array whose dimension label lists the names of its entries."""
    return encode_numbers(array_message(names), lambda sample: [values(sample)])


def encode_joints(coordinates: Sequence[Coordinate]) -> Encode:
    """
    Return the encoder of joint_states, in the form that robots publish.

    Position is q, velocity is q', and effort is the output of the motors. Only scalar coordinates
    are included, because no joint rotates by a quaternion. Joints that follow others come last,
    without effort, because the motor is that of their leader.
    """
    names, values = joints_of(coordinates)
    return encode_numbers(_joint_message(names), values, stamped=True)


def encode_readings(coordinates: Sequence[Coordinate], sensor: JointSensor) -> Encode:
    """Return the encoder of joint_states as a sensor reads them; see encode_joints."""
    names, values = joints_of(coordinates)

    def read(sample: Sample) -> list[np.ndarray] | None:
        found = sensor.measure(sample.step, values(sample))
        return found and [part for part in found if part.size]
    return encode_numbers(_joint_message(names, sensor.has_velocities), read, stamped=True)


def _joint_message(names: list[str], velocities: bool = True) -> JointState:
    zeros = array('d', [0.0] * len(names))
    return JointState(
        name=names, position=zeros, velocity=zeros if velocities else [], effort=zeros)


def named_numbers(labels: Sequence[str]) -> JointState:
    """Return a JointState that holds named numbers and a stamp."""
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
        Policies that the publisher offers, including overrides.

    Raises
    ------
    RecordingError
        The definition of the message is not installed.

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
    Return the text of a type's .msg file, followed by the texts of the types it uses.

    Parameters
    ----------
    type_name : str
        ``'std_msgs/msg/Float64'``.

    Raises
    ------
    RecordingError
        A definition is not installed.

    """
    # As in rosbag2, each type is listed once, after the first type that uses it.
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
    Return the RIHS01 hash of a message type, read from the type's package.

    Raises
    ------
    RecordingError
        The description of the type is not installed or does not contain its hash.

    """
    try:
        entries = json.loads(_read_interface(type_name, 'json'))['type_hashes']
        return next(entry['hash_string'] for entry in entries if entry['type_name'] == type_name)
    except (ValueError, LookupError, TypeError, StopIteration) as problem:
        raise RecordingError(f'{type_name}: its installed description has no type hash; '
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
    """Return a profile as the one-element YAML list that rosbag2 stores with a topic."""
    # As rosbag2 discovers it: the middleware resolves the default liveliness to automatic.
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


# Names of the entries of an accuracy message.
ENTRIES = (
    'H', 'modified_H', 'energy_error', 'work', 'energy_balance', 'residual', 'iterations',
    'modified_energy_band', 'drift_per_hour', 'microseconds_per_step_median',
    'microseconds_per_step_p99', 'gradients_per_step', 'largest_real_time_factor', 'energy_scale',
    'local_error')
# Samples between estimates of the local error; each estimate takes three additional steps.
_ESTIMATE_PERIOD = 64


def encode_loop_forces(simulation: Simulation) -> Encode:
    """Return the encoder of ~/loop_forces, whose sample must be the newest one."""
    loops = simulation.system.constraints
    assert isinstance(loops, LoopManifold), 'checked when the run is prepared'
    return encode_numbers(named_numbers(loops.force_names), lambda sample: [
        simulation.loop_forces.ravel()], stamped=True)


def encode_causes(simulation: Simulation) -> Encode:
    """Return the encoder of ~/energy_by_cause."""
    assert simulation.ledger is not None, 'the row asks for it'
    return encode_numbers(named_numbers(simulation.ledger.names), lambda sample: (
        None if sample.causes is None else [sample.causes]), stamped=True)


class AccuracyEncoder:
    """
    Encoder of the accuracy of samples, in the order of ENTRIES.

    ``energy_balance`` is H - H0 - W [J]; ``residual`` is the relative one of the last implicit
    step; ``iterations`` is the mean number of gradients per step since the previous sample. The
    entries after these are updated periodically; see EnergyRecord and Figures. ``energy_scale`` is
    the energy scale of the motion [J], relative to which an error is judged; see EnergyScale.
    ``local_error`` is the estimated error of one step, at the first and then at every 64th sample;
    see local_error. The invariants of the scene follow, each under its name.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    monitor : Monitor
        Monitor of its energy and timing.

    """

    def __init__(self, simulation: Simulation, monitor: Monitor):
        self._simulation, self._monitor = simulation, monitor
        self._energy0 = simulation.energy
        self._last = (simulation.steps, simulation.gradients)
        self._samples, self._local_error = 0, math.nan
        self._invariants = simulation.hamiltonian.invariants
        self._message = Template(array_message((*ENTRIES, *self._invariants)))

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the serialised message of a sample, which must be the newest one."""
        steps, gradients = self._simulation.steps, self._simulation.gradients
        if self._samples % _ESTIMATE_PERIOD == 0:
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
    Return the encoder of ~/joint_trajectory_state, which is sent while the servo follows a path.

    Its three points are the reference, the actual state, and their difference.

    Parameters
    ----------
    simulation : Simulation
        Simulation with a servo, whose joints never change.

    """
    motors = simulation.motors
    assert motors.servo_target is not None, 'of a servo'
    names = list(motors.servo_target.names)
    zeros = array('d', [0.0] * len(names))

    def values(sample: Sample) -> tuple[np.ndarray, ...] | None:
        target = motors.servo_target
        if target is None or not target.on_path:
            return None
        position, velocity = sample.q[target.columns], sample.dH_dp[target.columns]
        effort = np.zeros(len(target.names)) if sample.motors is None else \
            sample.motors[target.columns]
        return (*target.targets, position, velocity, effort, target.targets[0] - position,
                target.targets[1] - velocity)

    return encode_numbers(JointTrajectory(joint_names=names, points=[
        JointTrajectoryPoint(positions=zeros, velocities=zeros, accelerations=zeros),
        JointTrajectoryPoint(positions=zeros, velocities=zeros, effort=zeros),
        JointTrajectoryPoint(positions=zeros, velocities=zeros)]), values, stamped=True)


CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# Period of /clock: 100 Hz of simulated time, as each message costs every use_sim_time node [ns].
CLOCK_PERIOD = 10_000_000


class ClockEncoder:
    """Encoder of /clock: no stamp is repeated, and at most 100 are sent per simulated second."""

    def __init__(self) -> None:
        self._last = 0

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the clock message of a sample if it is due; an earlier stamp restarts it."""
        if 0 <= sample.stamp - self._last < CLOCK_PERIOD:
            return []
        self._last = sample.stamp
        return [clock_message(sample.stamp)]


def clock_message(stamp: int) -> bytes:
    """Convert a stamp [ns] to a serialised `rosgraph_msgs/Clock`."""
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
    return serialize_message(message)
