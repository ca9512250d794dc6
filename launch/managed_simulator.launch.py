# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the simulator and let the launch system configure and activate it."""

from hnn_vi_ros.ros.launching import describe_node
from hnn_vi_ros.ros.settings import PARAMETERS
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the lifecycle node, its transitions, and its parameters as arguments."""
    return describe_node('simulator', 'hnn_simulator', PARAMETERS, managed=True)
