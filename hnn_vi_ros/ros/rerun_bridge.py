# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Show a running simulator, or a bag, in rerun without a hand in the simulation's process."""

import argparse
from collections.abc import Callable
from pathlib import Path
import signal
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.ros.accuracy import ACCURACY_TOPIC
from hnn_vi_ros.ros.bridge_parameters import PARAMETERS, target_of
from hnn_vi_ros.ros.bridge_picture import BridgePicture, NEEDED
from hnn_vi_ros.ros.diagnostics_publisher import DIAGNOSTICS_TOPIC
from hnn_vi_ros.ros.graph import init_ros
from hnn_vi_ros.ros.messages import TICK_TOPICS
from hnn_vi_ros.ros.parameters import declare_parameters
from hnn_vi_ros.ros.recorded_run import RecordedRun
from hnn_vi_ros.sinks.rerun_stream import Target
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String
import yaml

_QUEUE = QoSProfile(depth=1000)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# Ticks of which not all messages are there yet.
_MOST_OPEN = 1000


class RerunBridge(Node):
    """
    Show the topics of a simulator.

    The messages of one tick are put together by the number that the middleware gives each message
    of a topic: the simulator publishes every tick topic once a tick.

    Attributes
    ----------
    problem : HnnViRosError or None
        Why nothing can be shown any more.

    """

    def __init__(self):
        super().__init__('hnn_rerun_bridge')
        self._values = declare_parameters(self, PARAMETERS)
        self.target = target_of(self._values)
        self.problem: HnnViRosError | None = None
        self._described, self._scenes = '', 0
        self._picture: BridgePicture | None = None
        self._open: dict[int, dict[str, Any]] = {}
        self._names = NEEDED

    def listen(self) -> None:
        """Subscribe to the scene and the topics of a tick."""
        simulator = self._values['simulator']
        self.create_subscription(String, f'{simulator}/scene', self._on_scene, _LATCHED)
        for name, kind in (*TICK_TOPICS, ACCURACY_TOPIC):
            last = name.rpartition('/')[2]
            self.create_subscription(
                kind, name.replace('~', simulator), self._keeper(last), _QUEUE)
        name, kind = DIAGNOSTICS_TOPIC
        self.create_subscription(
            kind, name, lambda message: self._tell(message, simulator), _QUEUE)

    def show_bag(self, bag: Path) -> int:
        """Show all samples of a bag; return their number."""
        run = RecordedRun(bag)
        picture = BridgePicture(run.described, f'{run.reader.path}: its scene.yaml', self.target,
                                bag.resolve().name)
        self._picture = picture
        kinds = {name.rpartition('/')[2]: kind
                 for name, kind in (*TICK_TOPICS, ACCURACY_TOPIC, DIAGNOSTICS_TOPIC)}
        names = {number: channel.topic.rpartition('/')[2]
                 for number, channel in run.reader.channels.items()}
        simulator = next((channel.topic.rpartition('/')[0] for channel in
                          run.reader.channels.values() if channel.topic.endswith('/q')), '')
        tick, stamp = {}, -1
        for message in run.reader.messages(
                [number for number, name in names.items() if name in kinds]):
            if message.time != stamp:
                self._show(tick)
                tick, stamp = {}, message.time
            name = names[message.channel]
            content = deserialize_message(message.data, kinds[name])
            if name == 'diagnostics':
                # An alarm belongs to the sample of its time, which is there by now.
                self._show(tick)
                tick = {}
                self._tell(content, simulator)
            else:
                tick[name] = content
        self._show(tick)
        return picture.samples

    def close(self) -> None:
        """Send what is left."""
        if self._picture is not None:
            self._picture.close()
            self._picture = None

    def _on_scene(self, message: String) -> None:
        """Begin a picture; a scene that is published again, or another, begins a new one."""
        if message.data == self._described:
            return
        self._described = message.data
        try:
            self.close()
            described = yaml.safe_load(message.data)
            self._scenes += 1
            self._picture = BridgePicture(described, '~/scene', self._next_target(), 'bridge')
            shown = f'port {self.target}' if isinstance(self.target, int) else self.target
            self.get_logger().info(f'showing {self._values["simulator"]} on {shown}')
        except HnnViRosError as problem:
            self.problem = problem
        except (yaml.YAMLError, TypeError, AttributeError) as problem:
            self.get_logger().error(f'~/scene is no scene: {" ".join(str(problem).split())}')

    def _next_target(self) -> Target:
        target = self.target
        if isinstance(target, Path) and self._scenes > 1:
            return target.with_name(f'{target.stem}-{self._scenes}{target.suffix}')
        return target

    def _keeper(self, name: str) -> Callable:
        """Return what takes the messages of a topic."""
        def keep(message: Any, info: dict) -> None:
            if name not in self._names:
                # It is published after all.
                self._names = self._names | {name}
            number = info['publication_sequence_number']
            tick = self._open.setdefault(number, {})
            tick[name] = message
            if self._names <= tick.keys():
                del self._open[number]
                self._show(tick)
            elif len(self._open) > _MOST_OPEN:
                # Some message of an old tick will not come any more.
                del self._open[min(self._open)]
        return keep

    def _show(self, tick: dict[str, Any]) -> None:
        if self._picture is not None and NEEDED <= tick.keys():
            try:
                self._picture.show(tick)
            except HnnViRosError as problem:
                self.problem = problem

    def _tell(self, message: DiagnosticArray, simulator: str) -> None:
        if self._picture is not None:
            self._picture.tell(message, simulator)


def main(argv: list[str]) -> int:
    """Show a simulator until SIGINT or SIGTERM, or a bag until it is shown."""
    parser = argparse.ArgumentParser(prog='rerun_bridge', description=__doc__)
    parser.add_argument('bag', type=Path, nargs='?', metavar='BAG', help=(
        'folder of a bag, or its .mcap file, to show in place of a running simulator'))
    bag = parser.parse_args(remove_ros_args(argv)).bag
    init_ros(argv)
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: received.append(number))
    try:
        node = RerunBridge()
        try:
            if bag is None:
                _show_simulator(node, received)
            else:
                _show_bag(node, bag, received)
        finally:
            node.close()
        if node.problem is not None:
            raise node.problem
    finally:
        rclpy.try_shutdown()
    return 0


def _show_simulator(node: RerunBridge, received: list[int]) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.listen()
    while not received and node.problem is None:
        executor.spin_once(timeout_sec=0.1)


def _show_bag(node: RerunBridge, bag: Path, received: list[int]) -> None:
    node.get_logger().info(f'{node.show_bag(bag)} samples shown')
    if isinstance(node.target, int):
        node.get_logger().info(f'viewers can connect to port {node.target} until Ctrl-C')
        while not received:
            time.sleep(0.1)
