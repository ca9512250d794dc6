# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Joining the graph and leaving it: subscribers, and messages that are under way by then."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
import gc
import time

from hnn_vi_ros.errors import listed
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo

# How long a thread may hold the interpreter while another one wants it [s]. With Python's 5 ms,
# whoever serves would wait that long after each call to the system, and messages would be late.
THREAD_TURN = 2e-4
# Wall time between two looks at who subscribes [s].
DISCOVERY_PERIOD = 0.02
# Subscribers whose number has not changed for so long are taken for all there are [s].
_SETTLED = 0.5
# Limit on the delivery of the last messages [s], and how often signals are looked for.
_DELIVERY, _DELIVERY_AFTER_SIGNAL = 10.0, 1.0
_DELIVERY_TURN = 0.1


def freeze_memory() -> None:
    """Leave what is there out of every garbage collection, which would stop all for 0.1 s."""
    # Cycles that an earlier run of the node left behind are not there to stay.
    gc.unfreeze()
    gc.collect()
    gc.freeze()


class Discovery:
    """
    Wait for subscribers that are there already: DDS takes some 1.5 s to find a node.

    The wait begins here, when the publishers are made, whatever else is done meanwhile.

    Parameters
    ----------
    subscribers : callable
        Returns their number.
    longest : float
        Wall time after which it is over in any case [s].

    """

    def __init__(self, subscribers: Callable[[], int], longest: float):
        self._subscribers = subscribers
        self._count, self._since = 0, time.monotonic()
        self._until = self._since + longest

    @property
    def over(self) -> bool:
        """Look who is there; return whether that is all."""
        now, found = time.monotonic(), self._subscribers()
        if found != self._count:
            self._count, self._since = found, now
            return False
        return now >= self._until or (found > 0 and now - self._since > _SETTLED)


def nodes_of(endpoints: Iterable[TopicEndpointInfo]) -> list[str]:
    """Return the full names of the nodes that have some endpoints, one for each, in order."""
    return sorted(f'{one.node_namespace.rstrip("/")}/{one.node_name}' for one in endpoints)


def crowded(node: Node, topics: Iterable[str]) -> str:
    """Return which of the topics that a node takes part in have several publishers, if any."""
    found = {node.resolve_topic_name(topic): nodes_of(node.get_publishers_info_by_topic(topic))
             for topic in topics}
    return '; '.join(
        f'{topic} has {len(nodes)} publishers, {listed(nodes)}: their messages mix; end all but '
        'one, or remap its topic' for topic, nodes in found.items() if len(nodes) > 1)


class Lasting:
    """
    Log a warning once, when it has come twice running: a graph changes in steps.

    Parameters
    ----------
    warn : callable
        Logs it.

    """

    def __init__(self, warn: Callable[[str], object]):
        self._warn, self._newest, self._told = warn, '', ''

    def __call__(self, text: str) -> str:
        """Return a warning that lasts; nothing else."""
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
    Let matched subscribers receive what is still on its way, as long as they may need.

    Who is slow has ten seconds at the end of a run, and one where a signal has ended it; what
    some subscriber lacks then is logged.

    Parameters
    ----------
    node : Node
        That logs it.
    publishers : iterable of Publisher
        Whose messages they are.
    received : sequence of int
        The signals that came, to which a handler adds.

    """
    begin, late = time.monotonic(), []
    for publisher in publishers:
        while not publisher.wait_for_all_acked(Duration(seconds=_DELIVERY_TURN)):
            if time.monotonic() - begin > (_DELIVERY_AFTER_SIGNAL if received else _DELIVERY):
                late.append(publisher.topic_name)
                break
    if late:
        node.get_logger().warning('a subscriber was too slow to receive all that was published '
                                  f'of {", ".join(late)}')


def spin(node: Node, over: Callable[[], object]) -> SingleThreadedExecutor:
    """Spin a node until that is over; return the executor, which nobody spins then."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not over():
        executor.spin_once(timeout_sec=0.1)
    return executor


def take_once(executor: SingleThreadedExecutor) -> bool:
    """
    Handle a message of each topic that has one, and go on with each handler that waited.

    Parameters
    ----------
    executor : SingleThreadedExecutor
        That nobody spins.

    Returns
    -------
    bool
        Whether there was anything to do.

    """
    taken = False
    with suppress(TimeoutException):
        while True:
            handler, _, _ = executor.wait_for_ready_callbacks(timeout_sec=0.0)
            handler()
            # Raises what its callback has raised.
            handler.result()
            taken = True
    return taken
