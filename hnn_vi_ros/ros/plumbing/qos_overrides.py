# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""QoS policies set by parameters, ``qos_overrides.<topic>.publisher.<policy>``."""

from collections.abc import Callable, Iterable
from copy import copy
from typing import Any, Literal, NamedTuple

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSPolicyKind, QoSProfile,
    ReliabilityPolicy)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

PREFIX = 'qos_overrides.'
_NAMED = {'durability': DurabilityPolicy, 'history': HistoryPolicy,
          'reliability': ReliabilityPolicy, 'liveliness': LivelinessPolicy}
_DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')
POLICIES = (*_NAMED, 'depth', *_DURATIONS)
# Largest signed integers of 32 bits (messages in the middleware) and 64 bits (ns in rclpy).
_MAX_DEPTH, _MAX_DURATION = 2**31 - 1, 2**63 - 1


class Endpoint(NamedTuple):
    """
    Publisher or subscription of a node.

    Parameters
    ----------
    topic : str
        Name of the topic, which may be relative or private.
    kind : str
        Kind of the endpoint.

    """

    topic: str
    kind: Literal['publisher', 'subscription']


def parameter_names(node: Node, endpoints: Iterable[Endpoint]) -> list[str]:
    """Return the names of all parameters that can set the QoS of a node."""
    # A lifespan has no effect on a subscription.
    return [f'{PREFIX}{node.resolve_topic_name(topic)}.{kind}.{policy}'
            for topic, kind in endpoints for policy in POLICIES
            if kind == 'publisher' or policy != 'lifespan']


def expected_form(name: str, value: object) -> str:
    """Return the expected form of a QoS parameter, or '' if the value is valid."""
    policy = name.rpartition('.')[2]
    if policy in _NAMED:
        choices = [key for key in _NAMED[policy].short_keys() if key != 'unknown']
        good = isinstance(value, str) and value.lower() in choices
        return '' if good else f'one of {", ".join(choices)}'
    smallest, largest, unit = (
        (1, _MAX_DEPTH, '') if policy == 'depth' else (0, _MAX_DURATION, ' [ns]'))
    good = type(value) is int and smallest <= value <= largest
    return '' if good else f'an integer from {smallest} to {largest}{unit}'


def create_publisher(node: Node, message_type: type, topic: str, qos: QoSProfile) -> Publisher:
    """Create a publisher whose QoS can be overridden by parameters."""
    # Copied, because rclpy modifies the profile, which other topics may share.
    return node.create_publisher(message_type, topic, copy(qos), qos_overriding_options=_options())


def create_subscription(node: Node, message_type: type, topic: str, callback: Callable[..., None],
                        qos: QoSProfile, **more: Any) -> Subscription:
    """Create a subscription whose QoS can be overridden by parameters."""
    return node.create_subscription(
        message_type, topic, callback, copy(qos), qos_overriding_options=_options(), **more)


def _options() -> QoSOverridingOptions:
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in POLICIES])
