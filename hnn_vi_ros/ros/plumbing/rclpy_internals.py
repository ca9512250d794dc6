# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Internals of rclpy that are used; nothing public of it does the same.

Its errors RCLError and UnknownROSArgsError have no public name, and neither has the type of a
node's logger. A managed node's own handler of ``change_state`` lets the error of an illegal
transition end the process, which is prevented only by an answer of ours from the same service.
A callback gets one message, and none of the others that wait.
What its loggers write goes past the streams of Python.
"""

from collections.abc import Callable, Iterator
from typing import Any, TYPE_CHECKING

from hnn_vi_ros.errors import printable
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.subscription import Subscription

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNodeMixin

RCLError = rclpy_implementation.RCLError
UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError
Logger = RcutilsLogger


_write_to_log = rclpy_implementation.rclpy_logging_rcutils_log


def log_plainly() -> None:
    """Let each entry of the log be one line that any terminal shows; see errors.printable."""
    rclpy_implementation.rclpy_logging_rcutils_log = _write_plainly


def _write_plainly(severity: int, name: str, message: str, *place: Any) -> None:
    _write_to_log(severity, name, printable(message), *place)


def answer_changes(node: 'LifecycleNodeMixin', callback: Callable[..., Any]) -> None:
    """Let a callback answer the service ``change_state`` of a node."""
    node._service_change_state.callback = callback


def state_machine(node: 'LifecycleNodeMixin') -> Any:
    """Return the state machine of a node: its state, and what it can be asked for."""
    return node._state_machine


def log(node: Node, text: str, level: str) -> None:
    """Log a line; level is INFO, WARN or ERROR."""
    # On lines of their own: rclpy ties the line of a call to one severity.
    if level == 'INFO':
        node.get_logger().info(text)
    elif level == 'WARN':
        node.get_logger().warning(text)
    else:
        node.get_logger().error(text)


def waiting(subscription: Subscription) -> Iterator[Any]:
    """Take the messages of a subscription that wait, as its callback would get them."""
    while True:
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if found is None:
            return
        yield found[0]
