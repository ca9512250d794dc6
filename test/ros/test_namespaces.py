# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Two simulators in one graph, each in a namespace of its own, and the nodes beside them."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros import load_scene
from hnn_vi_ros.bags.cdr import serialize
from hnn_vi_ros.ros.controller_node import ControllerNode
from hnn_vi_ros.ros.listener_node import Listener
from hnn_vi_ros.ros.rerun_bridge import BridgePicture, RerunBridge
from lifecycle_msgs.srv import GetState
from peer import peer, wait_for_way_back
from processes import finish, read_bag, start, to_file
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

SCENES = {'left': 'exact_pendulum', 'right': 'exact_harmonic_oscillator'}


def test_two_simulators_in_two_namespaces_answer_and_do_not_interfere(tmp_path):
    heard = {namespace: [] for namespace in SCENES}
    processes = [start(tmp_path, scene=scene, duration=2, record_path=namespace, discovery_time=20,
                       __ns=f'/{namespace}',
                       **{f'qos_overrides./{namespace}/hnn_simulator/q.publisher.depth': 1000})
                 for namespace, scene in SCENES.items()]
    with peer() as other:
        for namespace, messages in heard.items():
            other.node.create_subscription(
                Float64MultiArray, f'/{namespace}/hnn_simulator/q',
                lambda m, to=messages: to.append(m.data.tolist()), 1000)
        for namespace in SCENES:
            client = other.node.create_client(GetState, f'/{namespace}/hnn_simulator/get_state')
            wait_for_way_back(other.node, other.spin_until, f'/{namespace}/hnn_simulator')
            future = client.call_async(GetState.Request())
            other.spin_until(future.done)
            assert future.result().current_state.label in ('configuring', 'inactive', 'active')
        other.spin_until(lambda: all(process.poll() is not None for process in processes))
        other.spin(0.5)
    assert [finish(process)[0] for process in processes] == [0, 0]
    for namespace in SCENES:
        recorded = read_bag(tmp_path / namespace)
        assert {topic for topic in recorded if not topic.startswith(f'/{namespace}/')} <= {
            '/diagnostics'}
        assert heard[namespace] == [
            message.data.tolist() for _, message in recorded[f'/{namespace}/hnn_simulator/q']]
        assert len(heard[namespace]) == 200
    assert heard['left'] != heard['right']


@pytest.mark.parametrize(('name', 'found'), [
    ('hnn_simulator', '/left/hnn_simulator'), ('/right/arm', '/right/arm')])
def test_nodes_beside_a_simulator_take_that_of_their_own_namespace(tmp_path, name, found):
    arguments = [*to_file(tmp_path / 'a.rrd'), '-r', '__ns:=/left', '-p', f'simulator:={name}']
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        nodes = bridge, listener = RerunBridge(arguments), Listener()
        assert {*bridge._topics} > {
            f'{found}/scene', f'{found}/state', '/left/hnn_controller/plan'}
        assert [one.topic_name for one in listener.subscriptions] == ['/left/hnn_simulator/energy']
        for node in nodes:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    arguments = ['--ros-args', '-r', '__ns:=/left', '-p', f'simulator:={name}']
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        controller = ControllerNode(arguments)
        assert controller._topic == f'{found}/joint_commands'
        controller.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_message_that_a_bridge_cannot_show_is_told_and_ignored(tmp_path, capfd):
    arguments = to_file(tmp_path / 'a.rrd')
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        bridge = RerunBridge(arguments)
        bridge._picture = BridgePicture(load_scene('exact_pendulum'), tmp_path / 'b.rrd', 'b')
        timing, event = DiagnosticArray(status=[DiagnosticStatus(
            name='hnn_simulator: timing', values=[KeyValue(key='real_time_factor', value='fast')])
        ]), DiagnosticArray(status=[DiagnosticStatus(name='hnn_simulator: event')])
        plan = JointTrajectory(joint_names=['angle'])
        plan.header.stamp.nanosec = event.header.stamp.nanosec = 2**32 - 1
        bridge.listen()
        hear = {one.topic_name: one.callback for one in bridge.subscriptions}
        short = JointState(name=['H', 'work'], position=[1.0])
        for topic, message in (
                ('/diagnostics', timing), ('/hnn_simulator/events', event),
                ('/hnn_controller/plan', plan), ('/hnn_simulator/state', short)):
            hear[topic](serialize(message))
            hear[topic](b'none')
        log = capfd.readouterr().err
        assert all(f'{topic}: message ignored: ' in log for topic in (
            '/diagnostics', '/hnn_simulator/events', '/hnn_controller/plan',
            '/hnn_simulator/state'))
        assert bridge.problem is None
        bridge.close()
        bridge.destroy_node()
    finally:
        rclpy.try_shutdown()
