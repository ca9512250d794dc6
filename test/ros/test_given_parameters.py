# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of nodes: types, ranges and files; what a node has not is refused; QoS in full."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
from xml.etree import ElementTree

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.node_parameters import declare_parameters, refuse_unknown
from hnn_vi_ros.ros.plumbing.managed_node import RobustNode
from hnn_vi_ros.ros.plumbing.qos_overrides import create_publisher, POLICIES
from hnn_vi_ros.ros.plumbing.starting import own_arguments, plain_ros_errors
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.ros.settings import ALWAYS, PARAMETERS, Settings, START, UNCONFIGURED
from hnn_vi_ros.ros.topics.topics import ENDPOINTS
from hnn_vi_ros.scene import load_scene
from hypothesis import given, HealthCheck, settings, strategies
from messages import assert_message, refused
from peer import (
    ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, Peer, peer, ros, simulating, stamp)
from processes import finish, refusal, standard_error, start_executable
import pytest
from rcl_interfaces.srv import DescribeParameters
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recorded import assert_agrees, record_run
from std_msgs.msg import String
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
POLICY, ROBOTS = CONFIG / 'security' / 'simulator.policy.xml', CONFIG / 'robots'
Q = 'qos_overrides./hnn_simulator/q.publisher'


@contextmanager
def node_of(*arguments: str) -> Iterator[Node]:
    """Start a node as the simulator is started, with these arguments."""
    arguments, context = ('--ros-args', *arguments), Context()
    with plain_ros_errors():
        rclpy.init(args=list(arguments), context=context)
    try:
        with plain_ros_errors():
            node = Node('hnn_simulator', context=context, start_parameter_services=False,
                        automatically_declare_parameters_from_overrides=True)
        try:
            node.settings = declare_parameters(node, Settings)
            refuse_unknown(node, PARAMETERS, ENDPOINTS, arguments)
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def assert_refused(*arguments: str) -> None:
    with refused(ParameterError), node_of(*arguments):
        pass


def parameter_file(folder: Path, content: dict) -> tuple[str, str]:
    path = folder / 'given.yaml'
    path.write_text(yaml.safe_dump(content))
    return '--params-file', str(path)


def in_the_graph(other: Peer, find: Callable, topic: str) -> QoSProfile:
    """Return the QoS of the only endpoint that another node finds of a topic."""
    other.spin_until(lambda: find(topic))
    info, = find(topic)
    return info.qos_profile


def test_misspelt_parameter_is_refused_with_the_nearest_or_all_that_there_are():
    for name in ('integratr', 'stepsize', 'use_sim_tim', 'Scene', 'xyz.abc'):
        assert_refused('-p', f'{name}:=rk4')


def test_parameters_of_ros_of_qos_and_of_other_nodes_are_taken_or_left():
    for arguments in (
            [], ['-p', 'other_node:integratr:=rk4'], ['-r', 'no_topic:=/elsewhere'],
            ['-p', 'start_type_description_service:=false', '-p', 'use_sim_time:=true'],
            ['-p', 'hnn_simulator:integrator:=rk4'], ['-p', f'{Q}.depth:=3'],
            ['-r', '__node:=mine', '-p', 'qos_overrides./mine/q.publisher.depth:=3']):
        with node_of(*arguments) as node:
            own = '-p hnn_simulator:integrator:=rk4' in ' '.join(arguments)
            assert node.settings.integrator == ('rk4' if own else '')


def test_unknown_parameter_of_a_file_under_the_name_of_the_node_is_refused(tmp_path):
    for section in ('hnn_simulator', '/hnn_simulator', '/**/hnn_simulator'):
        assert_refused(*parameter_file(
            tmp_path, {section: {'ros__parameters': {'integratr': 'rk4'}}}))


