# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lines for the log of ROS."""

from rclpy.node import Node


def log(node: Node, text: str, level: str) -> None:
    """Log a line; level is INFO, WARN or ERROR."""
    # On lines of their own: rclpy ties the line of a call to one severity.
    if level == 'INFO':
        node.get_logger().info(text)
    elif level == 'WARN':
        node.get_logger().warning(text)
    else:
        node.get_logger().error(text)
