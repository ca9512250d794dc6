# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run the launch files against stand-ins for launch, which the ROS 2 wheels do not have."""

from pathlib import Path
import runpy
import subprocess
import sys
from types import SimpleNamespace

from hnn_vi_ros.ros.settings import CONTROLLER_PARAMETERS, PARAMETERS, REPLAY_PARAMETERS
from launch_stand_ins import stand_in
from messages import refused
from processes import read_bag
import pytest
import yaml

LAUNCH_FILES = Path(__file__).resolve().parents[2] / 'launch'
# Executable, name of the node, its parameters, the words of its command line.
FILES = {
    'simulator': ('simulator', 'hnn_simulator', PARAMETERS, []),
    'managed_simulator': ('simulator', 'hnn_simulator', [
        item for item in PARAMETERS if item.name != 'autostart'], []),
    'controller': ('controller', 'hnn_controller', CONTROLLER_PARAMETERS, []),
    'replay': ('replay', 'hnn_replay', REPLAY_PARAMETERS, ['bag']),
}
MANAGED = pytest.mark.parametrize('name', ['managed_simulator'], indirect=True)


@pytest.fixture(params=FILES)
def name(request) -> str:
    return request.param


@pytest.fixture
def description(monkeypatch, name):
    stand_in(monkeypatch)
    path = LAUNCH_FILES / f'{name}.launch.py'
    return runpy.run_path(str(path))['generate_launch_description']()


@pytest.fixture
def launch(description):
    """Return what goes through the description with these arguments."""
    def go(argv=(), **given):
        arguments = {entity.name: entity.default if entity.default is not None else ''
                     for entity in description if entity.kind == 'argument'}
        assert given.keys() <= arguments.keys()
        return only(description, 'function').function(
            SimpleNamespace(launch_configurations=arguments | given, argv=argv))
    return go


def only(description, kind):
    found, = (entity for entity in description if entity.kind == kind)
    return found


def test_every_launch_file_is_tested():
    assert {path.name for path in LAUNCH_FILES.glob('*')} == {
        # That of robots launches several nodes: test_robot_control.py.
        'robot.launch.py', *(f'{name}.launch.py' for name in FILES)}


def test_launch_file_declares_every_parameter_with_its_default_and_description(
        description, name):
    _, node, table, words = FILES[name]
    arguments = {entity.name: entity for entity in description if entity.kind == 'argument'}
    assert arguments.keys() == {item.name for item in table} | set(words) | {
        'name', 'namespace', 'params_file', 'use_sim_time', 'log_level'}
    # What has no default must be given: the bag.
    assert [a.name for a in arguments.values() if not isinstance(a.default, str)] == words
    assert arguments['name'].default == node
    for item in table:
        # Empty is not given: the node has the default itself.
        assert arguments[item.name].default == ''
        shown = yaml.safe_dump(item.default).splitlines()[0] if item.default != '' else 'empty'
        assert arguments[item.name].text == f'{item.description} (default: {shown})'
    assert all(argument.text for argument in arguments.values())


def test_launch_file_forwards_every_argument_to_its_node_in_its_type(launch, name):
    executable, _, table, words = FILES[name]
    types = {item.name: type(item.default) for item in table} | {'use_sim_time': bool}
    node = only(launch(**dict.fromkeys((*types, *words), '1'), name='mine', namespace='/arm',
                       params_file='a.yaml', log_level='warn'), 'node')
    assert (node.package, node.executable, node.name, node.namespace) == (
        'hnn_vi_ros', executable, 'mine', '/arm')
    parameters, = node.parameters
    if name == 'managed_simulator':
        assert parameters.pop('autostart') is False
    assert {key: (value.source, value.type) for key, value in parameters.items()} == {
        key: (f'${key}', kind) for key, kind in types.items()}
    assert node.arguments == ['1'] * len(words)
    assert node.ros_arguments == ['--log-level', 'warn', '--params-file', 'a.yaml']


