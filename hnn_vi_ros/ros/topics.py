# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the simulator: what a scene does not call for does not exist."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros.bags.bag_metadata import BagTopics, Topic
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.accuracy import ACCURACY_TOPIC, AccuracyEncoder
from hnn_vi_ros.ros.clock_publisher import CLOCK_QOS, CLOCK_TOPIC, ClockPublisher
from hnn_vi_ros.ros.diagnostics_publisher import DIAGNOSTICS_TOPIC
from hnn_vi_ros.ros.event_topic import EVENTS_TOPIC
from hnn_vi_ros.ros.graph import UNDELIVERED, wait_for_delivery
from hnn_vi_ros.ros.inputs import Input, INPUTS
from hnn_vi_ros.ros.markers import MarkerPublisher, MARKERS_TOPIC
from hnn_vi_ros.ros.messages import describe_topic, MessageEncoder, TICK_TOPICS
from hnn_vi_ros.ros.odometry import ODOMETRY_TOPIC, OdometryEncoder
from hnn_vi_ros.ros.qos_overrides import create_publisher, create_subscription, Endpoint
from hnn_vi_ros.ros.remapped_topics import remapped
from hnn_vi_ros.ros.spread_topic import SPREAD_TOPIC
from hnn_vi_ros.ros.trajectory_feedback import TRAJECTORY_STATE_TOPIC, TrajectoryFeedback
from hnn_vi_ros.ros.twin_topic import ERROR_TOPIC
from hnn_vi_ros.ros.wrench import body_of, command_of, WRENCH_TOPIC
from hnn_vi_ros.run.monitor import Monitor
from hnn_vi_ros.run.serialization import serialize
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample
from hnn_vi_ros.viewer.phase_portrait import ends_of, reach_of
import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import Float64MultiArray, String

# Longer messages are not heard [bytes].
LARGEST_MESSAGE = 1 << 20
# The reason for ignoring a message has room for the names of twelve joints, and a remedy.
LONGEST_REASON = 500
SCENE_TOPIC: tuple[str, type] = ('~/scene', String)
# As a robot's state publisher calls it.
ROBOT_TOPIC: tuple[str, type] = ('robot_description', String)
STATE_SET_TOPIC: tuple[str, type] = ('~/state_set', DiagnosticArray)
TICKS = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# An alarm, or an answer, is not to be replaced by the next one before it has arrived.
_ALARMS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Events are rare, and each counts: who subscribes late, or is found late, has them all the same.
EVENTS_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)

# All that there can be: what a scene does not call for is known, but does not exist.
ENDPOINTS = (
    *(Endpoint(name, 'publisher') for name, _ in (
        *TICK_TOPICS, ACCURACY_TOPIC, DIAGNOSTICS_TOPIC, CLOCK_TOPIC, MARKERS_TOPIC,
        EVENTS_TOPIC, ODOMETRY_TOPIC, TRAJECTORY_STATE_TOPIC, STATE_SET_TOPIC, SCENE_TOPIC,
        ROBOT_TOPIC, SPREAD_TOPIC, ERROR_TOPIC)),
    *(Endpoint(name, 'subscription') for name in (
        *(one.topic for one in INPUTS), '~/initial_state', '~/wrench')))


