# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A process that drives joints as ros2_control's joint_state_topic_hardware_interface does.

It hears joint states with the QoS of sensor data and publishes, 250 times a second, positions by
name; none while they differ from what was heard by no more than 1e-5 in all. Its controller goes
from where the joints are to where they are to be in so many seconds of their stamps, by a quintic
in time. It prints, as JSON, the largest difference from it and the time to the first answer.
"""

import json
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

PERIOD, THRESHOLD, REST = 0.004, 1e-5, 0.5


class Controller(Node):
    """The controller and the interface, in one."""

    def __init__(self, target: dict[str, float], duration: float):
        super().__init__('controller_stand_in')
        self._names, self._duration = list(target), duration
        self._target = np.array(list(target.values()))
        self._state: JointState | None = None
        self._begin = self._start = self._first = None
        self.error, self.latency, self.sent, self.over = 0.0, None, 0, False
        self._commands = self.create_publisher(JointState, '/robot_joint_commands', 1)
        self.create_subscription(
            JointState, '/robot_joint_states', self._on_state, qos_profile_sensor_data)
        self.create_timer(PERIOD, self._update)

    def _on_state(self, message: JointState) -> None:
        self._state = message
        if self._first is not None and self.latency is None and max(
                np.abs(message.effort)) > self._rest:
            self.latency = time.monotonic() - self._first

    def _update(self) -> None:
        if self._state is None or not self._commands.get_subscription_count():
            return
        order = [self._state.name.index(name) for name in self._names]
        found = np.array(self._state.position)[order]
        stamp = self._state.header.stamp
        now = stamp.sec + stamp.nanosec * 1e-9
        if self._begin is None:
            self._begin, self._start = now, found
            self._rest = max(np.abs(self._state.effort)) + 1e-6
        s = min((now - self._begin) / self._duration, 1.0)
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        wanted = self._start + share * (self._target - self._start)
        self.error = max(self.error, float(np.abs(found - wanted).max()))
        if np.abs(found - wanted).sum() > THRESHOLD:
            if self._first is None:
                self._first = time.monotonic()
            self._commands.publish(JointState(
                name=self._names, position=wanted.tolist()))
            self.sent += 1
        self.over = now > self._begin + self._duration + REST


def main() -> None:
    """Drive joints, given with the duration [s] as JSON, until they have come there."""
    target, duration = json.loads(sys.argv[1])
    rclpy.init()
    node = Controller(target, duration)
    while not node.over:
        rclpy.spin_once(node, timeout_sec=1.0)
    print(json.dumps({'error': node.error, 'latency': node.latency, 'sent': node.sent}))


if __name__ == '__main__':
    main()
