# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Publish simulated time on /clock, as seldom as other nodes can do with."""

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

CLOCK_TOPIC = ('/clock', Clock)
CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# Each message costs every node with use_sim_time; 100 Hz of simulated time [ns].
CLOCK_PERIOD = 10_000_000


class ClockPublisher:
    """
    Publish the stamps [ns] of samples, none twice and at most a hundred per simulated second.

    Parameters
    ----------
    publisher : Publisher
        Of rosgraph_msgs/Clock.

    """

    def __init__(self, publisher: Publisher):
        self._publisher, self._message = publisher, Clock()
        self._last = 0

    def publish(self, stamp: int) -> None:
        """Publish a stamp, if it is time to; one that is less than the last starts over."""
        if not 0 <= stamp - self._last < CLOCK_PERIOD:
            self._last = stamp
            self.tell(stamp)

    def tell(self, stamp: int) -> None:
        """Publish a stamp."""
        self._message.clock.sec, self._message.clock.nanosec = divmod(stamp, 10**9)
        self._publisher.publish(serialize_message(self._message))
