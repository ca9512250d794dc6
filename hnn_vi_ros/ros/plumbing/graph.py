# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Discovery of subscribers at the start, and delivery of pending messages at the end."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
import gc
import time

from hnn_vi_ros.errors import listed
from hnn_vi_ros.ros.plumbing.executor import NodeExecutor
from rclpy.duration import Duration
from rclpy.executors import TimeoutException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Switch interval of the interpreter [s]. With Python's default of 5 ms, the serving thread would
# wait that long after each system call, and messages would be late.
THREAD_TURN = 2e-4
# Wall time between two counts of the subscribers [s].
DISCOVERY_PERIOD = 0.02
# Discovery is complete once the number of subscribers has not changed for this time [s].
_DISCOVERY_SILENCE = 0.5
# Timeouts of the delivery of the last messages [s], and the period at which signals are checked.
_MAX_DELIVERY, _MAX_DELIVERY_ENDING = 10.0, 1.0
_DELIVERY_TURN = 0.1


def freeze_memory() -> None:
    """Exclude existing objects from garbage collection, whose pauses would take 0.1 s."""
    # Garbage cycles of an earlier run of the node are unfrozen, so that they are collected.
    gc.unfreeze()
    gc.collect()
    gc.freeze()


class Discovery:
    """
    A wait for existing subscribers, since DDS takes about 1.5 s to discover a node.

    The wait begins with the construction of this object and proceeds in parallel with other work.

    Parameters
    ----------
    subscribers : callable
        Returns the number of subscribers.
    longest : float
        Wall time after which the wait ends in any case [s].

    """

    def __init__(self, subscribers: Callable[[], int], longest: float):
        self._subscribers = subscribers
        self._count, self._since = 0, time.monotonic()
        self._until = self._since + longest

    @property
    def over(self) -> bool:
        """Count the subscribers; return True once discovery is complete."""
        now, found = time.monotonic(), self._subscribers()
        if found != self._count:
            self._count, self._since = found, now
            return False
        return now >= self._until or (found > 0 and now - self._since > _DISCOVERY_SILENCE)


def nodes_of(endpoints: Iterable[TopicEndpointInfo]) -> list[str]:
    """Return the sorted full names of the nodes of some endpoints, one per endpoint."""
    return sorted(f'{one.node_namespace.rstrip("/")}/{one.node_name}' for one in endpoints)


def publisher_conflicts(node: Node, topics: Iterable[str]) -> str:
    """Return a warning that names the topics of a node with several publishers, '' if none has."""
    found = {node.resolve_topic_name(topic): nodes_of(node.get_publishers_info_by_topic(topic))
             for topic in topics}
    return '; '.join(
        f'{topic} has {len(nodes)} publishers, {listed(nodes)}, whose messages are mixed; stop '
        'all but one, or remap their topics' for topic, nodes in found.items() if len(nodes) > 1)


class RepetitionFilter:
    """
    A filter that logs a warning once it is repeated, because the graph changes in steps.

    Parameters
    ----------
    warn : callable
        Logs a warning.

    """

    def __init__(self, warn: Callable[[str], object]):
        self._warn, self._newest, self._told = warn, '', ''

    def __call__(self, text: str) -> str:
        """Return the warning if the call before had the same one, else ''."""
        lasts, self._newest = text == self._newest, text
        if not lasts:
            return ''
        if text and text != self._told:
            self._warn(text)
        self._told = text
        return text


def wait_for_delivery(node: Node, publishers: Iterable[Publisher], received: Sequence[int]
                      ) -> None:
    """
    Wait until matched subscribers have received pending messages, or until a timeout.

    The timeout is ten seconds at the end of a run, and one second after a signal. Topics with
    undelivered messages are then logged.

    Parameters
    ----------
    node : Node
        Node that logs the warning.
    publishers : iterable of Publisher
        Publishers of the messages.
    received : sequence of int
        Received signals; a handler appends to it.

    """
    begin, late = time.monotonic(), []
    for publisher in publishers:
        while not publisher.wait_for_all_acked(Duration(seconds=_DELIVERY_TURN)):
            if time.monotonic() - begin > (_MAX_DELIVERY_ENDING if received else _MAX_DELIVERY):
                late.append(publisher.topic_name)
                break
    if late:
        node.get_logger().warning('a subscriber was too slow to receive all messages of '
                                  f'{", ".join(late)}')


def spin(node: Node, over: Callable[[], object]) -> NodeExecutor:
    """Spin a node until `over` returns true; return the executor, which is then no longer spun."""
    executor = NodeExecutor(node)
    while not over():
        executor.spin_once(timeout_sec=0.1)
    return executor


def take_once(executor: NodeExecutor) -> bool:
    """
    Handle one message of each topic that has one, and resume each waiting handler.

    Parameters
    ----------
    executor : NodeExecutor
        Executor that is not being spun.

    Returns
    -------
    bool
        True if anything was handled.

    """
    taken = False
    with suppress(TimeoutException):
        while True:
            executor.take(0.0)
            taken = True
    return taken
