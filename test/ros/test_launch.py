# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run the launch files against stand-ins for launch, which the ROS 2 wheels do not have."""

from pathlib import Path
import runpy
import subprocess
import sys
from types import ModuleType, SimpleNamespace

from hnn_vi_ros.ros.parameters import PARAMETERS
from hnn_vi_ros.ros.replay_parameters import PARAMETERS as REPLAY_PARAMETERS
from processes import read_bag
import pytest

LAUNCH_FILES = Path(__file__).resolve().parents[2] / 'launch'
COMMON = {'namespace', 'log_level'}
# Executable, its parameters, the words of its command line.
FILES = {
    'simulator': ('simulator', PARAMETERS, []),
    'managed_simulator': (
        'simulator', [item for item in PARAMETERS if item.name != 'autostart'], []),
    'replay': ('replay', REPLAY_PARAMETERS, ['bag']),
}


def declare(name, description, default_value=None):
    return SimpleNamespace(kind='argument', name=name, default=default_value, text=description)


def typed(value, value_type):
    return SimpleNamespace(source=value, type=value_type)


def thing(kind):
    return lambda **fields: SimpleNamespace(kind=kind, **fields)


STAND_INS = {
    'launch': {'LaunchDescription': list},
    'launch.actions': {'DeclareLaunchArgument': declare, 'EmitEvent': thing('event'),
                       'RegisterEventHandler': lambda handler: handler},
    'launch.event_handlers': {'OnProcessStart': thing('start')},
    'launch.events': {'matches_action': lambda action: action},
    'launch.substitutions': {'LaunchConfiguration': lambda name: f'${name}'},
    'launch_ros': {},
    'launch_ros.actions': {'LifecycleNode': thing('node'), 'Node': thing('node')},
    'launch_ros.event_handlers': {'OnStateTransition': thing('transition')},
    'launch_ros.events': {},
    'launch_ros.events.lifecycle': {'ChangeState': thing('change')},
    'launch_ros.parameter_descriptions': {'ParameterValue': typed},
}


@pytest.fixture(params=FILES)
def name(request) -> str:
    return request.param


@pytest.fixture
def description(monkeypatch, name):
    for module_name, members in STAND_INS.items():
        module = ModuleType(module_name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, module_name, module)
    path = LAUNCH_FILES / f'{name}.launch.py'
    return runpy.run_path(str(path))['generate_launch_description']()


def only(description, kind):
    found, = (entity for entity in description if entity.kind == kind)
    return found


def test_every_launch_file_is_tested():
    assert {path.name for path in LAUNCH_FILES.glob('*')} == {
        f'{name}.launch.py' for name in FILES}


def test_launch_file_declares_every_parameter_with_default_and_description(description, name):
    _, table, words = FILES[name]
    arguments = [entity for entity in description if entity.kind == 'argument']
    assert {argument.name for argument in arguments} == (
        {item.name for item in table} | COMMON | set(words))
    # What has no default must be given: the bag.
    assert [a.name for a in arguments if not isinstance(a.default, str)] == words
    assert all(argument.text for argument in arguments)


def test_launch_file_forwards_every_argument_to_its_node(description, name):
    executable, table, words = FILES[name]
    node = only(description, 'node')
    assert (node.package, node.executable) == ('hnn_vi_ros', executable)
    parameters, = node.parameters
    assert {key: value.source for key, value in parameters.items() if key != 'autostart'
            or name == 'simulator'} == {item.name: f'${item.name}' for item in table}
    assert node.arguments == [f'${word}' for word in words]
    assert node.namespace == '$namespace'
    assert node.ros_arguments == ['--log-level', '$log_level']


def test_launch_parameters_have_the_types_and_defaults_of_the_node(description, name):
    defaults = {item.name: item.default for item in FILES[name][1]}
    parameters, = only(description, 'node').parameters
    assert {key: parameters[key].type for key in defaults} == {
        key: type(value) for key, value in defaults.items()}
    for argument in description:
        if argument.kind == 'argument' and argument.name in defaults:
            kind = type(defaults[argument.name])
            declared = argument.default == 'true' if kind is bool else kind(argument.default)
            assert declared == defaults[argument.name], argument.name


@pytest.mark.parametrize('name', ['managed_simulator'], indirect=True)
def test_launch_system_configures_the_managed_node_and_then_activates_it(description):
    node = only(description, 'node')
    assert node.parameters[0]['autostart'] is False
    start, transition = only(description, 'start'), only(description, 'transition')
    assert start.target_action is node and transition.target_lifecycle_node is node
    assert (transition.start_state, transition.goal_state) == ('configuring', 'inactive')
    for handler, number in ((start.on_start, 1), (transition.entities, 3)):
        event, = handler
        assert (event.event.lifecycle_node_matcher, event.event.transition_id) == (node, number)
    # Handlers stand before what they wait for.
    assert description.index(start) < description.index(node)


SYSTEM = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
path, *words = sys.argv[1:]
service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(path),
    launch_arguments=[tuple(word.split(':=', 1)) for word in words])]))
sys.exit(service.run())
"""


@pytest.mark.parametrize('name', ['simulator', 'managed_simulator'])
def test_launch_system_runs_the_simulator_to_its_end(tmp_path, name):
    pytest.importorskip('launch_ros', reason='ros2 launch is not installed')
    words = ['scene:=exact_pendulum', 'duration:=2.0', 'rerun_sink:=none', 'record_path:=bag',
             'namespace:=arm']
    subprocess.run([sys.executable, '-c', SYSTEM, LAUNCH_FILES / f'{name}.launch.py', *words],
                   cwd=tmp_path, timeout=120, check=True)
    assert len(read_bag(tmp_path / 'bag')['/arm/hnn_simulator/q']) == 200
