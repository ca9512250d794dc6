# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time for /clock, as seldom as other nodes can do with."""

from hnn_vi_ros.simulation.sample import Sample
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

CLOCK_TOPIC = '/clock'
CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# Each message costs every node with use_sim_time; 100 Hz of simulated time [ns].
CLOCK_PERIOD = 10_000_000


class ClockEncoder:
    """Encode the stamps [ns] of samples, none twice and at most a hundred per simulated second."""

    def __init__(self) -> None:
        self._last = 0

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the message of a sample, if it is due; one before the last starts over."""
        if 0 <= sample.stamp - self._last < CLOCK_PERIOD:
            return []
        self._last = sample.stamp
        return [clock_message(sample.stamp)]


def clock_message(stamp: int) -> bytes:
    """Return the message of a stamp [ns]."""
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
    return serialize_message(message)
