# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Statuses on /diagnostics, and of events and answers, for the tools that every robot has."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.recording import serialize
import numpy as np
from rclpy.node import Node

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# The component of events.
EVENT = 'event'


class Status(NamedTuple):
    """
    Status of one component.

    Parameters
    ----------
    component : str
        Which one.
    level : bytes
        OK, WARN or ERROR.
    message : str
        One plain line.
    values : mapping of str to object
        Figures; units are in the keys.

    """

    component: str
    level: bytes
    message: str
    values: Mapping[str, object]


class DiagnosticsPublisher:
    """
    Publish statuses, stamped like the samples.

    Parameters
    ----------
    node : Node
        The simulator, whose full name each status begins with.
    send : callable
        Publishes a message, and records it with its stamp [ns] unless that is None.
    hardware_id : str
        Subject of the statuses: the scene.

    """

    def __init__(self, node: Node, send: Callable[[bytes, int | None], None], hardware_id: str):
        self._send, self._hardware_id = send, hardware_id
        # With its namespace: /diagnostics is one topic for all simulators.
        self._name = node.get_fully_qualified_name()[1:]

    def publish(self, statuses: Iterable[Status], stamp: int, record: bool = True) -> None:
        """Publish and record all the statuses as of a stamp [ns] in one message."""
        message = DiagnosticArray()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.status = [DiagnosticStatus(
            level=status.level, name=f'{self._name}: {status.component}',
            message=status.message, hardware_id=self._hardware_id,
            values=[KeyValue(key=key, value=f'{one:.6g}' if isinstance(one, float) else str(one))
                    for key, one in status.values.items()])
            for status in statuses]
        self._send(serialize(message), stamp if record else None)


def state_values(coordinates: Sequence[Coordinate], q: np.ndarray, p: np.ndarray
                 ) -> dict[str, str]:
    """Return q and p as values of a status, by their names and with all digits."""
    names, momenta = columns(coordinates)
    return {name: repr(value) for name, value in zip(
        [*names, *(f'p_{name}' for name in momenta)], [*q.tolist(), *p.tolist()], strict=True)}
