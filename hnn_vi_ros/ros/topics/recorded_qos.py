# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The QoS of recorded topics, as rosbag2 keeps it."""

from collections.abc import Mapping
from typing import Any

from hnn_vi_ros.bags.bag_metadata import qos_profiles
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy)

_DEPTH = 10
# rosbag2 writes for ever as the largest time there is.
_FOR_EVER = 9_000_000_000


def recorded_qos(text: str) -> QoSProfile:
    """
    Return the QoS with which to publish a recorded topic.

    Of several publishers' profiles the first is taken; where a policy is missing, unknown or left
    to the system, what a publisher has by default: reliable, volatile, keep last 10.

    Parameters
    ----------
    text : str
        YAML list of profiles, with policies by name or, as older bags have them, by number.

    """
    first = next(iter(qos_profiles(text)), {})
    profile: Mapping[str, Any] = first if isinstance(first, dict) else {}
    depth = profile.get('depth')
    history = _policy(HistoryPolicy, profile.get('history'), HistoryPolicy.KEEP_LAST)
    return QoSProfile(
        history=history, depth=depth if depth and _is_count(depth, 2**31) else _DEPTH,
        reliability=_policy(ReliabilityPolicy, profile.get('reliability'),
                            ReliabilityPolicy.RELIABLE),
        durability=_policy(DurabilityPolicy, profile.get('durability'),
                           DurabilityPolicy.VOLATILE),
        # Nobody would assert that a replay lives.
        liveliness=LivelinessPolicy.AUTOMATIC,
        deadline=_duration(profile.get('deadline')), lifespan=_duration(profile.get('lifespan')))


def _policy(policies: type, value: object, default: Any) -> Any:
    """Return a policy from its name or number, the default if none such can be offered."""
    offered = {policy.short_key: policy for policy in policies
               if policy.name not in ('SYSTEM_DEFAULT', 'UNKNOWN', 'BEST_AVAILABLE')}
    if isinstance(value, int):
        return next((policy for policy in offered.values() if policy.value == value), default)
    return offered.get(value, default) if isinstance(value, str) else default


def _duration(value: object) -> Duration:
    """Return a time; zero, which means none, for one that is endless or not given."""
    if not isinstance(value, dict):
        return Duration()
    seconds, nanoseconds = value.get('sec', 0), value.get('nsec', 0)
    if not (_is_count(seconds, _FOR_EVER) and _is_count(nanoseconds, 10**9)):
        return Duration()
    return Duration(seconds=seconds, nanoseconds=nanoseconds)


def _is_count(value: object, beyond: int) -> bool:
    return type(value) is int and 0 <= value < beyond
