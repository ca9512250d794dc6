# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Play a bag: ``ros2 launch hnn_vi_ros replay.launch.py bag:=FOLDER``."""

from hnn_vi_ros.ros.launching import describe_node
from hnn_vi_ros.ros.settings import REPLAY_PARAMETERS
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the node and the arguments that configure it: the bag, and its parameters."""
    return describe_node('replay', 'hnn_replay', REPLAY_PARAMETERS, [
        ('bag', 'folder of the bag, or its .mcap file')])
