# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the nodes: rclpy lets a time on /clock that cannot be one end the process."""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.ros.plumbing.clock_publisher import CLOCK_TOPIC
from rclpy.node import Node
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock


class RobustNode(Node):
    """A node that ignores impossible times on /clock, and logs that."""

    def create_subscription(self, kind: type, topic: str, callback: Callable[..., None],
                            *args: Any, **more: Any) -> Subscription:
        """See Node, which subscribes to /clock by it wherever use_sim_time asks for that."""
        if topic == CLOCK_TOPIC:
            callback = self._heeding(callback)
        return super().create_subscription(kind, topic, callback, *args, **more)

    def _heeding(self, callback: Callable[[Clock], None]) -> Callable[[Clock], None]:
        def on_clock(message: Clock) -> None:
            seconds, nanoseconds = message.clock.sec, message.clock.nanosec
            if seconds >= 0 and nanoseconds < 10**9:
                callback(message)
            else:
                self.get_logger().error(
                    f'/clock: message ignored: {seconds} s and {nanoseconds} ns: expected at '
                    'least 0 s and less than 10^9 ns', throttle_duration_sec=1.0)
        return on_clock
