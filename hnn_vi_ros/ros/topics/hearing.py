# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that report and ignore the messages that cannot be used."""

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

# Longer messages are not heard [bytes].
LARGEST_MESSAGE = 1 << 20
# The reason for ignoring a message has room for the names of twelve joints, and a remedy.
LONGEST_REASON = 500
# Wall time between two lines on messages of a topic that are ignored [s].
_REPEATED = 1.0


class Hearing:
    """
    The subscriptions of a node.

    Parameters
    ----------
    node : Node
        Whose they are.

    Attributes
    ----------
    topics : list of str
        Names of what it subscribes to.
    ignored : Counter of str
        Number of messages that could not be used, by topic.
    reasons : dict of str to str
        Why the last one could not, by topic.

    """

    def __init__(self, node: Node):
        self._node = node
        self._subscriptions: list[Subscription] = []
        self.topics: list[str] = []
        self.ignored: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        # When the log takes the next line on a topic [s].
        self._due: dict[str, float] = {}

    def hear(self, one: Input, take: Callable[[Any], None], raw: bool = False,
             then: Callable[[], None] | None = None) -> Subscription:
        """
        Hear a topic; what cannot be used is reported and ignored.

        Parameters
        ----------
        one : Input
            Which.
        take : callable
            Uses a message, or raises ValueError and changes nothing.
        raw : bool, optional
            Whether it takes the bytes of a message.
        then : callable, optional
            Called when all messages that wait are taken; may raise ValueError too.

        """
        topic = one.topic

        def use(payload: bytes) -> None:
            if len(payload) > LARGEST_MESSAGE:
                raise ValueError(f'{len(payload)} bytes, at most {LARGEST_MESSAGE} are taken')
            take(payload if raw else deserialize_message(payload, one.message_type))

        def attempt(what: Callable[..., None], *arguments: bytes) -> None:
            try:
                what(*arguments)
            except (ValueError, RuntimeError) as problem:
                # RuntimeError: the bytes are no message of this type.
                self.ignored[topic] += 1
                reason = self.reasons[topic] = ' '.join(str(problem).split())[:LONGEST_REASON]
                if (now := time.monotonic()) >= self._due.get(topic, -math.inf):
                    self._due[topic] = now + _REPEATED
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
        """Take the subscriptions away."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
