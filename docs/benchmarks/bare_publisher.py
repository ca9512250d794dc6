# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The smallest rclpy publisher, as baseline of a cold start."""

import rclpy
from std_msgs.msg import Float64MultiArray

if __name__ == '__main__':
    rclpy.init()
    node = rclpy.create_node('bare_publisher')
    publisher = node.create_publisher(Float64MultiArray, 'bare', 10)
    message = Float64MultiArray(data=[1.0])
    node.create_timer(0.01, lambda: publisher.publish(message))
    rclpy.spin(node)
