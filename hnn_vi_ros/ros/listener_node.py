# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An example subscriber: prints the energy of a running simulator once a second."""

from hnn_vi_ros.ros import arguments
from hnn_vi_ros.ros.node_parameters import refuse_unknown
from hnn_vi_ros.ros.plumbing.graph import spin
from hnn_vi_ros.ros.plumbing.managed_node import RobustNode
from hnn_vi_ros.ros.plumbing.starting import own_arguments, plain_ros_errors, ros_process
from std_msgs.msg import Float64


class Listener(RobustNode):
    """Subscriber that logs every hundredth energy."""

    def __init__(self) -> None:
        super().__init__('hnn_listener', automatically_declare_parameters_from_overrides=True)
        self._count = 0
        self.create_subscription(Float64, 'hnn_simulator/energy', self._on_energy, 10)

    def _on_energy(self, message: Float64) -> None:
        if self._count % 100 == 0:
            self.get_logger().info(f'sample {self._count}: H = {message.data:.6f}')
        self._count += 1


def main(argv: list[str]) -> None:
    """Listen until the node is stopped."""
    arguments.listener().parse_args(own_arguments(argv))
    with ros_process(argv) as received:
        with plain_ros_errors():
            node = Listener()
        refuse_unknown(node, (), (), argv)
        spin(node, lambda: received)
