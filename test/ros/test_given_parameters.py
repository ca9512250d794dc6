# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that a node does not have are refused, not ignored; QoS can be set in full."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
from xml.etree import ElementTree

from hnn_vi_ros.bags.mcap_reader import BagReader
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.node_parameters import declare_parameters, refuse_unknown
from hnn_vi_ros.ros.plumbing.managed_node import RobustNode
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, POLICIES
from hnn_vi_ros.ros.plumbing.starting import own_arguments
from hnn_vi_ros.ros.settings import PARAMETERS, Settings
from hnn_vi_ros.ros.topics.topics import ENDPOINTS
from hnn_vi_ros.scene import load_scene
from peer import Peer, peer
from processes import finish, start, start_executable
import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recorded import record_run
from std_msgs.msg import String
import yaml

POLICY = Path(__file__).resolve().parents[2] / 'config' / 'security' / 'simulator.policy.xml'
Q = 'qos_overrides./hnn_simulator/q.publisher'


@contextmanager
def given(*arguments: str) -> Iterator[Node]:
    """Start a node as the simulator is started, with these arguments."""
    arguments, context = ('--ros-args', *arguments), Context()
    rclpy.init(args=list(arguments), context=context)
    node = Node('hnn_simulator', context=context, start_parameter_services=False,
                automatically_declare_parameters_from_overrides=True)
    try:
        node.settings = declare_parameters(node, Settings)
        refuse_unknown(node, PARAMETERS, ENDPOINTS, arguments)
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def refused(*arguments: str) -> str:
    """Return why the arguments are refused, which is one line."""
    with pytest.raises(ParameterError) as caught, given(*arguments):
        pass
    assert '\n' not in str(caught.value)
    return str(caught.value)


def parameter_file(folder: Path, content: dict) -> tuple[str, str]:
    path = folder / 'given.yaml'
    path.write_text(yaml.safe_dump(content))
    return '--params-file', str(path)


def in_the_graph(other: Peer, find: Callable, topic: str) -> QoSProfile:
    """Return the QoS of the only endpoint that another node finds of a topic."""
    other.spin_until(lambda: find(topic))
    info, = find(topic)
    return info.qos_profile


@pytest.mark.parametrize('name, nearest', [
    ('integratr', 'integrator'), ('stepsize', 'step_size'), ('use_sim_tim', 'use_sim_time'),
    ('Scene', 'scene')])
def test_misspelt_parameter_is_refused_and_the_nearest_is_named(name, nearest):
    assert f'parameter {name}: ' in (why := refused('-p', f'{name}:=rk4'))
    assert why.endswith(f'did you mean {nearest}?')


def test_parameter_like_no_other_is_refused_with_those_that_there_are():
    why = refused('-p', 'xyz.abc:=1')
    assert all(item.name in why for item in PARAMETERS)


@pytest.mark.parametrize('arguments', [
    [], ['-p', 'other_node:integratr:=rk4'], ['-r', 'no_topic:=/elsewhere'],
    ['-p', 'start_type_description_service:=false', '-p', 'use_sim_time:=true'],
    ['-p', 'hnn_simulator:integrator:=rk4'], ['-p', f'{Q}.depth:=3'],
    ['-r', '__node:=mine', '-p', 'qos_overrides./mine/q.publisher.depth:=3']])
def test_parameters_of_ros_of_qos_and_of_other_nodes_are_taken_or_left(arguments):
    with given(*arguments) as node:
        own = '-p hnn_simulator:integrator:=rk4' in ' '.join(arguments)
        assert node.settings.integrator == ('rk4' if own else '')


@pytest.mark.parametrize('section', ['hnn_simulator', '/hnn_simulator', '/**/hnn_simulator'])
def test_unknown_parameter_of_a_file_under_the_name_of_the_node_is_refused(tmp_path, section):
    arguments = parameter_file(tmp_path, {section: {'ros__parameters': {'integratr': 'rk4'}}})
    assert refused(*arguments).endswith('did you mean integrator?')


