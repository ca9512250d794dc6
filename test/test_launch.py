# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run the launch files against stand-ins for launch, which the ROS 2 wheels do not have."""

from importlib import import_module
from pathlib import Path
import runpy
import sys
from types import ModuleType, SimpleNamespace

import pytest

LAUNCH_FILES = Path(__file__).resolve().parents[1] / 'launch'
COMMON = {'namespace', 'log_level'}
ARGUMENTS = {
    'simulator': COMMON | {'scene', 'integrator', 'step_size', 'duration', 'publish_rate',
                           'real_time_factor', 'record', 'record_path', 'rerun_sink',
                           'rerun_path'},
    'replay': COMMON | {'bag', 'rate', 'loop', 'start_offset', 'duration', 'topics',
                        'publish_clock', 'start_paused'},
}


def declare(name, description, default_value=None):
    return SimpleNamespace(kind='argument', name=name, default=default_value, text=description)


def typed(value, value_type):
    return SimpleNamespace(source=value, type=value_type)


def node(**fields):
    return SimpleNamespace(kind='node', **fields)


STAND_INS = {
    'launch': {'LaunchDescription': list},
    'launch.actions': {'DeclareLaunchArgument': declare},
    'launch.substitutions': {'LaunchConfiguration': lambda name: f'${name}'},
    'launch_ros': {},
    'launch_ros.actions': {'Node': node},
    'launch_ros.parameter_descriptions': {'ParameterValue': typed},
}


@pytest.fixture(params=ARGUMENTS)
def executable(request) -> str:
    return request.param


@pytest.fixture
def description(monkeypatch, executable):
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    path = LAUNCH_FILES / f'{executable}.launch.py'
    return runpy.run_path(str(path))['generate_launch_description']()


def test_every_launch_file_is_tested():
    assert {path.name for path in LAUNCH_FILES.glob('*')} == {
        f'{name}.launch.py' for name in ARGUMENTS}


def test_launch_file_declares_every_argument_with_default_and_description(
        description, executable):
    arguments = [entity for entity in description if entity.kind == 'argument']
    assert {argument.name for argument in arguments} == ARGUMENTS[executable]
    # What has no default must be given: the bag.
    assert {a.name for a in arguments if not isinstance(a.default, str)} == (
        ARGUMENTS[executable] & {'bag'})
    assert all(argument.text for argument in arguments)


def test_launch_file_forwards_every_argument_to_its_node(description, executable):
    node, = (entity for entity in description if entity.kind == 'node')
    assert (node.package, node.executable) == ('hnn_vi_ros', executable)
    parameters, = node.parameters
    assert {name: value.source for name, value in parameters.items()} == {
        name: f'${name}' for name in ARGUMENTS[executable] - COMMON - {'bag'}}
    assert getattr(node, 'arguments', []) == ['$bag'] * (executable == 'replay')
    assert node.namespace == '$namespace'
    assert node.ros_arguments == ['--log-level', '$log_level']


def test_launch_parameters_have_the_types_and_defaults_of_the_node(description, executable):
    pytest.importorskip('rclpy', reason='ROS 2 is not installed')
    table = 'parameters' if executable == 'simulator' else 'replay_parameters'
    module = import_module(f'hnn_vi_ros.ros.{table}')
    defaults = {specification.name: specification.default for specification in module.PARAMETERS}
    node, = (entity for entity in description if entity.kind == 'node')
    for name, value in node.parameters[0].items():
        assert value.type is type(defaults[name]), name
    for argument in description:
        if argument.kind == 'argument' and argument.name in defaults:
            kind = type(defaults[argument.name])
            declared = argument.default == 'true' if kind is bool else kind(argument.default)
            assert declared == defaults[argument.name], argument.name
