# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics that the simulator publishes; a new topic is one more row of OUTPUTS."""

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
    AccuracyEncoder, CLOCK_QOS, ClockEncoder, Encode, encode_array, encode_feedback, encode_joints,
    encode_numbers, encode_state)
from hnn_vi_ros.ros.topics.poses import MarkerEncoder, OdometryEncoder
from hnn_vi_ros.run import Monitor
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
# An alarm, or an answer, is not to be replaced by the next one before it has arrived.
_ALARMS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Events are rare, and each counts: who subscribes late, or is found late, has them all the same.
_EVENTS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Material(NamedTuple):
    """
    A configured run, as messages are made of it.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    monitor : Monitor
        What is measured of it.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that drawings leave room for.
    mechanism : str or None
        What is drawn as markers.
    frame_id : str
        Frame of the markers and of odometry.
    events : bool
        Whether the scene has events.
    spread : SpreadTopic or None
        What comes apart, of an ensemble whose uncertainty the scene asks for.

    """

    simulation: Simulation
    monitor: Monitor
    box: tuple[np.ndarray, np.ndarray]
    mechanism: str | None = None
    frame_id: str = 'world'
    events: bool = False
    spread: SpreadTopic | None = None


class Output(NamedTuple):
    """
    A topic that the simulator publishes.

    Parameters
    ----------
    topic : str
        Its name in the node.
    message_type : type
        Type of its messages.
    qos : QoSProfile
        What its publisher offers.
    when : callable
        ``when(settings, material)`` returns whether it exists. It is asked at the start of the
        configuration, without material, so that other nodes discover the topic while the scene is
        compiled; and again with the material.
    make : callable, optional
        ``make(material, publisher)`` returns the encoder of its samples. Without one, messages
        are sent by ``Topics.send``.
    encoder : callable, optional
        ``encoder(coordinates)`` does the same where that needs the coordinates alone; bags of
        sweeps hold these topics as well.
    recorded : str
        ``'tick'``: one message in each sample of a bag, in the order of the rows; ``'apart'``: as
        a message with a stamp of its own; empty: not at all.

    """

    topic: str
    message_type: type
    qos: QoSProfile
    when: Callable[[Settings, Material | None], object] = lambda settings, run: True
    make: Callable[[Material, Publisher], Encode] | None = None
    recorded: Literal['', 'tick', 'apart'] = ''
    encoder: Callable[[Sequence[Coordinate]], Encode] | None = None

    def encode(self, run: Material, publisher: Publisher) -> Encode | None:
        """Return the encoder of its samples, None without one."""
        if self.encoder is not None:
            return self.encoder(run.simulation.hamiltonian.coordinates)
        return self.make and self.make(run, publisher)


SCENE = Output('~/scene', String, LATCHED, recorded='apart')
# Alarms are recorded; the figures of each second are not.
DIAGNOSTICS = Output('/diagnostics', DiagnosticArray, _ALARMS, recorded='apart')
EVENTS = Output('~/events', DiagnosticArray, _EVENTS, lambda settings, run: run and run.events,
                recorded='apart')
ACCURACY = Output('~/accuracy', Float64MultiArray, TICKS,
                  lambda settings, run: settings.publish_accuracy,
                  lambda run, publisher: AccuracyEncoder(run.simulation, run.monitor).encode,
                  'tick')
PREDICTION_ERROR = Output(
    '~/prediction_error', JointState, TICKS,
    lambda settings, run: run and OBSERVATIONS.holds & run.simulation.motors.takes,
    recorded='apart')
STATE_SET = Output('~/state_set', DiagnosticArray, _ALARMS, lambda settings, run: run)
JOINT_STATES = Output('joint_states', JointState, TICKS, recorded='tick', encoder=encode_joints)
# As a robot's state publisher calls it.
ROBOT = Output('robot_description', String, LATCHED,
               lambda settings, run: run and run.simulation.hamiltonian.robot)


def _markers(run: Material, publisher: Publisher) -> Encode:
    assert run.mechanism is not None, 'the row asks for it'
    hamiltonian = run.simulation.hamiltonian
    ends = ends_of(hamiltonian, run.simulation.q, run.box)
    return MarkerEncoder(publisher.get_subscription_count, MECHANISMS[run.mechanism],
                         reach_of(hamiltonian, ends), run.frame_id).encode


def _spread(run: Material) -> SpreadTopic:
    assert run.spread is not None, 'the row asks for it'
    return run.spread


# A sample goes out in this order: who is paced by /clock has its time before the sample.
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
    JOINT_STATES, ACCURACY,
    Output('~/odometry', Odometry, TICKS,
           lambda settings, run: run and run.simulation.hamiltonian.rotations,
           lambda run, publisher: OdometryEncoder(
               run.simulation.hamiltonian.coordinates, run.frame_id).encode),
    Output('~/markers', MarkerArray, NEWEST, lambda settings, run: run and run.mechanism,
           _markers),
    Output('~/joint_trajectory_state', JointTrajectory, TICKS,
           lambda settings, run: run and run.simulation.motors.aim is not None,
           lambda run, publisher: encode_feedback(run.simulation), 'apart'),
    Output('~/uncertainty', JointState, TICKS, lambda settings, run: run and run.spread,
           lambda run, publisher: _spread(run).encode, 'apart'),
    PREDICTION_ERROR, EVENTS, DIAGNOSTICS, SCENE, STATE_SET, ROBOT,
)
# What bags of sweeps hold.
SAMPLED = tuple(output for output in OUTPUTS if output.encoder is not None)


def encode_sample(coordinates: Sequence[Coordinate]) -> Encode:
    """Return the encoder of a sample, one message for each of SAMPLED."""
    encoders = [output.encoder(coordinates) for output in SAMPLED if output.encoder is not None]
    return lambda sample: [payload for encode in encoders for payload in encode(sample)]
