# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The health of a run on /diagnostics, for the tools that every robot has."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros.ros.messages import describe_topic
from hnn_vi_ros.run.serialization import serialize
from rclpy.node import Node
from rclpy.publisher import Publisher

DIAGNOSTICS_TOPIC: tuple[str, type] = ('/diagnostics', DiagnosticArray)
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


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
    publisher : Publisher
        Of diagnostic_msgs/DiagnosticArray.
    hardware_id : str
        Subject of the statuses: the scene.

    Attributes
    ----------
    topic : Topic
        Description of the topic for the log.

    """

    def __init__(self, node: Node, publisher: Publisher, hardware_id: str):
        self._publisher, self._hardware_id = publisher, hardware_id
        # With its namespace: /diagnostics is one topic for all simulators.
        self._name = node.get_fully_qualified_name()[1:]
        self.topic = describe_topic(
            publisher.topic_name, DiagnosticArray, publisher.qos_profile)

    def publish(self, statuses: Iterable[Status], stamp: int) -> bytes:
        """Publish all the statuses as of a stamp [ns] in one message; return the bytes sent."""
        message = DiagnosticArray()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.status = [DiagnosticStatus(
            level=status.level, name=f'{self._name}: {status.component}',
            message=status.message, hardware_id=self._hardware_id,
            values=[KeyValue(key=key, value=_shown(value))
                    for key, value in status.values.items()])
            for status in statuses]
        payload = serialize(message)
        self._publisher.publish(payload)
        return payload


def _shown(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
