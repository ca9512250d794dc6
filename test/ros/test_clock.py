# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes whose time is that of /clock, and times there that cannot be."""

from collections.abc import Iterable
from itertools import count
from pathlib import Path
import re
import signal
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from hnn_vi_ros import load_scene
from hnn_vi_ros.ros.plumbing import managed_node
from hnn_vi_ros.ros.simulator_node import SimulatorNode
from messages import assert_message
from peer import Peer, peer, ros, simulating, SIMULATOR, stamp, wait_for_way_back
from processes import (
    finish, refusal, simulator_words, standard_error, start, start_executable, wait_until)
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from recorded import assert_agrees, record_run
from rosgraph_msgs.msg import Clock
from scene_files import write_scene
from sensor_msgs.msg import JointState

# Seconds and nanoseconds of times that are none, and of some that jump forth and back.
NONE = ((-1, 0), (-2**31, 0), (-1, 4 * 10**9), (0, 10**9), (2**31 - 1, 2**32 - 1), (5, 2**32 - 1))
JUMPS = ((7, 0), (2**31 - 1, 999_999_999), (0, 0), (2**31 - 1, 0), (1, 5), (1_700_000_000, 0))


def tell(publisher: Publisher, seconds: int, nanoseconds: int) -> None:
    message = Clock()
    message.clock.sec, message.clock.nanosec = seconds, nanoseconds
    publisher.publish(message)


def test_time_that_cannot_be_is_told_and_ends_no_node(tmp_path: Path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 100)
    nodes = {name: start_executable(*words, '-p', 'use_sim_time:=true', folder=tmp_path)
             for name, words in {
                 'hnn_controller': ['controller', '--ros-args'],
                 'hnn_listener': ['listener', '--ros-args'],
                 'hnn_replay': ['replay', bag, '--loop', '--ros-args']}.items()}
    with peer() as other:
        clock = other.publisher(Clock, '/clock', qos_profile_sensor_data)
        other.spin_until(lambda: clock.get_subscription_count() == len(nodes))
        survive(other, clock, nodes)
        for process in nodes.values():
            assert standard_error(process).count('/clock: message ignored') >= 1
            process.send_signal(signal.SIGINT)
        assert [finish(process)[0] for process in nodes.values()] == [0] * len(nodes)


def survive(other: Peer, clock: Publisher, nodes: Iterable[str]) -> None:
    """Assert that nodes answer after each of many times."""
    clients = [[other.node.create_client(kind, f'/{node}/{name}') for node in nodes]
               for kind, name in ((GetParameters, 'get_parameters'),
                                  (SetParameters, 'set_parameters'))]
    other.spin_until(lambda: all(client.service_is_ready() for both in clients for client in both))

    def answers(clients: list, request: object) -> list:
        futures = [client.call_async(request) for client in clients]
        other.spin_until(lambda: all(future.done() for future in futures), 60.0)
        return [future.result() for future in futures]

    for node in nodes:
        wait_for_way_back(other.node, other.spin_until, f'/{node}')
    for at in (*NONE, *JUMPS, *NONE):
        tell(clock, *at)
        other.spin(0.05)
        for answer in answers(clients[0], GetParameters.Request(names=['use_sim_time'])):
            assert answer.values[0].bool_value, at
    # An event of parameters is stamped with the time of the node.
    for value in (False, True):
        for answer in answers(clients[1], SetParameters.Request(parameters=[
                Parameter('use_sim_time', value=value).to_parameter_msg()])):
            assert answer.results[0].successful
    tell(clock, -5, 0)
    other.spin(0.05)


