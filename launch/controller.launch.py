# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the controller node: ``ros2 launch hnn_vi_ros controller.launch.py task:=NAME``."""

from hnn_vi_ros.ros.launching import describe_node
from hnn_vi_ros.ros.settings import CONTROLLER_PARAMETERS
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the node and the arguments that configure it: its parameters."""
    return describe_node('controller', 'hnn_controller', CONTROLLER_PARAMETERS)
