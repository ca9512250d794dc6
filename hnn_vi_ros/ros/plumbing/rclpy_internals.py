# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Internals of rclpy that this package uses, for lack of a public alternative.

The error UnknownROSArgsError and the type of a node's logger have no public names.
The default handler of ``change_state`` lets the error of an illegal transition end the process;
the only remedy is another callback of the same service. A subscription passes one message to its
callback, and gives no access to the other waiting ones. Loggers write to the terminal directly
and not through the streams of Python; of the service ``get_type_description``, rcl itself logs the
texts of requests.
"""

from collections.abc import Callable, Iterator
import re
from typing import Any, TYPE_CHECKING

from hnn_vi_ros.errors import printable
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.type_description_service import TypeDescriptionService

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNodeMixin

UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError
Logger = RcutilsLogger


_TYPE_HASH = re.compile('RIHS01_[0-9a-f]{64}')
_write_to_log = rclpy_implementation.rclpy_logging_rcutils_log
_describe = TypeDescriptionService._service_callback


def log_plainly() -> None:
    """Write each log entry as one line of printable characters; see errors.printable."""
    rclpy_implementation.rclpy_logging_rcutils_log = _write_plainly
    TypeDescriptionService._service_callback = (  # type: ignore[method-assign]
        _describe_plainly)


def _write_plainly(severity: int, name: str, message: str, *place: Any) -> None:
    _write_to_log(severity, name, printable(message), *place)


def _describe_plainly(service: TypeDescriptionService, request: Any, response: Any) -> Any:
    if not _TYPE_HASH.fullmatch(request.type_hash):
        response.failure_reason = 'type_hash: expected RIHS01_ and 64 hexadecimal digits'
        return response
    request.type_name = printable(request.type_name[:200])
    return _describe(service, request, response)


def answer_changes(node: 'LifecycleNodeMixin', callback: Callable[..., Any]) -> None:
    """Replace the callback of the service ``change_state`` of a node."""
    node._service_change_state.callback = callback


def state_machine(node: 'LifecycleNodeMixin') -> Any:
    """Return the state machine of a node: its state and its available transitions."""
    return node._state_machine


def log(node: Node, text: str, level: str) -> None:
    """Log a line; level is INFO, WARN or ERROR."""
    # On separate lines, since rclpy allows one severity per calling line.
    if level == 'INFO':
        node.get_logger().info(text)
    elif level == 'WARN':
        node.get_logger().warning(text)
    else:
        node.get_logger().error(text)


def take_waiting(subscription: Subscription) -> Iterator[Any]:
    """Take and yield the waiting messages of a subscription, in the form its callback gets."""
    while True:
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if found is None:
            return
        yield found[0]