def test_unknown_parameter_of_a_file_for_all_nodes_is_left_and_a_misspelling_is_told(
        tmp_path, capfd):
    arguments = parameter_file(tmp_path, {
        '/**': {'ros__parameters': {
            'integratr': 'rk4', 'integrator': 'gauss4', 'robot_description': '<robot/>',
            'controller': {'gains': [1.0, 2.0]},
            'qos_overrides': {'/elsewhere': {'publisher': {'depth': 1}}}}},
        'elsewhere': {'ros__parameters': {'xyz': 1}}})
    with given(*arguments) as node:
        assert node.settings.integrator == 'gauss4'
        assert not node.has_parameter('robot_description')
        assert not node.has_parameter('controller.gains')
    told = capfd.readouterr().err
    assert 'parameter integratr, ' in told and told.count('did you mean') == 1


@pytest.mark.parametrize('sections, warned', [
    (['hnn_simulatr'], True), (['/ns/hnn_simulatr'], True), (['elsewhere'], False),
    (['hnn_simulator', 'hnn_simulator2'], False), (['/**', 'hnn_simulatr'], False)])
def test_section_of_a_file_for_a_node_of_nearly_this_name_is_told(
        tmp_path, capfd, sections, warned):
    arguments = parameter_file(tmp_path, {
        section: {'ros__parameters': {'integrator': 'rk4'}} for section in sections})
    with given(*arguments):
        assert ('did you mean hnn_simulator?' in capfd.readouterr().err) == warned


def test_parameter_of_the_command_line_is_refused_beside_a_file_for_all_nodes(tmp_path):
    arguments = parameter_file(tmp_path, {'/**': {'ros__parameters': {'robot': 1}}})
    assert 'integratr' in refused(*arguments, '-p', 'integratr:=rk4')


@pytest.mark.parametrize('name, words', [
    (f'{Q}.reliabilty', 'did you mean publisher.reliability?'),
    (f'{Q}.no_such_policy', 'publisher.liveliness_lease_duration'),
    ('qos_overrides./hnn_simulator/commands.subscription.lifespan', 'none of this name'),
    ('qos_overrides./hnn_simulator/qq.publisher.depth', 'did you mean /hnn_simulator/q?'),
    ('qos_overrides./nothing.publisher.depth', '/joint_states'), ('qos_overrides.x', '/clock')])
def test_unknown_qos_override_is_refused_with_what_there_is(name, words):
    assert words in refused('-p', f'{name}:=1')


@pytest.mark.parametrize('policy, value', [
    ('reliability', 'foo'), ('reliability', '1'), ('durability', 'unknown'), ('history', '7'),
    ('liveliness', 'manual'), ('depth', '0'), ('depth', '-1'), ('depth', '5000000000'),
    ('depth', 'true'), ('deadline', '-1'), ('deadline', '1.5'), ('lifespan', 'long')])
def test_qos_override_that_is_not_valid_is_refused_with_what_is(policy, value):
    assert f'{Q}.{policy} = ' in (why := refused('-p', f'{Q}.{policy}:={value}'))
    assert 'expected one of' in why or 'expected a whole number from' in why


def test_qos_override_of_one_topic_leaves_others_with_the_same_profile_alone():
    profile = QoSProfile(depth=3)
    with given('-p', f'{Q}.depth:=7') as node:
        depths = [create_publisher(node, String, topic, profile).qos_profile.depth
                  for topic in ('~/q', '~/p')]
    assert depths == [7, 3] and profile.depth == 3


def test_qos_overrides_of_every_policy_are_what_the_topics_offer(tmp_path):
    overrides = {
        'q.publisher.reliability': 'best_effort', 'q.publisher.history': 'keep_all',
        'p.publisher.durability': 'transient_local', 'p.publisher.depth': 77,
        'energy.publisher.deadline': 2_000_000_000, 'energy.publisher.lifespan': 3_000_000_000,
        'scene.publisher.liveliness': 'manual_by_topic',
        'scene.publisher.liveliness_lease_duration': 4_000_000_000}
    assert {name.rpartition('.')[2] for name in overrides} == set(POLICIES)
    process = start(tmp_path, scene='exact_harmonic_oscillator', record_path='bag',
                    rerun_sink='none', **{
                        f'qos_overrides./hnn_simulator/{name}': value
                        for name, value in overrides.items()})
    with peer() as other:
        other.spin_until(lambda: other.states)
        offered = {name: in_the_graph(other, other.node.get_publishers_info_by_topic,
                                      f'/hnn_simulator/{name}')
                   for name in ('q', 'p', 'energy', 'scene')}
        process.send_signal(signal.SIGINT)
        assert finish(process)[0] == 0
    assert offered['q'].reliability == ReliabilityPolicy.BEST_EFFORT
    assert offered['p'].reliability == ReliabilityPolicy.RELIABLE
    assert offered['p'].durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert offered['energy'].deadline == Duration(seconds=2)
    assert offered['energy'].lifespan == Duration(seconds=3)
    assert offered['scene'].liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    assert offered['scene'].liveliness_lease_duration == Duration(seconds=4)
    # Queues are not announced: of these the bag tells.
    recorded = {channel.topic[15:]: yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]
                for channel in BagReader(tmp_path / 'bag').channels.values()}
    assert recorded['q']['history'] == 'keep_all' and recorded['p']['depth'] == 77


