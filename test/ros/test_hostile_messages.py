# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever messages and requests of valid types come, each node goes on."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
import math
from pathlib import Path
import random
import re
import time
from types import SimpleNamespace
from typing import Any

from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.controller_node import ControllerNode
from hnn_vi_ros.ros.listener_node import Listener
from hnn_vi_ros.ros.plumbing import executor
from hnn_vi_ros.ros.plumbing.executor import failed_response, NodeExecutor
from hnn_vi_ros.ros.plumbing.managed_node import steady_timer
from hnn_vi_ros.ros.replay.replay_node import ReplayNode
from hnn_vi_ros.ros.simulator_node import SimulatorNode
from lifecycle_msgs.srv import ChangeState
from messages import assert_message
import numpy as np
from peer import nodes_of, ros
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger, LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.qos import QoSProfile
from recorded import record_run
from scene_files import write_scene
from simulation_stand_ins import FAILED, interfaces
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

# The longest string and list that are sent in full; the longer ones are beyond the limit of 1 MiB.
_STRINGS = ('', 'angle', 'p_angle', 'angle1', 'cart', 'pole', 'body', 'finger_left', 'step_count',
            'energy_band_limit', 'qos_overrides./x', '\n', 'ä\u202e', '../../etc/passwd',
            'x' * 3000, 'file:///etc/passwd', '{a: [1, 2]}', 'x' * 1_200_000)
_NUMBERS = (0.0, 1.0, -1.0, 0.5, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e12)
_LENGTHS, _LENGTH_WEIGHTS = (0, 1, 2, 3, 7, 1000, 150_000), (8, 8, 8, 4, 4, 1, 0.1)
# These write files.
_FEW = ('start_recording', 'stop_recording')
_MOST_FILES = 24
# Requests that are sent together: fewer than a service holds.
_BURST = 8


def random_value(chance: random.Random, kind: str, length: int | None = None) -> Any:
    """Return a value of a field's type; numbers and lengths of lists are extreme."""
    if found := re.fullmatch(r'sequence<(.*?)(?:, (\d+))?>', kind):
        if length is None:
            length, = chance.choices(_LENGTHS, _LENGTH_WEIGHTS)
        length = min(length, int(found[2] or length))
        if length > 100:
            # One value, repeated: drawing each would take long. Of messages and texts a few.
            numbers = '/' not in found[1] and 'string' not in found[1]
            return [random_value(chance, found[1])] * (length if numbers else 20)
        return [random_value(chance, found[1]) for _ in range(length)]
    if found := re.fullmatch(r'(.*)\[(\d+)\]', kind):
        return [random_value(chance, found[1]) for _ in range(int(found[2]))]
    if kind.startswith(('string', 'wstring')):
        return chance.choices(_STRINGS, [1.0] * (len(_STRINGS) - 1) + [0.02])[0]
    if kind in ('double', 'float'):
        one = chance.choice((*_NUMBERS, chance.uniform(-3.0, 3.0)))
        return one if kind == 'double' or abs(one) < 3e38 or not math.isfinite(one) else 1.0
    if kind == 'boolean':
        return chance.random() < 0.5
    if kind == 'octet':
        return bytes([chance.choice((0, 1, 255))])
    if found := re.fullmatch(r'(u?)int(\d+)', kind):
        bits = int(found[2])
        low, high = (0, 2**bits - 1) if found[1] else (-2**(bits - 1), 2**(bits - 1) - 1)
        return chance.choice((low, high, 0, 1, 2, 4, 99, chance.randint(low, high)))
    package, _, name = kind.partition('/')
    return random_message(chance, getattr(import_module(f'{package}.msg'), name))


def random_message(chance: random.Random, kind: type) -> Any:
    """Return a message or request of a type; half of them have lists of one length."""
    length = chance.choice((1, 2, None, None))
    return kind(**{name: random_value(chance, one, length)
                   for name, one in kind.get_fields_and_field_types().items()})


