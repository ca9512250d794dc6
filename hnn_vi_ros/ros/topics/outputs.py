# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics that the simulator publishes; to add a topic, add a row to OUTPUTS."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.hamiltonians import MECHANISMS
from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.recording import ends_of, reach_of
from hnn_vi_ros.ros.plumbing.managed_node import CLOCK_TOPIC
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.companions import SpreadTopic
from hnn_vi_ros.ros.topics.inputs import NEWEST, OBSERVATIONS
from hnn_vi_ros.ros.topics.messages import (
    AccuracyEncoder, CLOCK_QOS, ClockEncoder, Encode, encode_array, encode_causes, encode_feedback,
    encode_joints, encode_loop_forces, encode_numbers, encode_readings, encode_state)
from hnn_vi_ros.ros.topics.poses import MarkerEncoder, OdometryEncoder
from hnn_vi_ros.run import JointSensor, Monitor
from hnn_vi_ros.simulation import Simulation
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

TICKS = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# The next alarm or answer must not replace one that has not yet arrived.
_ALARMS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Events are rare and all matter: late subscribers receive the earlier ones too.
_EVENTS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ConfiguredRun(NamedTuple):
    """
    A configured run, from which messages are made.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    monitor : Monitor
        Monitor of the run.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that fit into drawings.
    mechanism : str or None
        Name of the mechanism drawn as markers, if any.
    frame_id : str
        Frame of the markers and of odometry.
    events : bool
        True if the scene has events.
    spread : SpreadTopic or None
        Spread of an ensemble whose uncertainty the scene publishes, if any.
    sensor : JointSensor or None
        Sensor whose readings joint_states holds, if any.

    """

    simulation: Simulation
    monitor: Monitor
    box: tuple[np.ndarray, np.ndarray]
    mechanism: str | None = None
    frame_id: str = 'world'
    events: bool = False
    spread: SpreadTopic | None = None
    sensor: JointSensor | None = None


class Output(NamedTuple):
    """
    A topic that the simulator publishes.

    Parameters
    ----------
    topic : str
        Name relative to the node.
    message_type : type
        Class of the messages.
    qos : QoSProfile
        QoS profile that the publisher offers.
    when : callable
        ``when(settings, material)`` returns a true value if the topic exists. It is called at the
        start of the configuration with None for the material, so that other nodes discover the
        topic while the scene is compiled, and again with the material.
    make : callable, optional
        ``make(material, publisher)`` returns the encoder of the samples, or None. Without one,
        messages are sent with ``Topics.send``.
    encoder : callable, optional
        ``encoder(coordinates)`` returns the encoder, unless `make` does, from the coordinates
        alone.
    recorded : str
        ``'tick'``: a message in each sample of a bag, in the order of the rows; ``'apart'``: a
        message with its own stamp; empty: not recorded.

    """

    topic: str
    message_type: type
    qos: QoSProfile
    when: Callable[[Settings, ConfiguredRun | None], object] = lambda settings, run: True
    make: Callable[[ConfiguredRun, Publisher], Encode | None] | None = None
    recorded: Literal['', 'tick', 'apart'] = ''
    encoder: Callable[[Sequence[Coordinate]], Encode] | None = None

    def encode(self, run: ConfiguredRun, publisher: Publisher) -> Encode | None:
        """Return the encoder of the samples, or None if the topic has none."""
        return (self.make and self.make(run, publisher)) or (
            self.encoder and self.encoder(run.simulation.hamiltonian.coordinates))


SCENE = Output('~/scene', String, LATCHED, recorded='apart')
# Alarms are recorded; the periodic statuses are not.
DIAGNOSTICS = Output('/diagnostics', DiagnosticArray, _ALARMS, recorded='apart')
EVENTS = Output('~/events', DiagnosticArray, _EVENTS, lambda settings, run: run and run.events,
                recorded='apart')
ACCURACY = Output('~/accuracy', Float64MultiArray, TICKS,
                  lambda settings, run: settings.publish_accuracy,
                  lambda run, publisher: AccuracyEncoder(run.simulation, run.monitor).encode,
                  'tick')
ENERGY_BY_CAUSE = Output(
    '~/energy_by_cause', JointState, TICKS,
    lambda settings, run: settings.energy_by_cause or (run and run.simulation.ledger),
    lambda run, publisher: encode_causes(run.simulation), 'apart')
PREDICTION_ERROR = Output(
    '~/prediction_error', JointState, TICKS,
    lambda settings, run: run and OBSERVATIONS.holds & run.simulation.motors.takes,
    recorded='apart')
STATE_SET = Output('~/state_set', DiagnosticArray, _ALARMS, lambda settings, run: run)
JOINT_STATES = Output('joint_states', JointState, TICKS, make=lambda run, publisher: (
    None if run.sensor is None else encode_readings(
        run.simulation.hamiltonian.coordinates, run.sensor)), recorded='tick',
    encoder=encode_joints)
# The topic name that robot_state_publisher uses.
ROBOT = Output('robot_description', String, LATCHED,
               lambda settings, run: run and run.simulation.hamiltonian.robot, recorded='apart')


def _markers(run: ConfiguredRun, publisher: Publisher) -> Encode:
    assert run.mechanism is not None, 'the row asks for it'
    hamiltonian = run.simulation.hamiltonian
    ends = ends_of(hamiltonian, run.simulation.q, run.box)
    return MarkerEncoder(publisher.get_subscription_count, MECHANISMS[run.mechanism],
                         reach_of(hamiltonian, ends), run.frame_id).encode


def _spread(run: ConfiguredRun) -> SpreadTopic:
    assert run.spread is not None, 'the row asks for it'
    return run.spread


# Topics are published in this order: a node paced by /clock gets the time before the sample.
OUTPUTS = (
    Output(CLOCK_TOPIC, Clock, CLOCK_QOS, lambda settings, run: settings.publish_clock,
           lambda run, publisher: ClockEncoder().encode),
    Output('~/state', JointState, TICKS, recorded='tick', encoder=encode_state),
    Output('~/q', Float64MultiArray, TICKS, recorded='tick', encoder=lambda coordinates:
           encode_array(columns(coordinates)[0], lambda sample: sample.q)),
    Output('~/p', Float64MultiArray, TICKS, recorded='tick', encoder=lambda coordinates:
           encode_array(columns(coordinates)[1], lambda sample: sample.p)),
    Output('~/energy', Float64, TICKS, recorded='tick', encoder=lambda coordinates:
           encode_numbers(Float64(), lambda sample: [sample.energy])),
    JOINT_STATES,
    Output('~/loop_forces', JointState, TICKS,
           lambda settings, run: settings.publish_loop_forces,
           lambda run, publisher: encode_loop_forces(run.simulation), 'tick'),
    ENERGY_BY_CAUSE, ACCURACY,
    Output('~/odometry', Odometry, TICKS,
           lambda settings, run: run and run.simulation.hamiltonian.rotations,
           lambda run, publisher: OdometryEncoder(
               run.simulation.hamiltonian.coordinates, run.frame_id).encode),
    Output('~/markers', MarkerArray, NEWEST, lambda settings, run: run and run.mechanism,
           _markers),
    Output('~/joint_trajectory_state', JointTrajectory, TICKS,
           lambda settings, run: run and run.simulation.motors.servo_target is not None,
           lambda run, publisher: encode_feedback(run.simulation), 'apart'),
    Output('~/uncertainty', JointState, TICKS, lambda settings, run: run and run.spread,
           lambda run, publisher: _spread(run).encode, 'apart'),
    PREDICTION_ERROR, EVENTS, DIAGNOSTICS, SCENE, STATE_SET, ROBOT,
)