def test_launch_file_tells_of_misspelt_arguments_and_leaves_those_of_others(launch):
    argv = ['topic:=a', 'params_fil:=a.yaml', 'params_file:=b.yaml', 'params_fil', 'mine:=1']
    told = [entity.msg for entity in launch(argv) if entity.kind == 'log']
    assert 'this node has no argument params_fil; did you mean params_file?' in told
    assert not any('mine' in line or 'params_file is' in line for line in told)
    assert not [entity for entity in launch() if entity.kind == 'log']


def test_launch_file_leaves_what_is_not_given_to_the_parameter_file_and_the_node(launch, name):
    node = only(launch(params_file='a.yaml', use_sim_time='true'), 'node')
    parameters, = node.parameters
    assert parameters.keys() - {'autostart'} == {'use_sim_time'}
    node = only(launch(), 'node')
    assert node.ros_arguments == ['--log-level', 'info']
    assert node.name == FILES[name][1]
    assert node.parameters == ([{'autostart': False}] if name == 'managed_simulator' else [])


@pytest.mark.parametrize('name', ['simulator'], indirect=True)
def test_launch_file_that_is_included_twice_starts_two_nodes_by_their_own_arguments(launch):
    nodes = [only(launch(namespace=namespace, scene=scene), 'node')
             for namespace, scene in (('left', 'pendulum'), ('right', 'kepler'))]
    assert [node.namespace for node in nodes] == ['left', 'right']
    assert [node.name for node in nodes] == ['hnn_simulator'] * 2
    # Others are not given, so that the second has nothing of the first.
    assert [[*node.parameters[0]] for node in nodes] == [['scene']] * 2


@MANAGED
def test_launch_system_configures_the_managed_node_and_then_activates_it(launch):
    entities = launch()
    node = only(entities, 'node')
    start = only(entities, 'start')
    transition, = (item for item in entities
                   if item.kind == 'transition' and item.goal_state == 'inactive')
    assert start.target_action is node and transition.target_lifecycle_node is node
    assert transition.start_state == 'configuring'
    for handler, number in ((start.on_start, 1), (transition.entities, 3)):
        event, = handler
        assert (event.event.lifecycle_node_matcher, event.event.transition_id) == (node, number)
    # Handlers stand before what they wait for.
    assert entities[-1] is node


@MANAGED
def test_launch_fails_if_the_managed_node_cannot_be_configured(launch):
    entities = launch()
    failed, = (item for item in entities
               if item.kind == 'transition' and item.goal_state == 'unconfigured')
    # Not at cleanup, which ends in the same state.
    assert failed.start_state == 'configuring'
    assert failed.target_lifecycle_node is only(entities, 'node')
    act, = failed.entities
    with refused(RuntimeError):
        act.function(SimpleNamespace())


def test_launch_fails_if_the_process_of_its_node_does(launch):
    entities = launch()
    handler = only(entities, 'exit')
    assert handler.target_action is only(entities, 'node')

    def end(status: int, is_shutdown: bool) -> None:
        handler.on_exit(SimpleNamespace(returncode=status, process_name='simulator-1'),
                        SimpleNamespace(is_shutdown=is_shutdown))
    with refused(RuntimeError):
        end(1, False)
    # A run that is over, and what the launch system ends itself.
    assert end(0, False) is end(130, True) is None


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
def test_launch_system_runs_the_simulator_to_its_end_or_fails_with_a_scene_that_is_none(
        tmp_path, name):
    pytest.importorskip('launch_ros', reason='ros2 launch is not installed')
    for scene in ('exact_pendulum', 'nothing'):
        words = [f'scene:={scene}', 'duration:=2.0', 'rerun_sink:=none', 'record_path:=bag',
                 'namespace:=arm']
        ended = subprocess.run(
            [sys.executable, '-c', SYSTEM, LAUNCH_FILES / f'{name}.launch.py', *words],
            cwd=tmp_path, timeout=120, check=False)
        assert (ended.returncode == 0) == (scene == 'exact_pendulum')
    assert len(read_bag(tmp_path / 'bag')['/arm/hnn_simulator/q']) == 200
