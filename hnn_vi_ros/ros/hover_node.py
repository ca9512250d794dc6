# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The example controller: flies the scene quadrotor to a place and holds it there."""

from geometry_msgs.msg import Quaternion, Vector3
from hnn_vi_ros.ros import arguments
from hnn_vi_ros.ros.node_parameters import declare_parameters, refuse_unknown
from hnn_vi_ros.ros.plumbing.managed_node import RobustNode
from hnn_vi_ros.ros.plumbing.starting import own_arguments, plain_ros_errors, ros_process
from hnn_vi_ros.ros.settings import HOVER_PARAMETERS, HoverSettings
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from std_msgs.msg import Float64MultiArray

# The scene quadrotor has these values.
MASS, GRAVITY, INERTIA = 0.8, 9.81, np.array([0.006, 0.006, 0.011])
# Natural frequencies [rad/s] of place and attitude, and the damping ratio of both.
PLACE_RATE, TURN_RATE, DAMPING = 1.5, 9.0, 0.9
# From further away than this it comes no faster [m].
REACH = 2.0


def commands_of(message: Odometry, place: np.ndarray) -> np.ndarray:
    """
    Return the thrust [N] and three torques [N m] that lead to a place, without turning to a side.

    A force carries the weight and pulls like a damped spring to the place; it is the third axis
    of the attitude that another damped spring turns the body to.

    References
    ----------
    T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE
    CDC 2010.

    """
    pose, twist = message.pose.pose, message.twist.twist
    R, omega = matrix(pose.orientation), vector(twist.angular)
    away, velocity = vector(pose.position) - place, R @ vector(twist.linear)
    away *= min(1.0, REACH / max(float(np.linalg.norm(away)), REACH))
    force = MASS * (np.array([0.0, 0.0, GRAVITY]) - PLACE_RATE**2 * away
                    - 2.0 * DAMPING * PLACE_RATE * velocity)
    up = force / np.linalg.norm(force)
    left = np.cross(up, [1.0, 0.0, 0.0])
    left /= np.linalg.norm(left)
    wanted = np.column_stack([np.cross(left, up), left, up])
    turned = 0.5 * (wanted.T @ R - R.T @ wanted)
    error = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
    torques = -INERTIA * (TURN_RATE**2 * error + 2.0 * DAMPING * TURN_RATE * omega)
    # Its rotors only push.
    return np.array([max(0.0, force @ R[:, 2]), *torques])


def vector(numbers: Vector3) -> np.ndarray:
    """Return a vector of a message."""
    return np.array([numbers.x, numbers.y, numbers.z])


def matrix(turn: Quaternion) -> np.ndarray:
    """Return the matrix that takes vectors of the body to space."""
    axis = vector(turn)
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + 2.0 * (turn.w * cross + cross @ cross)


class Hover(RobustNode):
    """Answer each odometry with one command."""

    def __init__(self) -> None:
        super().__init__('hnn_hover', automatically_declare_parameters_from_overrides=True)
        place = declare_parameters(self, HoverSettings)
        self._place = np.array([place.x, place.y, place.z])
        self._commands = self.create_publisher(Float64MultiArray, '/hnn_simulator/commands', 1)
        self.create_subscription(Odometry, '/hnn_simulator/odometry', self._on_odometry, 1)

    def _on_odometry(self, message: Odometry) -> None:
        self._commands.publish(Float64MultiArray(data=commands_of(message, self._place)))


def main(argv: list[str]) -> None:
    """Control until the node is stopped."""
    arguments.hover().parse_args(own_arguments(argv))
    with ros_process(argv) as received:
        with plain_ros_errors('ROS'):
            node = Hover()
        refuse_unknown(node, HOVER_PARAMETERS, (), argv)
        while not received:
            rclpy.spin_once(node, timeout_sec=0.1)
