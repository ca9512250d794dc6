# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What the launch files describe: one node, and each of its parameters as an argument."""

from collections.abc import Sequence
from typing import Any

from hnn_vi_ros.ros.parameters import Specification
import yaml


def describe_node(executable: str, table: Sequence[Specification],
                  words: Sequence[tuple[str, str]] = (), *, manage: str = '') -> Any:
    """
    Return the launch description of a node.

    Parameters
    ----------
    executable : str
        Of this package.
    table : sequence of Specification
        The node's parameters.
    words : sequence of (str, str), optional
        Names and descriptions of arguments that the executable takes on its command line.
    manage : str, optional
        Name of a lifecycle node, for the launch system to go through its transitions: configure
        when the process has started, activate when it is configured. Parameter ``autostart`` is
        false then.

    """
    # Imported here: only launch files need them.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import LifecycleNode, Node
    from launch_ros.parameter_descriptions import ParameterValue
    table = [item for item in table if not (manage and item.name == 'autostart')]
    declarations = [
        *(DeclareLaunchArgument(name, description=text) for name, text in words),
        *(DeclareLaunchArgument(item.name, default_value=_text(item.default),
                                description=item.description) for item in table),
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='debug, info, warn, error or fatal'),
    ]
    # Typed: else a scene named 2024 would be read as an integer.
    parameters = {item.name: ParameterValue(LaunchConfiguration(item.name),
                                            value_type=type(item.default)) for item in table}
    fields = {
        'package': 'hnn_vi_ros', 'executable': executable, 'output': 'screen',
        'namespace': LaunchConfiguration('namespace'),
        'arguments': [LaunchConfiguration(name) for name, _ in words],
        'ros_arguments': ['--log-level', LaunchConfiguration('log_level')]}
    if not manage:
        return LaunchDescription([*declarations, Node(parameters=[parameters], **fields)])
    node = LifecycleNode(name=manage, parameters=[{**parameters, 'autostart': False}], **fields)
    return LaunchDescription([*declarations, *_transitions(node), node])


def _transitions(node: Any) -> list[Any]:
    """Return what configures a lifecycle node when it has started, and then activates it."""
    from launch.actions import EmitEvent, RegisterEventHandler
    from launch.event_handlers import OnProcessStart
    from launch.events import matches_action
    from launch_ros.event_handlers import OnStateTransition
    from launch_ros.events.lifecycle import ChangeState
    from lifecycle_msgs.msg import Transition

    def change(transition: int) -> list[EmitEvent]:
        return [EmitEvent(event=ChangeState(
            lifecycle_node_matcher=matches_action(node), transition_id=transition))]

    return [
        RegisterEventHandler(OnProcessStart(
            target_action=node, on_start=change(Transition.TRANSITION_CONFIGURE))),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=node, start_state='configuring', goal_state='inactive',
            entities=change(Transition.TRANSITION_ACTIVATE))),
    ]


def _text(value: object) -> str:
    """Return a default as it is written in YAML; an empty string as nothing."""
    return '' if value == '' else yaml.safe_dump(value).splitlines()[0]