def test_twin_goes_on_whatever_the_clock_says(tmp_path: Path):
    observer = '{kind: observer, coordinates: [angle], gain: 5.0, damping: 4.0}'
    write_scene(tmp_path / 'scene.yaml', 'pendulum', observer, 'implicit_midpoint', q=[0.3])
    ticks = count(1)

    def go_on() -> None:
        nanoseconds = 10**7 * next(ticks)
        tell(clock, nanoseconds // 10**9, nanoseconds % 10**9)

    with simulating(tmp_path, scene='scene.yaml', record_path='bag', use_sim_time=True) as (
            other, process):
        clock = other.publisher(Clock, '/clock', qos_profile_sensor_data)
        machine = other.publisher(JointState, '~/observations', qos_profile_sensor_data)
        errors = other.hear(JointState, '~/prediction_error')
        other.spin_until(lambda: go_on() or (other.states and machine.get_subscription_count()))
        survive(other, clock, [SIMULATOR[1:]])
        had = len(errors)
        machine.publish(JointState(name=['angle'], position=[0.2]))
        other.spin_until(lambda: go_on() or len(errors) > had)
        seen = len(other.states)
        other.spin_until(lambda: go_on() or len(other.states) > seen + 10)
    assert '/clock: message ignored' in standard_error(process)
    assert_agrees(tmp_path / 'bag')


def test_simulator_follows_a_clock_slow_and_fast_in_pauses_steps_and_jumps(tmp_path: Path):
    # A tick is 0.01 s; the clock begins at the epoch, the simulation at zero [ns].
    tick, now, due = 10**7, 1_700_000_000 * 10**9, 0
    with simulating(tmp_path, scene='exact_pendulum', record_path='bag', use_sim_time=True) as (
            other, process):
        other.spin_until(lambda: '/clock has no publisher, but' in standard_error(process))
        clock = other.publisher(Clock, '/clock', qos_profile_sensor_data)

        def set_clock() -> None:
            tell(clock, now // 10**9, now % 10**9)

        def time_of_run() -> int:
            return stamp(other.states[-1]) if other.states else 0

        # What is set before it runs passes: it begins at the first time that it is paced by.
        other.spin_until(clock.get_subscription_count)
        other.spin_until(lambda: set_clock() or 'follows /clock' in standard_error(process))
        for _ in range(20):
            set_clock()
            other.spin(0.05)
        assert not other.states
        # Its lost messages are made up for by later ones, which hold the same time.
        for advance, times in ((tick // 10, 20), (tick, 20), (10 * tick, 20), (9 * 10**9, 1)):
            for _ in range(times):
                now, due = now + advance, due + advance
                set_clock()
                other.spin(0.01)
            other.spin_until(lambda: set_clock() or time_of_run() >= due)
            assert time_of_run() == due
        for _ in range(20):
            set_clock()
            other.spin(0.01)
        now -= 100 * 10**9
        for _ in range(5):
            set_clock()
            other.spin(0.05)
        assert time_of_run() == due
        now, due = now + 50 * tick, due + 50 * tick
        other.spin_until(lambda: set_clock() or time_of_run() >= due)
        assert time_of_run() == due
    assert_agrees(tmp_path / 'bag', due // tick)


def test_first_of_several_publishers_of_the_clock_is_followed_until_it_is_silent(
        capfd, monkeypatch):
    wall = [100.0]
    monkeypatch.setattr(managed_node, 'time', SimpleNamespace(monotonic=lambda: wall[0]))
    with ros('--ros-args', '-p', 'use_sim_time:=true'):
        node = managed_node.RobustNode('follower')
        heed = next(one for one in node.subscriptions if one.topic_name == '/clock').callback

        def now_after(at: float) -> float:
            seconds, rest = divmod(round(at * 1e9), 10**9)
            heed(Clock(clock=Time(sec=seconds, nanosec=rest)))
            return node.get_clock().now().nanoseconds / 1e9

        publishers = [node.create_publisher(Clock, '/clock', 1) for _ in range(2)]
        wait_until(lambda: node.count_publishers('/clock') == 2)
        for k in range(5):
            assert now_after(50.0 + k) == 50.0 + k
            for other in (5.0, 90.0):
                assert now_after(other) == 50.0 + k
            wall[0] += 4.9
        wall[0] += 0.2
        assert now_after(5.0) == 5.0
        # A single one may jump.
        node.destroy_publisher(publishers[0])
        wait_until(lambda: node.count_publishers('/clock') == 1)
        assert now_after(90.0) == 90.0 and now_after(1.0) == 1.0
        node.destroy_node()
    assert capfd.readouterr().err.count('the first is followed') == 1


def test_clock_that_cannot_be_followed_is_one_line():
    for wrong in ({'publish_clock': True}, {'real_time_factor': 0.0}):
        assert_message(refusal('simulator', *simulator_words(use_sim_time=True, **wrong)))


def test_two_simulators_of_one_name_are_told_and_run(tmp_path: Path):
    given = {'scene': 'motor_pendulum', 'publish_clock': True}
    with simulating(tmp_path, record_path='bag0', **given) as (other, _):
        other.wait_for_state('active')
        for _ in range(2):
            other.publisher(JointState, '~/joint_commands')
        second = start(
            tmp_path, duration=4.0, discovery_time=5.0, record_path='bag1', **given)
        status, _, error = finish(second)
    assert status == 0
    for topic, node in (('/joint_states', SIMULATOR), ('/clock', SIMULATOR),
                        (f'{SIMULATOR}/joint_commands', '/peer')):
        assert f'{topic} has 2 publishers, {node}, {node}, whose messages ' in error
    # It has found the first by the time that it begins; whoever else is there counts too.
    assert re.search('[1-9] more nodes of the graph have the name /hnn_simulator: ', error), error
    for i in range(2):
        assert_agrees(tmp_path / f'bag{i}')


def test_two_simulators_in_one_process_do_not_interfere(tmp_path: Path):
    arguments = simulator_words(scene='exact_pendulum', duration=1.0)
    with ros(*arguments):
        nodes, executor = [SimulatorNode(arguments) for _ in range(2)], SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
            executor.create_task(node.autostart)
        wait_until(lambda: executor.spin_once(timeout_sec=0.1) or all(
            node.exit_status is not None for node in nodes))
        assert [node.exit_status for node in nodes] == [0, 0]
        states = [node.run.simulation.q.tolist() + node.run.simulation.p.tolist()
                  for node in nodes]
        assert states[0] == states[1] and nodes[0].run.simulation.time == pytest.approx(1.0)
        for node in nodes:
            assert node.finish() == 0
            node.destroy_node()
