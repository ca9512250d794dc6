# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that report and ignore invalid messages."""

from collections.abc import Callable
from itertools import islice
from typing import Any

from hnn_vi_ros.ros.plumbing.executor import IgnoredErrors
from hnn_vi_ros.ros.plumbing.qos_overrides import create_subscription
from hnn_vi_ros.ros.plumbing.rclpy_internals import take_waiting
from hnn_vi_ros.ros.topics.inputs import Input
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

# Maximum size of a message; longer ones are ignored [bytes].
LARGEST_MESSAGE = 1 << 20


class Subscriptions(IgnoredErrors):
    """
    The subscriptions of a node.

    Parameters
    ----------
    node : Node
        Node that owns the subscriptions.

    Attributes
    ----------
    topics : list of str
        Names of the subscribed topics.
    ignored, reasons
        Number of ignored messages, and reason for ignoring the last one, by topic.

    """

    def __init__(self, node: Node):
        super().__init__(node)
        self._subscriptions: list[Subscription] = []
        self.topics: list[str] = []

    def hear(self, one: Input, take: Callable[[Any], None],
             then: Callable[[], None] | None = None) -> Subscription:
        """
        Subscribe to a topic; report and ignore invalid messages.

        Parameters
        ----------
        one : Input
            Topic to subscribe to.
        take : callable
            Handles a message; on an invalid one, raises an error and changes nothing.
        then : callable, optional
            Called after all waiting messages are handled; may raise an error.

        """
        topic = one.topic

        def use(payload: bytes) -> None:
            if len(payload) > LARGEST_MESSAGE:
                raise ValueError(f'{len(payload)} bytes, at most {LARGEST_MESSAGE} are accepted')
            take(deserialize_message(payload, one.message_type))

        def attempt(what: Callable[..., None], *arguments: bytes) -> None:
            try:
                what(*arguments)
            except Exception as problem:
                # Any exception: no message may end the node, nor the handling of later ones.
                self.ignore(topic, problem)

        def on_message(payload: bytes) -> None:
            attempt(use, payload)
            if then is not None:
                for other in islice(take_waiting(subscription), one.qos.depth):
                    attempt(use, other)
                attempt(then)

        subscription = create_subscription(
            self._node, one.message_type, topic, on_message, one.qos, raw=True)
        self._subscriptions.append(subscription)
        self.topics.append(topic)
        return subscription

    def close(self) -> None:
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
