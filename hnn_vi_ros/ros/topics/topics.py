# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the simulator; a topic that the scene does not need is not created."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros.hamiltonians import Payload
from hnn_vi_ros.recording import BagTopics, Sample, serialize, Topic
from hnn_vi_ros.ros.plumbing.graph import wait_for_delivery
from hnn_vi_ros.ros.plumbing.managed_node import CLOCK_TOPIC
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, Endpoint
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.inputs import (
    body_of, command_of, COMMANDS, INITIAL_STATE, Input, INPUTS, JOINT_COMMANDS, OBSERVATIONS,
    PAYLOADS, WRENCHES, write_payload)
from hnn_vi_ros.ros.topics.messages import describe_topic, Encode
from hnn_vi_ros.ros.topics.outputs import (
    ConfiguredRun, DIAGNOSTICS, JOINT_STATES, Output, OUTPUTS, ROBOT, SCENE)
from hnn_vi_ros.ros.topics.remapped_topics import remapped_names
from hnn_vi_ros.ros.topics.subscriptions import Subscriptions
from hnn_vi_ros.run import Monitor, nanoseconds
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

_ANSWERS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# All possible topics, including those that a scene does not need and that are not created.
ENDPOINTS = (
    *(Endpoint(output.topic, 'publisher') for output in OUTPUTS),
    *(Endpoint(one.topic, 'subscription') for one in INPUTS))


