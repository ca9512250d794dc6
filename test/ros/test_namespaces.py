# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Two simulators in one graph, each in a namespace of its own."""

from lifecycle_msgs.srv import GetState
from peer import peer, wait_for_way_back
from processes import finish, read_bag, start
from std_msgs.msg import Float64MultiArray

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