def test_qos_overrides_of_replay_and_bridge_are_what_they_offer_and_ask_for(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_harmonic_oscillator'), 2)
    replay = start_executable('replay', bag, '--start-paused', '--ros-args', '-p',
                              f'{Q}.reliability:=best_effort', folder=tmp_path)
    bridge = start_executable(
        'rerun_bridge', '--ros-args', '-p', 'rerun_sink:=file', '-p', 'rerun_path:=a.rrd', '-p',
        'qos_overrides./hnn_simulator/state.subscription.reliability:=best_effort',
        folder=tmp_path)
    with peer() as other:
        for find, topic, expected in (
                (other.node.get_publishers_info_by_topic, 'q', ReliabilityPolicy.BEST_EFFORT),
                (other.node.get_publishers_info_by_topic, 'p', ReliabilityPolicy.RELIABLE),
                (other.node.get_subscriptions_info_by_topic, 'state',
                 ReliabilityPolicy.BEST_EFFORT),
                (other.node.get_subscriptions_info_by_topic, 'events',
                 ReliabilityPolicy.RELIABLE)):
            found = in_the_graph(other, find, f'/hnn_simulator/{topic}')
            assert found.reliability == expected
    for process in (replay, bridge):
        process.send_signal(signal.SIGINT)
        assert finish(process)[0] == 0


def test_topics_whose_qos_can_be_set_are_those_of_the_policy():
    rights = ElementTree.parse(POLICY).getroot().findall('.//topics/topic')
    ros_own = {'/parameter_events', '/rosout', '~/transition_event'}
    assert {endpoint.topic for endpoint in ENDPOINTS} == {
        name.text for name in rights} - ros_own


@pytest.mark.parametrize('name, words', [
    ('publish_rat', '; did you mean publish_rate?'), ('xyz', '; it has: autostart, discovery_')])
def test_unknown_parameter_that_is_set_later_is_refused_with_the_nearest(name, words):
    context = Context()
    rclpy.init(context=context)
    node = RobustNode('hnn_simulator', context=context)
    try:
        declare_parameters(node, Settings)
        known = Parameter('real_time_factor', value=2.0)
        result = node.set_parameters_atomically([known, Parameter(name, value=1)])
        assert not result.successful
        assert result.reason.startswith(
            f'parameter {name}: hnn_simulator has none of this name{words}')
        # All of them or none.
        assert node.get_parameter('real_time_factor').value == 1.0
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize('words', [
    ['scene:=kepler'], ['a', 'scene:=kepler', '--ros-args', '-p', 'a:=1'],
    ['--ros-args', '-p', 'a:=1', '--', 'scene:=kepler'], ['__node:=b']])
def test_parameter_in_the_manner_of_launch_is_refused_with_that_of_ros(words):
    with pytest.raises(ParameterError, match=r'--ros-args -p NAME:=VALUE'):
        own_arguments(words)


@pytest.mark.parametrize('executable', [
    'simulator', 'replay', 'rerun_bridge', 'listener', 'controller'])
@pytest.mark.parametrize('words, what', [
    (['--ros-args', '-p', 'integratr:=rk4'], 'integratr'), (['scene:=kepler'], 'scene:=kepler'),
    (['--ros-args', 'scene:=kepler'], 'scene:=kepler'), (['--ros-args', '-p', 'x'], '-p x')])
def test_executable_refuses_what_it_does_not_know_in_one_line_with_its_name(
        tmp_path, executable, words, what):
    bag = []
    if executable == 'replay':
        bag = [record_run(tmp_path / 'bag', load_scene('exact_harmonic_oscillator'), 2)]
    status, _, error = finish(start_executable(executable, *bag, *words, folder=tmp_path))
    assert status == 1
    assert error.startswith(f'{executable}: ') and error.count('\n') == 1 and what in error