class Topics:
    """
    Topics that the simulator publishes and subscribes to.

    Publishers that do not depend on the scene are created at once, so that other nodes discover
    them while the kernel is being compiled; ``open`` creates the others.

    Parameters
    ----------
    node : Node
        The simulator.
    settings : Settings
        The node's parameters.

    Attributes
    ----------
    subscriptions : Subscriptions
        Subscriptions, with counts of the ignored messages.

    """

    def __init__(self, node: Node, settings: Settings):
        self._node, self._settings = node, settings
        # Keys are the names in the code, such as '~/state'.
        self._publishers: dict[str, Publisher] = {}
        self._encoders: dict[str, tuple[Output, Encode]] = {}
        self._described: dict[str, Topic] = {}
        self.subscriptions = Subscriptions(node)
        self._outputs: list[Output] = []
        self._create(None)

    def open(self, material: ConfiguredRun, stamp: Callable[[], int],  # noqa: A003
             record: Callable[[Topic, int, bytes], None],
             join: Callable[[JointState], JointState | None] | None = None,
             answer: Callable[[int], Callable[[], None] | None] | None = None) -> None:
        """
        Create the topics that depend on the scene: odometry, markers, robot, commands and others.

        Parameters
        ----------
        material : Material
            Simulation, monitor and other data that messages are made from.
        stamp : callable
            Returns the stamp of the state [ns].
        record : callable
            Records a message that is not part of a sample: its topic, its stamp and its bytes.
        join : callable, optional
            Returns the observation that a message of the machine completes, or None.
        answer : callable, optional
            In lockstep: checks the stamp of a joint command [ns], and returns a function to call
            once the command is accepted, or None to ignore it.

        """
        simulation = material.simulation
        self._material, self._stamp, self._record, self._join = material, stamp, record, join
        self._answer = answer
        self._create(material)
        self._describe(output for output in self._outputs if output.recorded)
        self._encoders = self._make(self._outputs)
        if (robot := simulation.hamiltonian.robot) is not None:
            self.send(ROBOT, serialize(String(data=robot.text)))
        for one in INPUTS:
            if one.holds & simulation.motors.takes:
                self._hear_commands(one)
        self._body = body_of(simulation.hamiltonian.coordinates, simulation.command_names)
        if self._body is not None:
            self.subscriptions.hear(WRENCHES, self._on_wrench)

    def follow(self, monitor: Monitor) -> None:
        """Take later samples from another monitor, whose run is in its initial state."""
        self._material = self._material._replace(monitor=monitor)
        self._encoders |= self._make(self._ticks)

    def send(self, output: Output, payload: Any, stamp: int | None = None) -> None:
        """Publish a message; record it if it has a stamp [ns] and its topic is recorded apart."""
        self._publishers[output.topic].publish(payload)
        if stamp is not None and output.recorded == 'apart':
            self._record(self._described[output.topic], stamp, payload)

    def close(self) -> None:
        """Destroy all publishers and subscriptions."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self.subscriptions.close()

    @property
    def has_joint_states(self) -> bool:
        """Return True if the last sample came with joint states: a sensor may have lost them."""
        return self._last[[*self._ticks].index(JOINT_STATES)] is not None

    def publish_again(self) -> None:
        """Publish the last sample once more, for late subscribers; the bag holds it once."""
        for output, payload in zip(self._ticks, self._last, strict=True):
            if payload is not None:
                self._publishers[output.topic].publish(payload)

    def publish_scene(self, text: str) -> None:
        """Publish the scene; late subscribers receive it too."""
        self.send(SCENE, serialize(String(data=text)))

    def publish(self, sample: Sample) -> Sequence[bytes | None]:
        """Publish a sample; return its messages as the bag records them, None for no message."""
        payloads: list[bytes | None] = []
        for output, encode in self._encoders.values():
            messages = encode(sample)
            for message in messages:
                self.send(output, message, sample.stamp)
            if output.recorded == 'tick':
                payloads += messages or [None]
        self._last = payloads
        return payloads

    @property
    def descriptions(self) -> BagTopics:
        """Return the descriptions of the topics for the bag."""
        self._describe([*self._ticks, SCENE])
        return BagTopics([self._described[output.topic] for output in self._ticks],
                         self._described[SCENE.topic],
                         remapped_names(self._node, [endpoint.topic for endpoint in ENDPOINTS]),
                         # It has no publisher before the scene is loaded.
                         describe_topic(self._node.resolve_topic_name(ROBOT.topic),
                                        ROBOT.message_type, ROBOT.qos))

    def count_subscribers(self) -> int:
        """Return the number of subscribers to the topics of every tick."""
        return sum(self._publishers[output.topic].get_subscription_count()
                   for output in self._ticks)

    def wait_for_delivery(self, received: Sequence[int]) -> None:
        """Wait until matched subscribers have received pending messages; signals end the wait."""
        wait_for_delivery(self._node, [self._publishers[output.topic] for output in (
            *self._ticks, DIAGNOSTICS)], received)

    def sole(self, follows_clock: bool, joins: bool) -> list[str]:
        """Return the topics that need a single publisher; joined observations may have several."""
        several = (INITIAL_STATE, *[OBSERVATIONS] * joins)
        driven = [one.topic for one in INPUTS
                  if one.topic in self.subscriptions.topics and one not in several]
        clock = [CLOCK_TOPIC] * (follows_clock or CLOCK_TOPIC in self._publishers)
        return [JOINT_STATES.topic, *driven, *clock]

    @property
    def _ticks(self) -> list[Output]:
        return [output for output in self._outputs if output.recorded == 'tick']

    def _create(self, material: ConfiguredRun | None) -> None:
        """Create the publishers that are needed and do not exist yet."""
        self._outputs = [one for one in OUTPUTS if one.when(self._settings, material)]
        for output in self._outputs:
            if output.topic not in self._publishers:
                self._publishers[output.topic] = create_publisher(
                    self._node, output.message_type, output.topic, output.qos)

    def _make(self, outputs: Iterable[Output]) -> dict[str, tuple[Output, Encode]]:
        return {output.topic: (output, encode) for output in outputs if (encode := output.encode(
            self._material, self._publishers[output.topic])) is not None}

    def _describe(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            publisher = self._publishers[output.topic]
            self._described[output.topic] = describe_topic(
                publisher.topic_name, output.message_type, publisher.qos_profile)

    def _hear_commands(self, one: Input) -> None:
        """Subscribe to a topic of commands, and record the accepted commands."""
        if one is JOINT_COMMANDS and self._answer is not None:
            # A lost answer would not be repeated.
            one = one._replace(qos=_ANSWERS)
        heard = self.subscriptions.hear(one, partial(self._take, one))
        self._described[one.topic] = describe_topic(
            heard.topic_name, one.message_type, heard.qos_profile)

    def _take(self, one: Input, message: Any) -> None:
        if one is OBSERVATIONS and self._join is not None:
            message = self._join(message)
            if message is None:
                return
        stamp = self._stamp()
        assert one.content is not None, 'it holds commands'
        accepted = None
        if self._answer is not None and one.topic == JOINT_COMMANDS.topic:
            accepted = self._answer(nanoseconds(message.header.stamp))
            if accepted is None:
                return
        self._material.simulation.set_command(one.content.read(message, stamp))
        # Serialised again, because the sender's padding bytes differ from run to run.
        self._record(self._described[one.topic], stamp, serialize(message))
        if accepted is not None:
            accepted()

    def load(self, payload: Payload) -> None:
        """Change the payload as a message would."""
        self._take(PAYLOADS, write_payload(payload))

    def _on_wrench(self, message: WrenchStamped) -> None:
        # The bag records the equivalent command, so that the run can be simulated again from it.
        self._take(COMMANDS, Float64MultiArray(data=command_of(
            message, self._body or '', self._material.simulation.command_names)))
