# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses for /diagnostics, ~/events and answers, as standard ROS tools read them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.recording import serialize
import numpy as np
from rclpy.node import Node

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# Name of the component that reports events.
EVENT = 'event'


class Status(NamedTuple):
    """
    Status of one component.

    Parameters
    ----------
    component : str
        Name of the component.
    level : bytes
        OK, WARN or ERROR.
    message : str
        Plain text of one line.
    values : mapping of str to object
        Values by key; the keys include the units.

    """

    component: str
    level: bytes
    message: str
    values: Mapping[str, object]


class DiagnosticsPublisher:
    """
    Publisher of diagnostic statuses, stamped like the samples.

    Parameters
    ----------
    node : Node
        The simulator node; its fully qualified name prefixes the name of each status.
    send : callable
        Publishes a message, and records it if its stamp [ns] is not None.
    hardware_id : str
        Hardware ID of the statuses: the scene.

    """

    def __init__(self, node: Node, send: Callable[[bytes, int | None], None], hardware_id: str):
        self._send, self._hardware_id = send, hardware_id
        # The name includes the namespace, since all simulators share /diagnostics.
        self._name = node.get_fully_qualified_name()[1:]

    def publish(self, statuses: Iterable[Status], stamp: int, record: bool = True) -> None:
        """Publish all statuses in one message with this stamp [ns]; record it if asked."""
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
    """Return q and p as values of a status: full-precision strings keyed by name."""
    names, momenta = columns(coordinates)
    return {name: repr(value) for name, value in zip(
        [*names, *(f'p_{name}' for name in momenta)], [*q.tolist(), *p.tolist()], strict=True)}
