# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that report and ignore invalid messages."""

from collections import Counter
from collections.abc import Callable
from itertools import islice
import math
import time
from typing import Any

from hnn_vi_ros.ros.plumbing.qos_overrides import create_subscription
from hnn_vi_ros.ros.plumbing.rclpy_internals import waiting
from hnn_vi_ros.ros.topics.inputs import Input
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

# Maximum size of a message; longer ones are ignored [bytes].
LARGEST_MESSAGE = 1 << 20
# Maximum length of a reason [characters]: room for the names of twelve joints and a remedy.
LONGEST_REASON = 500
# Minimum wall time between two log lines about ignored messages of a topic [s].
_LOG_PERIOD = 1.0


class Hearing:
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
    ignored : Counter of str
        Number of ignored messages, by topic.
    reasons : dict of str to str
        Reason for ignoring the last such message, by topic.

    """

    def __init__(self, node: Node):
        self._node = node
        self._subscriptions: list[Subscription] = []
        self.topics: list[str] = []
        self.ignored: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        # Time of the next permitted log line, by topic [s].
        self._due: dict[str, float] = {}

    def hear(self, one: Input, take: Callable[[Any], None], raw: bool = False,
             then: Callable[[], None] | None = None) -> Subscription:
        """
        Subscribe to a topic; report and ignore invalid messages.

        Parameters
        ----------
        one : Input
            Topic to subscribe to.
        take : callable
            Handles a message; on an invalid one, raises ValueError and changes nothing.
        raw : bool, optional
            True to pass the serialised bytes to `take`, not the message.
        then : callable, optional
            Called after all waiting messages are handled; may raise ValueError.

        """
        topic = one.topic

        def use(payload: bytes) -> None:
            if len(payload) > LARGEST_MESSAGE:
                raise ValueError(f'{len(payload)} bytes, at most {LARGEST_MESSAGE} are accepted')
            take(payload if raw else deserialize_message(payload, one.message_type))

        def attempt(what: Callable[..., None], *arguments: bytes) -> None:
            try:
                what(*arguments)
            except (ValueError, RuntimeError) as problem:
                # RuntimeError: the bytes are not a message of this type.
                self.ignored[topic] += 1
                reason = self.reasons[topic] = ' '.join(str(problem).split())[:LONGEST_REASON]
                if (now := time.monotonic()) >= self._due.get(topic, -math.inf):
                    self._due[topic] = now + _LOG_PERIOD
                    self._node.get_logger().error(
                        f'{topic}: message ignored: {reason} ({self.ignored[topic]} so far)')

        def on_message(payload: bytes) -> None:
            attempt(use, payload)
            if then is not None:
                for other in islice(waiting(subscription), one.qos.depth):
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