class Topics:
    """
    Topics that the simulator publishes and hears.

    The topics of every tick and the scene's are there at once, so that other nodes discover them
    while the kernel is being compiled; ``open`` adds those that depend on the scene.

    Parameters
    ----------
    node : Node
        The simulator.
    accuracy, clock : bool
        Whether the accuracy is published, and whether the clock is.

    Attributes
    ----------
    diagnostics : Publisher
        Of the health of the run.

    """

    def __init__(self, node: Node, accuracy: bool, clock: bool = False):
        self._node, self._opened = node, []
        self._heard: dict[str, Topic] = {}
        # Messages that could not be used, and why the last one could not, by topic.
        self.ignored: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self._tick_topics = (*TICK_TOPICS, ACCURACY_TOPIC) if accuracy else TICK_TOPICS
        self._publishers = [self._publisher(*topic, TICKS) for topic in self._tick_topics]
        self.diagnostics = self._publisher(*DIAGNOSTICS_TOPIC, _ALARMS)
        self._scene = self._publisher(*SCENE_TOPIC, LATCHED)
        self._clock = ClockPublisher(
            self._publisher(*CLOCK_TOPIC, CLOCK_QOS)) if clock else None
        self._accuracy: AccuracyEncoder | None = None
        self._markers: MarkerPublisher | None = None
        self._odometry: tuple[OdometryEncoder, Publisher] | None = None
        self._feedback: tuple[TrajectoryFeedback, Publisher, Topic] | None = None

    def open(self, simulation: Simulation, monitor: Monitor,  # noqa: A003
             mechanism: str | None, box: tuple[np.ndarray, np.ndarray], frame_id: str,
             stamp: Callable[[], int], record: Callable[[Topic, bytes], None]) -> None:
        """
        Make what depends on the scene: messages, odometry, markers, a robot, and commands.

        Parameters
        ----------
        simulation : Simulation
            In its initial state.
        monitor : Monitor
            Its measurements.
        mechanism : str or None
            The mechanism drawn as markers.
        box : tuple of np.ndarray, shape (d, 2) each
            Lowest and highest q and p that the drawing leaves room for.
        frame_id : str
            Frame of the markers and of odometry.
        stamp : callable
            Returns that of the state [ns].
        record : callable
            Takes a message that belongs to the state: its topic, and the bytes.

        """
        hamiltonian = simulation.hamiltonian
        self._simulation, self._stamp, self._record = simulation, stamp, record
        self._encoder = MessageEncoder(hamiltonian.coordinates)
        self.follow(monitor)
        if hamiltonian.rotations:
            self._odometry = (OdometryEncoder(hamiltonian.coordinates, frame_id),
                              self._publisher(*ODOMETRY_TOPIC, TICKS))
        if mechanism is not None:
            ends = ends_of(hamiltonian, simulation.q, simulation.p, box)
            self._markers = MarkerPublisher(
                self._publisher(*MARKERS_TOPIC, _NEWEST), MECHANISMS[mechanism],
                reach_of(hamiltonian, ends), frame_id)
        if hamiltonian.robot is not None:
            self._publisher(*ROBOT_TOPIC, LATCHED).publish(
                serialize(String(data=hamiltonian.robot.text)))
        for one in INPUTS:
            if one.holds & simulation.motors.takes:
                self._hear_commands(one)
        self._body = body_of(hamiltonian.coordinates, simulation.command_names)
        if self._body is not None:
            self.hear(*WRENCH_TOPIC, self._on_wrench)
        if (aim := simulation.motors.aim) is not None:
            publisher = self._publisher(*TRAJECTORY_STATE_TOPIC, TICKS)
            self._feedback = TrajectoryFeedback(aim), publisher, describe_topic(
                publisher.topic_name, TRAJECTORY_STATE_TOPIC[1], publisher.qos_profile)

    def open_events(self) -> Publisher:
        """Make the topic of events, for a scene that has any."""
        return self._publisher(*EVENTS_TOPIC, EVENTS_QOS)

    def open_spread(self) -> Publisher:
        """Make the topic of the spread, for a scene that asks for it."""
        return self._publisher(*SPREAD_TOPIC, TICKS)

    def open_errors(self) -> Publisher:
        """Make the topic of errors, for a scene with an observer."""
        return self._publisher(*ERROR_TOPIC, TICKS)

    def open_answers(self) -> Publisher:
        """Make the topic that answers states to begin at."""
        return self._publisher(*STATE_SET_TOPIC, _ALARMS)

    def follow(self, monitor: Monitor) -> None:
        """Take the accuracy from the monitor of a run, in its initial state."""
        if len(self._publishers) > len(TICK_TOPICS):
            self._accuracy = AccuracyEncoder(self._simulation, monitor)

    def hear(self, topic: str, message_type: type, take: Callable[[Any], None],
             qos: QoSProfile = _NEWEST) -> Subscription:
        """
        Hear a topic; what cannot be used is reported and ignored.

        Parameters
        ----------
        topic : str
            Its name.
        message_type : type
            Of its messages.
        take : callable
            Uses a message, or raises ValueError and changes nothing.
        qos : QoSProfile
            By default the newest message counts.

        """
        def on_message(payload: bytes) -> None:
            try:
                if len(payload) > LARGEST_MESSAGE:
                    raise ValueError(f'{len(payload)} bytes, at most {LARGEST_MESSAGE} are taken')
                take(deserialize_message(payload, message_type))
            except (ValueError, RuntimeError) as problem:
                # RuntimeError: the bytes are no message of this type.
                self.ignored[topic] += 1
                reason = self.reasons[topic] = ' '.join(str(problem).split())[:LONGEST_REASON]
                self._node.get_logger().error(
                    f'{topic}: message ignored: {reason} ({self.ignored[topic]} so far)',
                    throttle_duration_sec=1.0)

        subscription = create_subscription(
            self._node, message_type, topic, on_message, qos, raw=True)
        self._opened.append(subscription)
        return subscription

    def close(self) -> None:
        """Take all topics away."""
        for entity in self._opened:
            if isinstance(entity, Publisher):
                self._node.destroy_publisher(entity)
            else:
                self._node.destroy_subscription(entity)
        self._opened.clear()

    def publish_scene(self, text: str) -> None:
        """Publish the scene, for those as well who subscribe later."""
        self._scene.publish(serialize(String(data=text)))

    def publish(self, sample: Sample) -> Sequence[bytes]:
        """Publish a sample; return the serialised messages for the log."""
        if self._clock is not None:
            self._clock.publish(sample.stamp)
        payloads = self._encoder.encode(sample)
        if self._accuracy is not None:
            payloads = (*payloads, self._accuracy.encode(sample))
        for publisher, payload in zip(self._publishers, payloads, strict=True):
            publisher.publish(payload)
        if self._odometry is not None:
            encoder, publisher = self._odometry
            for payload in encoder.encode(sample):
                publisher.publish(payload)
        if self._markers is not None:
            self._markers.publish(sample)
        if self._feedback is not None and (aim := self._simulation.motors.aim).on_path:
            encoder, publisher, topic = self._feedback
            payload = encoder.encode(sample, aim)
            publisher.publish(payload)
            self._record(topic, payload)
        return payloads

    @property
    def descriptions(self) -> BagTopics:
        """Return what the log says of the topics."""
        return BagTopics(
            [describe_topic(publisher.topic_name, message_type, publisher.qos_profile)
             for publisher, (_, message_type)
             in zip(self._publishers, self._tick_topics, strict=True)],
            describe_topic(self._scene.topic_name, String, self._scene.qos_profile),
            remapped(self._node, [endpoint.topic for endpoint in ENDPOINTS]))

    def count_subscribers(self) -> int:
        """Return the number of subscribers to the topics of every tick."""
        return sum(publisher.get_subscription_count() for publisher in self._publishers)

    def wait_for_delivery(self, received: Sequence[int]) -> None:
        """Let matched subscribers receive what is still on its way; signals shorten it."""
        if late := wait_for_delivery((*self._publishers, self.diagnostics), received):
            self._node.get_logger().warning(UNDELIVERED.format(late))

    def _publisher(self, topic: str, message_type: type, qos: QoSProfile) -> Publisher:
        publisher = create_publisher(self._node, message_type, topic, qos)
        self._opened.append(publisher)
        return publisher

    def _hear_commands(self, one: Input) -> None:
        """Hear a topic of commands, and record what acts."""
        heard = self.hear(one.topic, one.message_type, partial(self._take, one), one.qos)
        self._heard[one.topic] = describe_topic(
            heard.topic_name, one.message_type, heard.qos_profile)

    def _take(self, one: Input, message: Any) -> None:
        self._simulation.set_command(one.read(message, self._stamp()))
        # Anew, not as it came: the padding is the sender's, which no two runs have in common.
        self._record(self._heard[one.topic], serialize(message))

    def _on_wrench(self, message: WrenchStamped) -> None:
        # The bag records the equivalent command, from which the run can be simulated again.
        self._take(INPUTS[0], Float64MultiArray(data=command_of(
            message, self._body or '', self._simulation.command_names)))
