# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Launch descriptions.

One describes a node with each of its parameters as an argument; the other describes a simulated
robot with the nodes that drive and display it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError
from hnn_vi_ros.errors import did_you_mean
from hnn_vi_ros.ros.settings import Specification
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler)
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition
import yaml

# Arguments besides the parameters: name, default and description.
_COMMON = (
    ('namespace', '', 'namespace of the node'),
    ('params_file', '', 'parameter file; arguments override it'),
    ('use_sim_time', '', 'take the time of ROS from /clock: true or false'),
    ('log_level', 'info', 'log level: debug, info, warn, error or fatal'),
)


def describe_node(executable: str, name: str, table: Sequence[Specification],
                  words: Sequence[tuple[str, str]] = (), *, managed: bool = False) -> Any:
    """
    Return the launch description of a node; a node that fails ends the launch with status 1.

    Parameters
    ----------
    executable : str
        Executable of this package.
    name : str
        Name of the node, which the argument ``name`` overrides.
    table : sequence of Specification
        Parameters of the node.
    words : sequence of (str, str), optional
        Names and descriptions of command-line arguments of the executable.
    managed : bool, optional
        True if the launch system performs the transitions of a lifecycle node: configure when
        the process has started, and activate when the node is configured. Parameter
        ``autostart`` is then false.

    """
    table = [item for item in table if not (managed and item.name == 'autostart')]
    arguments = [
        # Empty means not given: a parameter file then applies, or else the default.
        *((item.name, '', f'{item.description} (default: {_text(item.default)})')
          for item in table),
        ('name', name, 'name of the node'), *_COMMON]
    known = [*(word for word, _ in words), *(argument for argument, _, _ in arguments)]
    return LaunchDescription([
        *(DeclareLaunchArgument(word, description=text) for word, text in words),
        *_launch_arguments(arguments),
        OpaqueFunction(function=lambda context: [
            *_misspelling_warnings(context.argv, known),
            *_entities(context.launch_configurations, executable, table,
                       [word for word, _ in words], managed)])])


def _launch_arguments(arguments: Sequence[tuple[str, str, str]]) -> list[DeclareLaunchArgument]:
    """Declare launch arguments, given by name, default and description."""
    return [DeclareLaunchArgument(name, default_value=default, description=text)
            for name, default, text in arguments]


def _misspelling_warnings(argv: Sequence[str], known: Sequence[str]) -> list[Any]:
    """
    Return warnings of misspelt arguments, which ``ros2 launch`` ignores.

    They are not errors: a launch file that includes this one may have arguments of its own.
    """
    words = [word.partition(':=')[0] for word in argv if ':=' in word]
    return [LogInfo(msg=f'this node has no argument {word}{hint}') for word in words
            if word not in known and (hint := did_you_mean(word, known))]


def _entities(given: dict[str, str], executable: str, table: Sequence[Specification],
              words: Sequence[str], managed: bool) -> list[Any]:
    """Return the node with its arguments, preceded by the event handlers that watch it."""
    types = {item.name: type(item.default) for item in table} | {'use_sim_time': bool}
    # Typed values: otherwise a scene named 2024 would be read as an integer.
    parameters: dict[str, Any] = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in types.items() if given[name] != ''}
    if managed:
        parameters['autostart'] = False
    # Passed to ROS directly, since launch only warns of a missing file among the parameters.
    file = ['--params-file', given['params_file']] if given['params_file'] else []
    node = (LifecycleNode if managed else Node)(
        package='hnn_vi_ros', executable=executable, output='screen', name=given['name'],
        namespace=given['namespace'], arguments=[given[word] for word in words],
        ros_arguments=['--log-level', given['log_level'], *file],
        parameters=[parameters] if parameters else [])
    return [_watch(node), *(_transitions(node) if managed else ()), node]


def _watch(node: Any) -> Any:
    """Return a handler that ends the launch with status 1 if a node's exit status is not 0."""
    def on_exit(event: Any, context: Any) -> None:
        if event.returncode != 0 and not context.is_shutdown:
            raise RuntimeError(f'{event.process_name} ended with status {event.returncode}')

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=on_exit))


