# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The SROS2 policies allow the nodes what they do in the graph, and nothing else."""

from itertools import count
from pathlib import Path
import signal
from xml.etree import ElementTree

from ensembles import ensemble
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.ros.services import ACTION, INTERFACES, service_name
from hnn_vi_ros.ros.topics.messages import clock_message
from peer import Peer, peer, simulating, SIMULATOR
from processes import finish, standard_error, start_executable, wait_until
import pytest
from rosgraph_msgs.msg import Clock
from scene_files import write_scene

POLICY = Path(__file__).resolve().parents[2] / 'config' / 'security' / 'simulator.policy.xml'
ROBOT = POLICY.parents[1] / 'robots' / 'two_joint_arm.urdf'
# With a body that turns, all that scenes can call for: commands, events, what is drawn, a robot.
EFFECTS = ('{kind: external_force, coordinates: [elbow]}, '
           '{kind: servo, coordinates: [shoulder, elbow], stiffness: 1.0}, '
           '{kind: observer, coordinates: [shoulder]}')
DRAWN = """\
events: [{when: shoulder = elbow}]
mechanism: double_pendulum
"""


def relative(names, node: str = SIMULATOR) -> list[str]:
    """Return names as they are with a remapped node or namespace, sorted."""
    return sorted(name.replace(f'{node}/', '~/') if name.startswith(f'{node}/')
                  else name.removeprefix('/') if name in ('/joint_states', '/robot_description')
                  else name for name in names)


def rights_in_the_graph(other: Peer) -> dict[str, list[str]]:
    """Return what the running simulator publishes, hears and answers."""
    published, heard = other.topics_of()
    services = {name for name, _ in other.node.get_service_names_and_types_by_node(
        SIMULATOR[1:], '/')}
    optional = {f'{SIMULATOR}/{service_name(name)}' for name in INTERFACES if name != ACTION}
    own, replies = ({name for name in names if '/_action/' not in name}
                    for names in (published, services | optional))
    # What an action consists of is allowed by its name.
    return {'publish': relative(own), 'subscribe': relative(heard), 'reply': relative(replies),
            'execute': [f'~/{service_name(ACTION)}']}


def describe(rights: dict[str, list[str]], node: str = SIMULATOR) -> str:
    """Return a policy in the format of SROS2, version 0.2.0."""
    policy = ElementTree.Element('policy', version='0.2.0')
    enclave = ElementTree.SubElement(
        ElementTree.SubElement(policy, 'enclaves'), 'enclave', path=node)
    profile = ElementTree.SubElement(ElementTree.SubElement(enclave, 'profiles'), 'profile',
                                     ns='/', node=node[1:])
    kinds = {'reply': 'service', 'execute': 'action'}
    for right, names in rights.items():
        kind = kinds.get(right, 'topic')
        group = ElementTree.SubElement(profile, f'{kind}s', {right: 'ALLOW'})
        for name in names:
            ElementTree.SubElement(group, kind).text = name
    ElementTree.indent(policy)
    return ElementTree.tostring(policy, encoding='unicode', xml_declaration=True) + '\n'


def check(policy: Path, rights: dict[str, list[str]], whole: bool, renew: bool,
          node: str = SIMULATOR) -> None:
    """Assert that a policy allows these rights, and no others if they are the whole."""
    if whole and renew:
        policy.write_text(describe(rights, node), encoding='utf-8')
    if whole:
        assert policy.read_text(encoding='utf-8') == describe(rights, node), (
            "make test ARGS='test/ros/test_security.py --policy' renews the policy")
    for right, names in rights.items():
        group = ElementTree.parse(policy).getroot().find(f".//profile/*[@{right}='ALLOW']")
        assert {*names} <= {name.text for name in group}, right


@pytest.mark.parametrize('scenes', [['quadrotor'], pytest.param(
    ['arms.yaml', 'several.yaml', 'four_bar', 'quadrotor'],
    marks=pytest.mark.long)], ids=['one', 'all'])
def test_policy_allows_exactly_what_the_simulator_does_in_the_graph(
        tmp_path: Path, request: pytest.FixtureRequest, scenes: list[str]):
    write_scene(tmp_path / 'arms.yaml', f'urdf, file: {ROBOT}', EFFECTS, step_size=0.002,
                q=[0.3, -0.2], p=[0.0, 0.0], more=DRAWN)
    save_checkpoint(tmp_path / 'several.safetensors', ensemble(2))
    write_scene(tmp_path / 'several.yaml', 'learned, model: several.safetensors',
                more='uncertainty: {limit: 1.0}\n')
    rights: dict[str, set[str]] = {}
    for scene in scenes:
        # No node follows the clock that it publishes.
        follows, loops = scene == 'quadrotor', scene == 'four_bar'
        # The reference of a quadrotor takes a minute to compile.
        with simulating(tmp_path, scene=scene, publish_clock=not follows, use_sim_time=follows,
                        publish_accuracy=str(len(scenes) > 1 and not loops).lower(),
                        publish_loop_forces=str(loops).lower()) as (other, _):
            clock, ticks = other.publisher(Clock, '/clock', 10), count(1)
            # All of its topics are there once it publishes.
            other.spin_until(lambda other=other, clock=clock, ticks=ticks: clock.publish(
                clock_message(10**7 * next(ticks))) or other.states)
            other.spin(1.0)
            other.node.destroy_publisher(clock)
            for right, names in rights_in_the_graph(other).items():
                rights.setdefault(right, set()).update(names)
    check(POLICY, {right: sorted(names) for right, names in rights.items()}, len(scenes) > 1,
          request.config.getoption('--policy'))


@pytest.mark.parametrize('tasks', [
    {'swing_up': 'joint_commands'}, pytest.param(
        {'swing_up': 'joint_commands', 'hover': 'commands'}, marks=pytest.mark.long)],
    ids=['one', 'all'])
def test_policy_allows_exactly_what_the_controller_does_in_the_graph(
        request: pytest.FixtureRequest, tasks: dict[str, str]):
    node, policy = '/hnn_controller', POLICY.with_name('controller.policy.xml')
    rights: dict[str, set[str]] = {'publish': set(), 'subscribe': set(), 'reply': set()}
    for task, commands in tasks.items():
        process = start_executable('controller', '--ros-args', '-p', f'task:={task}', '-p',
                                   f'commands:={commands}', '-p', 'use_sim_time:=true')
        with peer() as other:
            wait_until(lambda process=process: 'inactive -> active' in standard_error(process))
            other.spin(1.0)
            published, heard = other.topics_of(node)
            services = {name for name, _ in other.node.get_service_names_and_types_by_node(
                node[1:], '/')}
            for right, names in zip(rights, (published, heard, services), strict=True):
                rights[right] |= names
            process.send_signal(signal.SIGINT)
            assert finish(process)[0] == 0
    check(policy, {right: relative(names, node) for right, names in rights.items()},
          len(tasks) > 1, request.config.getoption('--policy'), node)


def test_policy_lets_the_clock_in_and_holds_no_wildcard_and_no_right_to_call_others():
    profile = ElementTree.parse(POLICY).getroot().find('.//profile')
    heard = [name.text for name in profile.find("topics[@subscribe='ALLOW']")]
    assert heard == ['/clock', '~/commands', '~/initial_state', '~/joint_commands',
                     '~/joint_trajectory', '~/observations', '~/payload', '~/wrench']
    assert {(group.tag, *group.attrib) for group in profile} == {
        ('topics', 'publish'), ('topics', 'subscribe'), ('services', 'reply'),
        ('actions', 'execute')}
    assert not any('*' in name.text for group in profile for name in group)
