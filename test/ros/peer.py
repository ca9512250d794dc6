# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Another node in the graph of a simulator: what users do to it, and what they see."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from executables import Executable
from lifecycle_msgs.srv import ChangeState, GetState
from processes import finish, start
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from recorded import TICK_TYPES
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

SIMULATOR = '/hnn_simulator'
# Transitions and states by number, as lifecycle_msgs has them.
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
UNCONFIGURED_SHUTDOWN, INACTIVE_SHUTDOWN, ACTIVE_SHUTDOWN = 5, 6, 7


def wait_for_way_back(
        node: Node, spin_until: Callable[[Callable[[], Any]], None], server: str) -> None:
    """
    Wait until another node has discovered all that was made here.

    It drops a response whose reader it does not know yet, and readers become known in the order
    in which they were made: the first response that comes to a new one shows it.
    """
    probe = node.create_client(ListParameters, f'{server}/list_parameters')
    spin_until(probe.service_is_ready)
    futures: list[Any] = []
    begin = time.monotonic()

    def answered() -> bool:
        if len(futures) < time.monotonic() - begin:
            futures.append(probe.call_async(ListParameters.Request()))
        return any(future.done() for future in futures)

    spin_until(answered)
    node.destroy_client(probe)


class Peer:
    """A node that calls the simulator's services and hears its joint states."""

    def __init__(self):
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self.states: list[JointState] = self.hear(JointState, '/joint_states', QoSProfile(
            depth=10_000, reliability=ReliabilityPolicy.RELIABLE))

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def spin(self, seconds: float = 0.0) -> None:
        """Hear what there is, for a while."""
        deadline = time.monotonic() + seconds
        while True:
            self.executor.spin_once(timeout_sec=max(0.0, min(0.05, deadline - time.monotonic())))
            if time.monotonic() >= deadline:
                return

    def spin_until(self, condition: Callable[[], Any], timeout: float = 300.0) -> None:
        """Hear what there is until the condition holds."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, 'timed out'
            self.executor.spin_once(timeout_sec=0.05)

    def hear(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """Return a list of what comes on a topic from now on; ~ is the simulator."""
        messages: list[Any] = []
        self.node.create_subscription(
            kind, topic.replace('~', SIMULATOR), messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str, qos: QoSProfile | int = 1) -> Publisher:
        """Return a publisher of a topic; ~ is the simulator."""
        return self.node.create_publisher(kind, topic.replace('~', SIMULATOR), qos)

    def call_async(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service; return the future of the response."""
        return self.client(kind, name).call_async(kind.Request(**fields))

    def client(self, kind: type, name: str) -> Any:
        """Return the client of a service, of the simulator unless the name is full, ready."""
        if name not in self._clients:
            full = name if name.startswith('/') else f'{SIMULATOR}/{name}'
            self._clients[name] = self.node.create_client(kind, full)
            self.spin_until(self._clients[name].service_is_ready)
            wait_for_way_back(self.node, self.spin_until, full.rpartition('/')[0])
        self.spin_until(self._clients[name].service_is_ready)
        return self._clients[name]

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service and wait for the response."""
        future = self.call_async(kind, name, **fields)
        self.spin_until(future.done)
        return future.result()

    def trigger(self, name: str) -> Trigger.Response:
        """Call a Trigger service."""
        return self.call(Trigger, name)

    def pause(self, paused: bool = True) -> SetBool.Response:
        """Pause the simulator, or let it go on."""
        return self.call(SetBool, 'set_pause', data=paused)

    def change_state(self, transition: int) -> bool:
        """Ask for a transition."""
        request = ChangeState.Request()
        request.transition.id = transition
        return self.call(ChangeState, 'change_state', transition=request.transition).success

    @property
    def state(self) -> str:
        """Return the label of the simulator's state."""
        return self.call(GetState, 'get_state').current_state.label

    def topics_of(self, node: str = SIMULATOR) -> tuple[set[str], set[str]]:
        """Return what a node publishes and what it hears."""
        name = node[1:], '/'
        self.spin_until(lambda: name in self.node.get_node_names_and_namespaces())
        return tuple({topic for topic, _ in find(*name)} for find in (
            self.node.get_publisher_names_and_types_by_node,
            self.node.get_subscriber_names_and_types_by_node))

    def wait_for_state(self, label: str) -> None:
        """Wait until the simulator is in a state."""
        self.spin_until(lambda: self.state == label)

    def set_parameters(self, **values: object) -> SetParametersResult:
        """Set parameters of the simulator together."""
        return self.call(SetParametersAtomically, 'set_parameters_atomically', parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]).result

    def get_parameter(self, name: str) -> object:
        """Return the value of a parameter of the simulator."""
        value, = self.call(GetParameters, 'get_parameters', names=[name]).values
        return rclpy.parameter.parameter_value_to_python(value)


class Listener(Peer):
    """A peer that keeps the serialised messages of each tick, with the wall time of each [ns]."""

    def __init__(self, depth: int = 10_000):
        super().__init__()
        self.heard: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in TICK_TYPES}
        for topic, kind in TICK_TYPES.items():
            self.node.create_subscription(
                kind, topic, lambda data, topic=topic: self.heard[topic].append(
                    (time.monotonic_ns(), bytes(data))), depth, raw=True)

    @property
    def received(self) -> dict[str, list[bytes]]:
        """Return the messages by their topic."""
        return {topic: [data for _, data in heard] for topic, heard in self.heard.items()}

    @property
    def counts(self) -> set[int]:
        """Return how many messages the topics have had."""
        return {len(messages) for messages in self.heard.values()}


@contextmanager
def peer(kind: Callable[[], Peer] = Peer) -> Iterator[Any]:
    """Enter the graph for a while."""
    found = kind()
    try:
        yield found
    finally:
        found.close()


@contextmanager
def simulating(folder: Path, **parameters: object) -> Iterator[tuple[Peer, Executable]]:
    """Start a simulator, give another node and it, and let SIGINT end it."""
    process = start(folder, **parameters)
    with peer() as other:
        yield other, process
        process.send_signal(signal.SIGINT)
        assert finish(process)[0] == 0


@contextmanager
def ros(*arguments: str) -> Iterator[list[str]]:
    """Initialise ROS in this process by arguments, which are given, and shut it down."""
    rclpy.init(args=[*arguments], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield [*arguments]
    finally:
        rclpy.try_shutdown()


@contextmanager
def nodes_of(*names: str) -> Iterator[tuple[list[Node], SingleThreadedExecutor]]:
    """Give nodes in a context of their own, and the executor of all."""
    context = Context()
    rclpy.init(context=context)
    nodes = [rclpy.create_node(name, context=context) for name in names]
    executor = SingleThreadedExecutor(context=context)
    for node in nodes:
        executor.add_node(node)
    try:
        yield nodes, executor
    finally:
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.shutdown(context=context)


@contextmanager
def hearing(kind: type, topic: str) -> Iterator[tuple[list, SingleThreadedExecutor]]:
    """Give what another node hears on a topic, and its executor."""
    with nodes_of('subscriber') as ((node,), executor):
        messages: list = []
        node.create_subscription(kind, topic, messages.append, 10)
        yield messages, executor


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a diagnostic status."""
    return {item.key: item.value for item in status.values}


def stamp(message: JointState) -> int:
    """Return the stamp of a message [ns]."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def state_of(message: JointState) -> tuple[float, ...]:
    """Return positions and velocities."""
    return *message.position, *message.velocity
