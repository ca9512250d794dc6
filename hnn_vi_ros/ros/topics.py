# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the simulator: what a scene does not call for does not exist."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import time

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.accuracy import ACCURACY_TOPIC, AccuracyEncoder
from hnn_vi_ros.ros.diagnostics_publisher import DIAGNOSTICS_TOPIC
from hnn_vi_ros.ros.markers import MarkerPublisher, MARKERS_TOPIC
from hnn_vi_ros.ros.messages import describe_topic, MessageEncoder, TICK_TOPICS
from hnn_vi_ros.ros.monitor import Monitor
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.bag_metadata import Topic
from hnn_vi_ros.sinks.phase_portrait import frames_of, reach_of
from hnn_vi_ros.sinks.sample import Sample
import numpy as np
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64MultiArray, String

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


class Topics:
    """
    What the simulator publishes and hears.

    The topics of every tick are there at once, so that other nodes discover them while the kernel
    is being compiled; ``open`` adds those that depend on the scene.

    Parameters
    ----------
    node : Node
        The simulator.
    accuracy : bool
        Whether the accuracy is published.

    Attributes
    ----------
    diagnostics : Publisher
        Of the health of the run.

    Raises
    ------
    ParameterError
        An overridden QoS policy is not valid.

    """

    def __init__(self, node: Node, accuracy: bool):
        self._node = node
        self._tick_topics = (*TICK_TOPICS, ACCURACY_TOPIC) if accuracy else TICK_TOPICS
        self._publishers = [self._publisher(*topic, 10) for topic in self._tick_topics]
        self.diagnostics = self._publisher(*DIAGNOSTICS_TOPIC, _NEWEST)
        self._accuracy: AccuracyEncoder | None = None
        self._markers: MarkerPublisher | None = None

    def open(self, simulation: Simulation, monitor: Monitor,  # noqa: A003
             mechanism: str | None, box: tuple[np.ndarray, np.ndarray], frame_id: str) -> None:
        """
        Make what depends on the scene: its own topic, messages, markers, and hearing commands.

        Parameters
        ----------
        simulation : Simulation
            In its initial state.
        monitor : Monitor
            What is measured of it.
        mechanism : str or None
            What is drawn as markers.
        box : tuple of np.ndarray, shape (d, 2) each
            Lowest and highest q and p that the drawing leaves room for.
        frame_id : str
            Frame of the markers.

        """
        hamiltonian = simulation.hamiltonian
        self._simulation = simulation
        self._scene = self._publisher('~/scene', String, _LATCHED)
        self._encoder = MessageEncoder([c.name for c in hamiltonian.coordinates])
        if len(self._publishers) > len(TICK_TOPICS):
            self._accuracy = AccuracyEncoder(simulation, monitor)
        if mechanism is not None:
            frames = frames_of(
                hamiltonian, simulation.q, simulation.p, box, hamiltonian.dimension)
            self._markers = MarkerPublisher(
                self._publisher(*MARKERS_TOPIC, _NEWEST), MECHANISMS[mechanism],
                reach_of(frames), frame_id)
        if simulation.takes_commands:
            with _valid_qos('~/commands'):
                self._node.create_subscription(
                    Float64MultiArray, '~/commands', self._on_command, _NEWEST,
                    qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def publish_scene(self, text: str) -> None:
        """Publish the scene, for those as well who subscribe later."""
        self._scene.publish(String(data=text))

    def publish(self, sample: Sample) -> Sequence[bytes]:
        """Publish a sample; return the messages as they were sent, as the log takes them."""
        payloads = self._encoder.encode(sample)
        if self._accuracy is not None:
            payloads = (*payloads, self._accuracy.encode(sample))
        for publisher, payload in zip(self._publishers, payloads, strict=True):
            publisher.publish(payload)
        if self._markers is not None:
            self._markers.publish(sample)
        return payloads

    @property
    def descriptions(self) -> list[Topic]:
        """Return what the log says of the topics of every tick."""
        return [describe_topic(publisher.topic_name, message_type, publisher.qos_profile)
                for publisher, (_, message_type)
                in zip(self._publishers, self._tick_topics, strict=True)]

    @property
    def subscribers(self) -> int:
        """Return the number of subscribers to the topics of every tick."""
        return sum(publisher.get_subscription_count() for publisher in self._publishers)

    def wait_for_delivery(self) -> None:
        """Let matched subscribers receive what is still on its way, for at most a second."""
        deadline = time.monotonic() + 1.0
        for publisher in (*self._publishers, self.diagnostics):
            publisher.wait_for_all_acked(
                Duration(seconds=max(deadline - time.monotonic(), 0.0)))

    def _publisher(self, topic: str, message_type: type, qos: QoSProfile | int) -> Publisher:
        with _valid_qos(topic):
            return self._node.create_publisher(
                message_type, topic, qos,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _on_command(self, message: Float64MultiArray) -> None:
        try:
            self._simulation.set_command(list(message.data))
        except ValueError as problem:
            self._node.get_logger().error(
                f'~/commands: message ignored: {problem}', throttle_duration_sec=1.0)


@contextmanager
def _valid_qos(topic: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, InvalidParameterTypeException) as problem:
        raise ParameterError(f'qos_overrides of {topic}: {" ".join(str(problem).split())}'
                             ) from problem
