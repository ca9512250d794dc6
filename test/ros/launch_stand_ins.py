# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for launch and launch_ros, which the ROS 2 wheels do not have."""

import sys
from types import ModuleType, SimpleNamespace

import pytest


def declare(name, description, default_value=None):
    return SimpleNamespace(kind='argument', name=name, default=default_value, text=description)


def typed(value, value_type):
    return SimpleNamespace(source=value, type=value_type)


def thing(kind):
    return lambda **fields: SimpleNamespace(kind=kind, **fields)


STAND_INS = {
    'launch': {'LaunchDescription': list},
    'launch.actions': {'DeclareLaunchArgument': declare, 'EmitEvent': thing('event'),
                       'LogInfo': thing('log'),
                       'OpaqueFunction': thing('function'),
                       'RegisterEventHandler': lambda handler: handler},
    'launch.event_handlers': {'OnProcessExit': thing('exit'), 'OnProcessStart': thing('start')},
    'launch.events': {'matches_action': lambda action: action},
    'launch.substitutions': {'LaunchConfiguration': lambda name: f'${name}'},
    'launch_ros': {},
    'launch_ros.actions': {'LifecycleNode': thing('node'), 'Node': thing('node')},
    'launch_ros.event_handlers': {'OnStateTransition': thing('transition')},
    'launch_ros.events': {},
    'launch_ros.events.lifecycle': {'ChangeState': thing('change')},
    'launch_ros.parameter_descriptions': {'ParameterValue': typed},
}


def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put them in the place of launch, for what is imported from now on."""
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, 'hnn_vi_ros.ros.launching', raising=False)