def test_unknown_parameter_of_a_file_for_all_nodes_is_left_and_a_misspelling_is_told(
        tmp_path, capfd):
    arguments = parameter_file(tmp_path, {
        '/**': {'ros__parameters': {
            'integratr': 'rk4', 'integrator': 'gauss4', 'robot_description': '<robot/>',
            'controller': {'gains': [1.0, 2.0]},
            'qos_overrides': {'/elsewhere': {'publisher': {'depth': 1}}}}},
        'elsewhere': {'ros__parameters': {'xyz': 1}}})
    with node_of(*arguments) as node:
        assert node.settings.integrator == 'gauss4'
        assert not node.has_parameter('robot_description')
        assert not node.has_parameter('controller.gains')
    told = capfd.readouterr().err
    assert 'parameter integratr, ' in told and told.count('did you mean') == 1


def test_section_of_a_file_for_a_node_of_nearly_this_name_is_told(tmp_path, capfd):
    for sections, warned in (
            (['hnn_simulatr'], True), (['/ns/hnn_simulatr'], True), (['elsewhere'], False),
            (['hnn_simulator', 'hnn_simulator2'], False), (['/**', 'hnn_simulatr'], False)):
        arguments = parameter_file(tmp_path, {
            section: {'ros__parameters': {'integrator': 'rk4'}} for section in sections})
        with node_of(*arguments):
            assert ('did you mean hnn_simulator?' in capfd.readouterr().err) == warned, sections


def test_parameter_of_the_command_line_is_refused_beside_a_file_for_all_nodes(tmp_path):
    arguments = parameter_file(tmp_path, {'/**': {'ros__parameters': {'robot': 1}}})
    assert_refused(*arguments, '-p', 'integratr:=rk4')


def test_unknown_qos_override_is_refused_with_what_there_is():
    for name in (f'{Q}.reliabilty', f'{Q}.no_such_policy',
                 'qos_overrides./hnn_simulator/commands.subscription.lifespan',
                 'qos_overrides./hnn_simulator/qq.publisher.depth',
                 'qos_overrides./nothing.publisher.depth', 'qos_overrides.x'):
        assert_refused('-p', f'{name}:=1')


def test_qos_override_that_is_not_valid_is_refused_with_what_is():
    for policy, value in (
            ('reliability', 'foo'), ('reliability', '1'), ('durability', 'unknown'),
            ('history', '7'), ('liveliness', 'manual'), ('depth', '0'), ('depth', '-1'),
            ('depth', '5000000000'), ('depth', 'true'), ('deadline', '-1'), ('deadline', '1.5'),
            ('lifespan', 'long')):
        assert_refused('-p', f'{Q}.{policy}:={value}')


def test_qos_override_of_one_topic_leaves_others_with_the_same_profile_alone():
    profile = QoSProfile(depth=3)
    with node_of('-p', f'{Q}.depth:=7') as node:
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
    given = {f'qos_overrides./hnn_simulator/{name}': value for name, value in overrides.items()}
    with simulating(tmp_path, record_path='bag', **given) as (other, _):
        other.spin_until(lambda: other.states)
        offered = {name: in_the_graph(other, other.node.get_publishers_info_by_topic,
                                      f'/hnn_simulator/{name}')
                   for name in ('q', 'p', 'energy', 'scene')}
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


