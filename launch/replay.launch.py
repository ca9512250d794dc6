# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Play a bag: ``ros2 launch hnn_vi_ros replay.launch.py bag:=FOLDER``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

# Arguments that become parameters of the node: name, type, default, description.
PARAMETERS = (
    ('rate', float, '1.0', 'seconds of the bag per second of wall time'),
    ('loop', bool, 'false', 'begin again at the end'),
    ('start_offset', float, '0.0', 'time that is left out at the start [s]'),
    ('duration', float, '0.0', 'time that is played [s]; 0: to the end'),
    ('topics', str, '', 'topics to publish, separated by commas; empty: all'),
    ('publish_clock', bool, 'false', "publish the bag's time on /clock"),
    ('start_paused', bool, 'false', 'begin paused'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the node and the arguments that configure it."""
    declarations = [
        DeclareLaunchArgument('bag', description='folder of the bag, or its .mcap file'),
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, _, default, description in PARAMETERS),
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='debug, info, warn, error or fatal'),
    ]
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind, _, _ in PARAMETERS
    }
    node = Node(
        package='hnn_vi_ros',
        executable='replay',
        namespace=LaunchConfiguration('namespace'),
        arguments=[LaunchConfiguration('bag')],
        parameters=[parameters],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        output='screen',
    )
    return LaunchDescription([*declarations, node])
