# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
ROS 2: nodes, topics, services, parameters, replay.

The only package that imports rclpy and messages. The parts of a run without ROS are in ``run``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.ros.plumbing.environment import distribution, prepare_ros_environment

__getattr__, __dir__ = lazy_exports(__name__)
