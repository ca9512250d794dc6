# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A bare rclpy node that publishes the five messages of a sample of the simulator at 1 kHz."""

from array import array

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension

PERIOD = 1e-3

if __name__ == '__main__':
    rclpy.init()
    node = rclpy.create_node('bare')
    names = ['~/state', '~/q', '~/p', '~/energy', 'joint_states']
    kinds = [JointState, Float64MultiArray, Float64MultiArray, Float64, JointState]
    publishers = [node.create_publisher(kind, name, 10)
                  for kind, name in zip(kinds, names, strict=True)]
    step = 0

    def publish() -> None:
        """Fill and publish one message of each kind."""
        global step
        step += 1
        state = Float64MultiArray(data=array('d', [1.0]))
        state.layout.dim = [MultiArrayDimension(label='x', size=1, stride=1)]
        joints = JointState(name=['x'], position=array('d', [1.0]), velocity=array('d', [1.0]),
                            effort=array('d', [1.0]))
        whole = JointState(name=['x', 'p_x', 'dp_dt_x', 'H', 'work'],
                           position=array('d', [1.0] * 5))
        for stamped in (joints, whole):
            stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(
                step * 1_000_000, 10**9)
        for publisher, message in zip(
                publishers, (whole, state, state, Float64(data=1.0), joints), strict=True):
            publisher.publish(message)

    node.create_timer(PERIOD, publish)
    rclpy.spin(node)