def _transitions(node: Any) -> list[Any]:
    """Return handlers that configure a lifecycle node at its start and then activate it."""
    def change(transition: int) -> list[EmitEvent]:
        return [EmitEvent(event=ChangeState(
            lifecycle_node_matcher=matches_action(node), transition_id=transition))]

    def fail(context: Any) -> None:
        # Only an exception in a launch file gives `ros2 launch` an exit status.
        raise RuntimeError('the node could not be configured; its log above states the reason')

    return [
        RegisterEventHandler(OnProcessStart(
            target_action=node, on_start=change(Transition.TRANSITION_CONFIGURE))),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=node, start_state='configuring', goal_state='inactive',
            entities=change(Transition.TRANSITION_ACTIVATE))),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=node, start_state='configuring', goal_state='unconfigured',
            entities=[OpaqueFunction(function=fail)])),
    ]


def _text(value: object) -> str:
    """Return a default in YAML, and an empty string as the word empty."""
    return 'empty' if value == '' else yaml.safe_dump(value).splitlines()[0]


# Name, default in config/robots, and description of each argument.
_ARGUMENTS = (
    ('scene', 'six_joint_arm.yaml', 'scene of the robot, with servos that accept commands'),
    ('robot', 'six_joint_arm.urdf', 'URDF of the robot, with a ros2_control block'),
    ('controllers', 'six_joint_arm.controllers.yaml', 'parameters of controller_manager'))
_RATE = ('rate', '250.0', 'publish rate of joint states [Hz]')
# The packages of ros2_control that drive the robot.
_CONTROL = ('controller_manager', 'joint_state_topic_hardware_interface',
            'joint_state_broadcaster', 'joint_trajectory_controller')
# These remappings connect the interface of ros2_control to the simulator.
_REMAPPED = [('joint_states', '/robot_joint_states'),
             ('~/joint_commands', '/robot_joint_commands')]


def describe_robot() -> Any:
    """
    Return the launch description of a robot that ros2_control drives.

    Missing packages are reported and their nodes omitted; without ros2_control, the joint states
    of the simulator move the picture.
    """
    folder = Path(get_package_share_directory('hnn_vi_ros')) / 'config' / 'robots'
    return LaunchDescription([
        *_launch_arguments([
            *((name, str(folder / default), text) for name, default, text in _ARGUMENTS), _RATE]),
        OpaqueFunction(function=lambda context: _robot_entities(context.launch_configurations))])


def _robot_entities(given: dict[str, str]) -> list[Any]:
    """Return the nodes with their arguments, and messages on the omitted ones."""
    description = {'robot_description': Path(given['robot']).read_text(encoding='utf-8')}
    # Required packages of further nodes, the effect of their absence, and the nodes.
    beside = (
        (['robot_state_publisher'], 'no frames are published', [
            Node(package='robot_state_publisher', executable='robot_state_publisher',
                 parameters=[description])]),
        (_CONTROL, 'no controller runs; send commands to ~/joint_commands or ~/joint_trajectory', [
            Node(package='controller_manager', executable='ros2_control_node', output='screen',
                 parameters=[description, given['controllers']]),
            Node(package='controller_manager', executable='spawner',
                 arguments=['joint_state_broadcaster', 'joint_trajectory_controller'])]),
        (['rviz2'], 'nothing is visualised', [Node(package='rviz2', executable='rviz2')]))
    lines: list[Any] = []
    nodes: list[Any] = []
    for packages, lost, own in beside:
        if missing := _missing(packages):
            lines.append(LogInfo(msg=f'{", ".join(missing)} not installed: {lost}'))
        else:
            nodes += own
    simulator = Node(
        package='hnn_vi_ros', executable='simulator', name='hnn_simulator', output='screen',
        parameters=[{'scene': given['scene'], 'publish_rate': float(given['rate'])}],
        remappings=[] if _missing(_CONTROL) else _REMAPPED)
    return [*lines, simulator, *nodes]


def _missing(packages: Sequence[str]) -> list[str]:
    """Return the packages that are not installed."""
    missing = []
    for package in packages:
        try:
            get_package_share_directory(package)
        except PackageNotFoundError:
            missing.append(package)
    return missing
