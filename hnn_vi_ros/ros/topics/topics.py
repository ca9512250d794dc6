# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the simulator: what a scene does not call for does not exist."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from hnn_vi_ros.recording import BagTopics, Sample, serialize, Topic
from hnn_vi_ros.ros.plumbing.graph import wait_for_delivery
from hnn_vi_ros.ros.plumbing.managed_node import CLOCK_TOPIC
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, Endpoint
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.hearing import Hearing
from hnn_vi_ros.ros.topics.inputs import (
    body_of, command_of, INITIAL_STATE, Input, INPUTS, OBSERVATIONS, WRENCH)
from hnn_vi_ros.ros.topics.messages import describe_topic, Encode
from hnn_vi_ros.ros.topics.outputs import (
    DIAGNOSTICS, JOINT_STATES, Material, Output, OUTPUTS, ROBOT, SCENE)
from hnn_vi_ros.ros.topics.remapped_topics import remapped
from hnn_vi_ros.run import Monitor
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

# All that there can be: what a scene does not call for is known, but does not exist.
ENDPOINTS = (
    *(Endpoint(output.topic, 'publisher') for output in OUTPUTS),
    *(Endpoint(one.topic, 'subscription') for one in INPUTS))


class Topics:
    """
    Topics that the simulator publishes and hears.

    Those that do not depend on the scene are there at once, so that other nodes discover them
    while the kernel is being compiled; ``open`` adds the others.

    Parameters
    ----------
    node : Node
        The simulator.
    settings : Settings
        The node's parameters.

    Attributes
    ----------
    hearing : Hearing
        Subscriptions, and what of their messages was ignored.

    """

    def __init__(self, node: Node, settings: Settings):
        self._node, self._settings = node, settings
        # By the topics' own names.
        self._publishers: dict[str, Publisher] = {}
        self._encoders: dict[str, tuple[Output, Encode]] = {}
        self._described: dict[str, Topic] = {}
        self.hearing = Hearing(node)
        self._outputs: list[Output] = []
        self._create(None)

    def open(self, material: Material, stamp: Callable[[], int],  # noqa: A003
             record: Callable[[Topic, int, bytes], None],
             join: Callable[[JointState], JointState | None] = lambda message: message) -> None:
        """
        Make what depends on the scene: messages, odometry, markers, a robot, and commands.

        Parameters
        ----------
        material : Material
            Simulation, monitor and the rest that messages are made from.
        stamp : callable
            Returns that of the state [ns].
        record : callable
            Takes a message that is not part of a sample: its topic, its stamp and its bytes.
        join : callable, optional
            Returns the observation that a message of the machine completes, if it does.

        """
        simulation = material.simulation
        self._material, self._stamp, self._record, self._join = material, stamp, record, join
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
            self.hearing.hear(WRENCH, self._on_wrench)

    def follow(self, monitor: Monitor) -> None:
        """Take the samples from what is measured of a run, in its initial state."""
        self._material = self._material._replace(monitor=monitor)
        self._encoders |= self._make(self._ticks)

    def send(self, output: Output, payload: Any, stamp: int | None = None) -> None:
        """Publish a message, and record it with its stamp [ns] if it has one."""
        self._publishers[output.topic].publish(payload)
        if stamp is not None and output.recorded == 'apart':
            self._record(self._described[output.topic], stamp, payload)

    def close(self) -> None:
        """Take all topics away."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self.hearing.close()

    def publish_scene(self, text: str) -> None:
        """Publish the scene, for those as well who subscribe later."""
        self.send(SCENE, serialize(String(data=text)))

    def publish(self, sample: Sample) -> Sequence[bytes]:
        """Publish a sample; return the messages as they were sent, as the log takes them."""
        payloads: list[bytes] = []
        for output, encode in self._encoders.values():
            messages = encode(sample)
            for message in messages:
                self.send(output, message, sample.stamp)
            if output.recorded == 'tick':
                payloads += messages
        return payloads

    @property
    def descriptions(self) -> BagTopics:
        """Return what the log says of the topics."""
        self._describe([*self._ticks, SCENE])
        return BagTopics([self._described[output.topic] for output in self._ticks],
                         self._described[SCENE.topic],
                         remapped(self._node, [endpoint.topic for endpoint in ENDPOINTS]))

    def count_subscribers(self) -> int:
        """Return the number of subscribers to the topics of every tick."""
        return sum(self._publishers[output.topic].get_subscription_count()
                   for output in self._ticks)

    def wait_for_delivery(self, received: Sequence[int]) -> None:
        """Let matched subscribers receive what is still on its way; signals shorten it."""
        wait_for_delivery(self._node, [self._publishers[output.topic] for output in (
            *self._ticks, DIAGNOSTICS)], received)

    def sole(self, follows_clock: bool, joins: bool) -> list[str]:
        """Return the topics of which one publisher is expected; observations may be joined."""
        several = (INITIAL_STATE, *[OBSERVATIONS] * joins)
        driven = [one.topic for one in INPUTS
                  if one.topic in self.hearing.topics and one not in several]
        clock = [CLOCK_TOPIC] * (follows_clock or CLOCK_TOPIC in self._publishers)
        return [JOINT_STATES.topic, *driven, *clock]

    @property
    def _ticks(self) -> list[Output]:
        return [output for output in self._outputs if output.recorded == 'tick']

    def _create(self, material: Material | None) -> None:
        """Create the publishers that are called for and not there yet."""
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
        """Hear a topic of commands, and record what acts."""
        heard = self.hearing.hear(one, partial(self._take, one))
        self._described[one.topic] = describe_topic(
            heard.topic_name, one.message_type, heard.qos_profile)

    def _take(self, one: Input, message: Any) -> None:
        if one is OBSERVATIONS and (message := self._join(message)) is None:
            return
        stamp = self._stamp()
        assert one.read is not None, 'it holds commands'
        self._material.simulation.set_command(one.read(message, stamp))
        # Anew, not as it came: the padding is the sender's, which no two runs have in common.
        self._record(self._described[one.topic], stamp, serialize(message))

    def _on_wrench(self, message: WrenchStamped) -> None:
        # The bag records the equivalent command, from which the run can be simulated again.
        self._take(INPUTS[0], Float64MultiArray(data=command_of(
            message, self._body or '', self._material.simulation.command_names)))
