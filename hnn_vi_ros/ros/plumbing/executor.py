# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An executor that continues after any exception of a callback, and the report of their errors."""

from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from inspect import isawaitable
import math
import time
import traceback
from typing import Any

from hnn_vi_ros.errors import HnnViRosError, printable
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.service import Service

# Maximum length of a reason [characters]: room for the names of twelve joints and a remedy.
LONGEST_REASON = 500
# Minimum wall time between two log lines about the same topic, service or timer [s].
_LOG_PERIOD = 1.0
# Fields of responses that hold a reason.
_REASONS = ('message', 'reason', 'error_message', 'failure_reason')


class IgnoredErrors:
    """
    Messages and calls that were ignored because handling them raised an error.

    Parameters
    ----------
    node : Node
        Node that logs them.

    Attributes
    ----------
    ignored : Counter of str
        Their number, by name of the topic, service or timer.
    reasons : dict of str to str
        Reason for ignoring the last one, by name.

    """

    def __init__(self, node: Node):
        self._node = node
        self.ignored: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        # Time of the next permitted log line, by name [s].
        self._due: dict[str, float] = {}

    def ignore(self, name: str, problem: Exception, what: str = 'message ignored') -> str:
        """Count an error and log it, at most once a second for each name; return the reason."""
        known = isinstance(problem, HnnViRosError | ValueError | RuntimeError)
        text = f'{"" if known else f"{type(problem).__name__}: "}{problem}'
        self.ignored[name] += 1
        reason = self.reasons[name] = printable(' '.join(text.split())[:LONGEST_REASON])
        if (now := time.monotonic()) >= self._due.get(name, -math.inf):
            self._due[name] = now + _LOG_PERIOD
            logger = self._node.get_logger()
            logger.error(f'{name}: {what}: {reason} ({self.ignored[name]} so far)')
            # Formatting calls ast.parse, which raises SystemError in Python 3.11 if another
            # thread, such as that of a configuration, calls it as well.
            if logger.is_enabled_for(LoggingSeverity.DEBUG):
                logger.debug(''.join(traceback.format_exception(problem)))
        return reason


class NodeExecutor(SingleThreadedExecutor):
    """
    Executor of one node that continues after any exception of a callback.

    The error is counted and logged, and the caller of a service gets a failed response. Errors of
    tasks of this package, such as a failed configuration, are raised.

    Parameters
    ----------
    node : Node
        The node, with all its services.

    Attributes
    ----------
    errors : Ignored
        Errors of the callbacks.

    """

    def __init__(self, node: Node):
        super().__init__()
        self.errors = IgnoredErrors(node)
        for service in node.services:
            answering: Any = self._answering(service)
            service.callback = answering
        self.add_node(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for a callback and execute it."""
        with suppress(TimeoutException, ShutdownException):
            self.take(timeout_sec)

    def take(self, timeout_sec: float | None) -> None:
        """Wait for a callback and execute it; raise TimeoutException if there is none."""
        ready: Any = self.wait_for_ready_callbacks(timeout_sec=timeout_sec)
        handler, entity, _ = ready
        handler()
        try:
            handler.result()
        except Exception as problem:
            if entity is None:
                raise
            self.errors.ignore(_name(entity), problem, 'error ignored')

    def _answering(self, service: Service) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return the callback of a service, which answers also if it raises an error."""
        callback = service.callback

        async def answer(request: Any, response: Any) -> Any:
            try:
                found = callback(request, response)
                return await found if isawaitable(found) else found
            except Exception as problem:
                reason = self.errors.ignore(service.service_name, problem, 'call failed')
                return failed_response(request, response, reason)
        return answer


def failed_response(request: Any, response: Any, reason: str) -> Any:
    """Return a response of any type as that of a failed call, with the reason."""
    if hasattr(response, 'results'):
        # The parameters before the one that cannot be read have been set.
        left = len(request.parameters) - len(response.results)
        response.results = [
            *response.results, *[SetParametersResult(successful=False, reason=reason)] * left]
    part = getattr(response, 'result', response)
    values = {'success': False, 'successful': False, **dict.fromkeys(_REASONS, reason)}
    if code := getattr(type(part), 'RESULT_OPERATION_FAILED', None):
        values['result'] = code
    for name in filter(partial(hasattr, part), values):
        setattr(part, name, values[name])
    return response


def _name(entity: Any) -> str:
    """Return the name of a topic or a service, or that of a timer's callback."""
    callback = getattr(entity, 'callback', type(entity))
    return str(getattr(entity, 'topic_name', None) or getattr(entity, 'service_name', None)
               or getattr(callback, '__qualname__', callback))