def test_qos_overrides_of_replay_are_what_it_offers(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_harmonic_oscillator'), 2)
    replay = start_executable('replay', bag, '--start-paused', '--ros-args', '-p',
                              f'{Q}.reliability:=best_effort', folder=tmp_path)
    with peer() as other:
        for topic, expected in (('q', ReliabilityPolicy.BEST_EFFORT),
                                ('p', ReliabilityPolicy.RELIABLE)):
            found = in_the_graph(other, other.node.get_publishers_info_by_topic,
                                 f'/hnn_simulator/{topic}')
            assert found.reliability == expected
    replay.send_signal(signal.SIGINT)
    assert finish(replay)[0] == 0


def test_topics_whose_qos_can_be_set_are_those_of_the_policy():
    rights = ElementTree.parse(POLICY).getroot().findall('.//topics/topic')
    ros_own = {'/parameter_events', '/rosout', '~/transition_event'}
    assert {endpoint.topic for endpoint in ENDPOINTS} == {
        name.text for name in rights} - ros_own


def test_unknown_parameter_that_is_set_later_is_refused_with_the_nearest():
    with ros():
        node = RobustNode('hnn_simulator')
        declare_parameters(node, Settings)
        known = Parameter('real_time_factor', value=2.0)
        for name in ('publish_rat', 'xyz'):
            result = node.set_parameters_atomically([known, Parameter(name, value=1)])
            assert not result.successful
            assert_message(result.reason)
        # All of them or none.
        assert node.get_parameter('real_time_factor').value == 1.0
        node.destroy_node()


def test_parameter_in_the_manner_of_launch_is_refused_with_that_of_ros():
    for words in (['scene:=kepler'], ['a', 'scene:=kepler', '--ros-args', '-p', 'a:=1'],
                  ['--ros-args', '-p', 'a:=1', '--', 'scene:=kepler'], ['__node:=b']):
        with refused(ParameterError):
            own_arguments(words)


@pytest.mark.parametrize('executable', [
    'simulator', 'replay', 'listener', 'controller'])
def test_executable_refuses_what_it_does_not_know_in_one_line_with_its_name(
        tmp_path, monkeypatch, executable):
    monkeypatch.chdir(tmp_path)
    bag = []
    if executable == 'replay':
        bag = [record_run(Path('bag'), load_scene('exact_harmonic_oscillator'), 2)]
    for words in (['--ros-args', '-p', 'integratr:=rk4'], ['scene:=kepler'],
                  ['--ros-args', 'scene:=kepler'], ['--ros-args', '-p', 'x']):
        assert_message(refusal(executable, *bag, *words))


GOOD = """\
/hnn_simulator:
  ros__parameters:
    scene: harmonic_oscillator
    publish_rate: 50
    duration: 2.5
    record: false
    rerun_sink: none
"""


def declare(*arguments: str) -> Settings:
    """Return the parameters of a node that is started with these arguments."""
    with node_of(*arguments) as node:
        return node.settings


def test_parameters_defaults_are_those_of_the_table():
    assert declare() == Settings()
    assert Settings() == Settings(**{item.name: item.default for item in PARAMETERS})


def test_parameters_of_another_node_are_checked_together_and_applied_where_they_may(tmp_path):
    with simulating(tmp_path, scene='exact_harmonic_oscillator', energy_band_limit=1) as (
            other, _):
        other.wait_for_state('active')
        for item in PARAMETERS:
            described, = other.call(
                DescribeParameters, 'describe_parameters', names=[item.name]).descriptors
            assert described.description.startswith(item.description)
            assert described.read_only is (item.changes == START)
            good = item.default if item.default != '' or item.changes == ALWAYS else 'any'
            result = other.set_parameters(**{item.name: good})
            assert result.successful is (item.changes == ALWAYS), result.reason
            if item.changes == UNCONFIGURED:
                assert item.name in result.reason and 'cleanup' in result.reason
            # Wrong types, and what is out of range, are refused in one line whenever they come.
            for bad in ('text', [1.0], float('nan'), -5, None, 'x' * 5000):
                if isinstance(bad, str) and type(item.default) is str:
                    continue
                refused = other.set_parameters(**{item.name: bad})
                assert not refused.successful and '\n' not in refused.reason
        # All or none.
        assert not other.set_parameters(step_count=5, real_time_factor=-1.0).successful
        assert other.get_parameter('step_count') == 1
        assert other.set_parameters(step_count=5, real_time_factor=3).successful
        assert (other.get_parameter('step_count'), other.get_parameter('real_time_factor')) == (
            5, 3.0)
        assert isinstance(other.get_parameter('real_time_factor'), float)
        assert not other.set_parameters(real_time_factor=1e-300).successful
        # Of a scene while the node is unconfigured, and then again not.
        assert other.change_state(DEACTIVATE) and other.change_state(CLEANUP)
        assert other.set_parameters(publish_rate=50, step_size=0.005, scene='x' * 4096).successful
        assert not other.set_parameters(scene='x' * 4097).successful
        assert not other.set_parameters(autostart=False).successful
        assert other.set_parameters(scene='exact_harmonic_oscillator').successful
        other.states.clear()
        assert other.change_state(CONFIGURE) and other.change_state(ACTIVATE)
        other.spin_until(lambda: len(other.states) > 5)
        stamps = [stamp(message) for message in other.states]
        assert stamps[1] - stamps[0] == 20_000_000


def test_limits_of_guards_can_be_changed_while_the_run_goes_on(tmp_path):
    with simulating(tmp_path, integrator='explicit_euler', energy_band_limit=1e6) as (
            other, process):
        other.spin_until(lambda: len(other.states) > 100)
        # Explicit Euler has gained about 1 % by now.
        assert other.set_parameters(energy_band_limit=1e-3).successful
        other.spin(1.0)
    error = standard_error(process)
    assert 'under-resolved' in error


def test_payload_can_be_set_while_the_run_goes_on_and_a_replay_repeats_it(tmp_path):
    scene = tmp_path / 'arm.yaml'
    scene.write_text(f"""
hamiltonian: {{kind: urdf, file: {ROBOTS / 'two_joint_arm.urdf'}, payload: {{link: tool}}}}
integrator: {{kind: generalized_leapfrog}}
step_size: 0.005
initial_state: {{q: [2.0, 0.5], p: [0.0, 0.0]}}
""")
    with simulating(tmp_path, scene=scene, record_path=tmp_path / 'bag',
                    energy_by_cause=True) as (other, _):
        other.spin_until(lambda: len(other.states) > 20)
        for text in ('{mass: -1.0}', 'heavy', '{mass: 1.0, size: 2.0}'):
            result = other.set_parameters(payload=text)
            assert not result.successful and other.get_parameter('payload') == ''
            assert_message(result.reason)
        assert other.set_parameters(payload='{mass: 0.7, centre: [0.0, 0.0, 0.1]}').successful
        other.spin_until(lambda: len(other.states) > 60)
        # Back to that of the scene.
        assert other.set_parameters(payload='').successful
        other.spin_until(lambda: len(other.states) > 90)
    assert_agrees(tmp_path / 'bag')
    masses = [mass for _, _, mass in RecordedRun(tmp_path / 'bag').commands()]
    assert [payload.mass for payload in masses] == [0.7, 0.0]


def test_parameters_of_a_file_are_taken_and_integers_serve_as_doubles(tmp_path):
    path = tmp_path / 'parameters.yaml'
    path.write_text(GOOD)
    values = declare('--params-file', str(path))
    assert values.publish_rate == 50.0
    assert isinstance(values.publish_rate, float)
    assert (values.duration, values.record) == (2.5, False)


@pytest.mark.parametrize('item', [i for i in PARAMETERS if isinstance(i.default, float)],
                         ids=lambda item: item.name)
def test_number_outside_its_range_is_refused_with_the_range(item):
    for value in (item.smallest - 1.0, item.largest * 2.0, int(item.largest * 2), '.nan'):
        with refused(ParameterError):
            declare('-p', f'{item.name}:={value}')


@settings(max_examples=60, suppress_health_check=[
    HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(content=strategies.one_of(
    strategies.binary(max_size=200),
    strategies.tuples(strategies.integers(0, len(GOOD)), strategies.integers(0, 12),
                      strategies.text(max_size=8)).map(
        lambda edit: (GOOD[:edit[0]] + edit[2] + GOOD[edit[0] + edit[1]:]).encode(
            'utf-8', 'surrogatepass'))))
def test_parameter_file_of_any_content_gives_values_or_one_line(tmp_path, content):
    path = Path(tmp_path) / 'parameters.yaml'
    path.write_bytes(content)
    try:
        values = declare('--params-file', str(path))
    except ParameterError as problem:
        assert '\n' not in str(problem)
    else:
        for item in PARAMETERS:
            assert item.check(getattr(values, item.name)) == getattr(values, item.name)
