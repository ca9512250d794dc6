# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Description of robot.launch.py: a simulated robot, and what drives and shows it in ROS."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError

# Name, default in config/robots, and description of each argument.
_ARGUMENTS = (
    ('scene', 'six_joint_arm.yaml', 'scene of the robot, whose servos take commands'),
    ('robot', 'six_joint_arm.urdf', 'its URDF, with a block for ros2_control'),
    ('controllers', 'six_joint_arm.controllers.yaml', 'parameters of controller_manager'))
_RATE = ('rate', '250.0', 'how often joint states are published [Hz]')
# Packages to launch along with the simulator, where installed, and what they do here.
_STATE_PUBLISHER = ('robot_state_publisher',)
_CONTROL = ('controller_manager', 'joint_state_topic_hardware_interface',
            'joint_state_broadcaster', 'joint_trajectory_controller')
_VIEWER = ('rviz2',)
# These remappings connect the interface of ros2_control to the simulator.
_REMAPPED = [('joint_states', '/robot_joint_states'),
             ('~/joint_commands', '/robot_joint_commands')]


def describe_robot() -> Any:
    """
    Return the launch description of a robot that ros2_control drives.

    Missing packages are left out and named; without ros2_control, the simulator's own joint
    states move the picture.
    """
    # Imported here: only launch files need them.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    folder = Path(get_package_share_directory('hnn_vi_ros')) / 'config' / 'robots'
    arguments = [*((name, str(folder / default), text) for name, default, text in _ARGUMENTS),
                 _RATE]
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in arguments),
        OpaqueFunction(function=lambda context: _entities(context.launch_configurations))])


def _entities(given: dict[str, str]) -> list[Any]:
    """Return the nodes as the arguments have them, and what is said of those left out."""
    from launch.actions import LogInfo
    from launch_ros.actions import Node
    description = {'robot_description': Path(given['robot']).read_text(encoding='utf-8')}
    absent = ((_missing(_STATE_PUBLISHER), 'no frames are published'),
              (_missing(_CONTROL), 'no controller runs; ~/joint_commands and ~/joint_trajectory '
                                   'take commands'),
              (_missing(_VIEWER), 'no picture is shown'))
    parts: list[Any] = [LogInfo(msg=f'{", ".join(missing)} not installed: {lost}')
                        for missing, lost in absent if missing]
    controlled = not _missing(_CONTROL)
    parts.append(Node(
        package='hnn_vi_ros', executable='simulator', name='hnn_simulator', output='screen',
        parameters=[{'scene': given['scene'], 'publish_rate': float(given['rate'])}],
        remappings=_REMAPPED if controlled else []))
    if not _missing(_STATE_PUBLISHER):
        parts.append(Node(package='robot_state_publisher', executable='robot_state_publisher',
                          parameters=[description]))
    if controlled:
        parts.append(Node(
            package='controller_manager', executable='ros2_control_node', output='screen',
            parameters=[description, given['controllers']]))
        parts.append(Node(
            package='controller_manager', executable='spawner',
            arguments=['joint_state_broadcaster', 'joint_trajectory_controller']))
    if not _missing(_VIEWER):
        parts.append(Node(package='rviz2', executable='rviz2'))
    return parts


def _missing(packages: Sequence[str]) -> list[str]:
    """Return which packages are not installed."""
    missing = []
    for package in packages:
        try:
            get_package_share_directory(package)
        except PackageNotFoundError:
            missing.append(package)
    return missing