def harmless(request: Any) -> Any:
    """Return a request changed so that it does not ask the node to end or to stand still."""
    if isinstance(request, ChangeState.Request):
        request.transition.id = request.transition.id if request.transition.id > 7 else 99
    elif hasattr(request, 'state'):
        # Of simulation_interfaces, if it is installed: not quitting.
        request.state.state %= 3
    elif hasattr(request, 'steps'):
        request.steps %= 1000
    return request


class Storm:
    """A node in this process, and another one that sends random messages to all it hears."""

    def __init__(self, node: Node, peer: Node, others: SingleThreadedExecutor, seed: int):
        self.node, self._peer, self._others = node, peer, others
        self.executor, self._chance = NodeExecutor(node), random.Random(seed)
        self.handled: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()

    def spin_until(self, condition: Callable[[], Any], most: float = 120.0) -> bool:
        """Spin both until the condition holds, or for so long [s]."""
        deadline = time.monotonic() + most
        while not condition() and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.0005)
            self._others.spin_once(timeout_sec=0.0)
        return bool(condition())

    def publish(self, count: int) -> None:
        """Send messages on each topic that the node subscribes to, one after another."""
        for subscription in [*self.node.subscriptions]:
            name, callback = subscription.topic_name, subscription.callback

            def counted(message: Any, name: str = name, callback: Any = callback) -> None:
                self.handled[name] += 1
                callback(message)

            subscription.callback = counted
            publisher = self._peer.create_publisher(subscription.msg_type, name, QoSProfile(
                depth=10, reliability=subscription.qos_profile.reliability,
                durability=subscription.qos_profile.durability))
            assert self.spin_until(publisher.get_subscription_count)
            for _ in range(count):
                before = self.handled[name]
                # One of ten is no message at all, where the node decodes it itself.
                publisher.publish(
                    self._chance.randbytes(self._chance.choice((0, 3, 8, 1000)))
                    if subscription.raw and self._chance.random() < 0.1
                    else random_message(self._chance, subscription.msg_type))
                self.sent[name] += 1
                # A best-effort message can be lost.
                self.spin_until(lambda: self.handled[name] > before, 0.5)
            self._peer.destroy_publisher(publisher)

    def call(self, count: int) -> None:
        """Call each service of the node."""
        for name, kind in sorted((one.service_name, one.srv_type) for one in self.node.services):
            if name.endswith('/unload_world'):
                continue
            client = self._peer.create_client(kind, name)
            assert self.spin_until(client.service_is_ready)
            most = min(count, _MOST_FILES) if name.endswith(_FEW) else count
            for begin in range(0, most, _BURST):
                futures = [client.call_async(harmless(random_message(
                    self._chance, kind.Request))) for _ in range(min(_BURST, most - begin))]
                self.sent[name] += len(futures)
                # Some answers come later: those of steps, while the node waits or is paused.
                self.spin_until(lambda: all(one.done() for one in futures), 0.5)
                self.handled[name] += sum(one.done() for one in futures)
            self._peer.destroy_client(client)

    def ask(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service, and return the response."""
        client = self._peer.create_client(kind, f'/{self.node.get_name()}/{name}')
        assert self.spin_until(client.service_is_ready)
        # The first response that is on its way before the client is known here is lost.
        for _ in range(20):
            future = client.call_async(kind.Request(**fields))
            if self.spin_until(future.done, 3.0):
                return future.result()
        raise AssertionError(f'{name}: no response')


QUIET = {'record': 'false', 'rerun_sink': 'none', 'discovery_time': '0.0'}


def words(**values: str) -> list[str]:
    return ['--ros-args', *(word for name, value in values.items()
                            for word in ('-p', f'{name}:={value}'))]


def make_twin(folder: Path) -> tuple[type[Node], list[str]]:
    scene = write_scene(folder / 'twin.yaml', 'pendulum', (
        '{kind: observer, coordinates: [angle]}'), 'stormer_verlet', 0.002, [0.5])
    return SimulatorNode, words(scene=str(scene), **QUIET)


# Each node with a scene, so that all subscriptions of all nodes exist once.
NODES: dict[str, Callable[[Path], tuple[type[Node], list[str]]]] = {
    'twin': make_twin,
    'cart_pole': lambda folder: (SimulatorNode, words(scene='cart_pole', **QUIET)),
    'servo': lambda folder: (SimulatorNode, words(scene='gripper', **QUIET)),
    'body': lambda folder: (SimulatorNode, words(scene='quadrotor', **QUIET)),
    'controller': lambda folder: (ControllerNode, words(task='swing_up')),
    'listener': lambda folder: (Listener, words(use_sim_time='true')),
    'replay': lambda folder: (ReplayNode, words(start_paused='true', discovery_time='0.0')),
}
HEARD = {'twin': {'observations', 'initial_state'},
         'body': {'commands', 'joint_commands', 'wrench', 'initial_state'},
         'cart_pole': {'commands', 'joint_commands', 'initial_state'},
         'servo': {'joint_commands', 'joint_trajectory', 'initial_state'},
         'controller': {'joint_states', 'scene'}, 'listener': {'energy', 'clock'}, 'replay': set()}


@contextmanager
def storm(name: str, folder: Path, seed: int = 1) -> Iterator[Storm]:
    """Give a node that runs, and its peer."""
    kind, arguments = NODES[name](folder)
    with ros(*arguments), nodes_of('peer') as ((peer,), others):
        if kind is ReplayNode:
            node: Any = ReplayNode(
                record_run(folder / 'bag', load_scene('exact_pendulum'), 20), {}, arguments)
        else:
            node = kind() if kind is Listener else kind(arguments)
        found = Storm(node, peer, others, seed)
        if hasattr(node, 'autostart'):
            started = found.executor.create_task(node.autostart)
            assert found.spin_until(started.done, 300.0) and started.exception() is None
            assert found.spin_until(lambda: kind is ControllerNode or node.run.simulation.steps)
        yield found
        if kind is ReplayNode:
            node.player.stop()
        if hasattr(node, 'finish'):
            node.exit_status = 0
            node.finish(*[[]] * (kind is ControllerNode))
        node.destroy_node()


def assert_goes_on(found: Storm) -> None:
    node: Any = found.node
    assert getattr(node, 'exit_status', None) is None and getattr(node, 'problem', None) is None
    assert len(found.ask(GetParameters, 'get_parameters', names=['use_sim_time']).values) == 1
    if isinstance(node, SimulatorNode):
        node.control.set_paused(False)
        assert node.control.reset(True).success
        assert found.spin_until(lambda: node.run.simulation.steps > 5)
        assert np.isfinite([*node.run.simulation.q, *node.run.simulation.p]).all()


def batter(name: str, folder: Path, count: int) -> None:
    with storm(name, folder) as found:
        topics = {one.topic_name.rpartition('/')[2] for one in found.node.subscriptions}
        assert topics == HEARD[name]
        found.publish(count)
        found.call(count)
        # A message can be lost, and a response can wait for steps; nearly all come.
        for one, sent in found.sent.items():
            print(f'{name} {one}: {sent} sent, {found.handled[one]} handled')
            assert found.handled[one] > 0, one
        print(f'{name}: errors of callbacks {dict(found.executor.errors.reasons)}')
        assert_goes_on(found)


@pytest.mark.parametrize('name', NODES)
def test_no_random_message_or_request_ends_a_node(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    batter(name, tmp_path, 100 if len(HEARD[name]) < 4 else 40)


@pytest.mark.long
@pytest.mark.parametrize('name', NODES)
def test_no_random_message_or_request_of_ten_thousand_ends_a_node(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    batter(name, tmp_path, 10_000)


def raises(*arguments: Any) -> None:
    raise KeyError('unforeseen')


def test_error_of_any_callback_is_counted_and_told_and_the_node_goes_on(tmp_path, capfd):
    with storm('listener', tmp_path) as found:
        node = found.node
        for service in node.services:
            assert service.callback.__qualname__.endswith('answer')
        node.create_subscription(Float64, 'numbers', raises, 10)
        timer = steady_timer(node, 0.01, raises)
        publisher = found._peer.create_publisher(Float64, 'numbers', 10)
        errors = found.executor.errors.ignored
        assert found.spin_until(publisher.get_subscription_count)
        publisher.publish(Float64())
        assert found.spin_until(lambda: errors['/numbers'] == 1 and errors['raises'] >= 3)
        timer.cancel()
        assert found.executor.errors.reasons['/numbers'] == "KeyError: 'unforeseen'"
        assert_goes_on(found)
    log = capfd.readouterr().err
    assert "/numbers: error ignored: KeyError: 'unforeseen' (1 so far)" in log


def test_ignored_error_is_formatted_for_debugging_only(monkeypatch):
    """Where another thread compiles, ast.parse of the formatting would raise an error there."""
    node: Any = SimpleNamespace(get_logger=lambda: get_logger('ignored'))
    formatted = []
    monkeypatch.setattr(executor.traceback, 'format_exception',
                        lambda problem: formatted.append(problem) or [''])
    for level in (LoggingSeverity.INFO, LoggingSeverity.DEBUG):
        set_logger_level('ignored', level)
        executor.IgnoredErrors(node).ignore('topic', ValueError('wrong'), 'message ignored')
        assert bool(formatted) == (level == LoggingSeverity.DEBUG)


def test_service_whose_callback_raises_gives_a_failed_response(tmp_path):
    with ros(), nodes_of('peer') as ((peer,), others):
        node = Node('failing')
        for kind, name in ((Trigger, 'one'), (SetBool, 'two')):
            node.create_service(kind, f'~/{name}', raises)
        found = Storm(node, peer, others, 1)
        for kind, name in ((Trigger, 'one'), (SetBool, 'two')):
            response = found.ask(kind, name)
            assert not response.success and response.message == "KeyError: 'unforeseen'"
        node.destroy_node()


def test_response_of_simulation_interfaces_says_that_the_call_failed():
    response = interfaces()['simulation_interfaces.srv'].StepSimulation.Response()
    result = failed_response(None, response, 'why').result
    assert (result.result, result.error_message) == (FAILED, 'why')


def test_parameter_of_an_unknown_type_is_refused_and_those_before_it_are_set(tmp_path):
    unknown = Parameter(name='x', value=ParameterValue(type=99))
    known = Parameter(name='step_count', value=ParameterValue(type=2, integer_value=7))
    with storm('cart_pole', tmp_path) as found:
        first, second, third = found.ask(
            SetParameters, 'set_parameters', parameters=[known, unknown, known]).results
        assert first.successful and not second.successful and not third.successful
        assert_message(second.reason)
        result: SetParametersResult = found.ask(
            SetParametersAtomically, 'set_parameters_atomically', parameters=[unknown]).result
        assert not result.successful and result.reason == second.reason
        assert found.node.settings.step_count == 7


def test_observation_without_names_is_an_unusable_one(tmp_path):
    with storm('twin', tmp_path) as found:
        node: Any = found.node
        heard = next(one for one in node.subscriptions if 'observations' in one.topic_name)
        publisher = found._peer.create_publisher(heard.msg_type, heard.topic_name, 1)
        assert found.spin_until(publisher.get_subscription_count)
        publisher.publish(heard.msg_type())
        hearing = node.topics.subscriptions
        assert found.spin_until(lambda: hearing.ignored['~/observations'])
        assert_message(hearing.reasons['~/observations'])
        assert_goes_on(found)


