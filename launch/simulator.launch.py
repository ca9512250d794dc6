# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the simulator node: ``ros2 launch hnn_vi_ros simulator.launch.py scene:=NAME``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

# Arguments that become parameters of the node: name, type, default, description.
PARAMETERS = (
    ('scene', str, 'harmonic_oscillator', 'name of a shipped scene, or path of a scene file'),
    ('integrator', str, '', "name of the integrator; empty: the scene's"),
    ('step_size', float, '0.0', "step size [s]; 0: the scene's"),
    ('duration', float, '0.0', 'simulated time after which the node ends [s]; 0: never'),
    ('publish_rate', float, '100.0', 'samples per simulated second [Hz]'),
    ('real_time_factor', float, '1.0', 'simulated seconds per wall second; 0: no limit'),
    ('record', bool, 'true', 'write an MCAP bag'),
    ('record_path', str, '', 'folder of the bag; empty: one of its own under runs/'),
    ('rerun_sink', str, 'file', 'where the picture goes: file, connect, serve or none'),
    ('rerun_path', str, '', 'the .rrd file, or the URL of the viewer; empty: the default'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the node and the arguments that configure it."""
    declarations = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, _, default, description in PARAMETERS
    ]
    declarations += [
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='debug, info, warn, error or fatal'),
    ]
    # Typed: else a scene named 2024 would be read as an integer.
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind, _, _ in PARAMETERS
    }
    node = Node(
        package='hnn_vi_ros',
        executable='simulator',
        namespace=LaunchConfiguration('namespace'),
        parameters=[parameters],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        output='screen',
    )
    return LaunchDescription([*declarations, node])
