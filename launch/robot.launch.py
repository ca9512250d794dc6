# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Launch a simulated arm under ros2_control: ``ros2 launch hnn_vi_ros robot.launch.py``."""

from hnn_vi_ros.ros.launching import describe_robot
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the simulator, and the tools of ROS that are installed."""
    return describe_robot()
