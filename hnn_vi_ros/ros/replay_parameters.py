# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the replay node, which are its options as well."""

from dataclasses import dataclass, replace

from hnn_vi_ros.ros.parameters import parameter, specifications, START


@dataclass(frozen=True)
class ReplaySettings:
    """The parameters of the replay node."""

    rate: float = parameter(1.0, 'seconds of the bag per second of wall time', '1', 1e-3, 1e3)
    loop: bool = parameter(False, 'begin again at the end')
    start_offset: float = parameter(
        0.0, 'time of the bag that is left out at its start', 's', 0.0, 1e9)
    duration: float = parameter(
        0.0, 'time of the bag that is played; 0 plays to its end', 's', 0.0, 1e9)
    topics: str = parameter(
        '', 'names of the topics to publish, separated by commas; empty publishes all but the '
        'commands that a simulator heard')
    publish_clock: bool = parameter(False, "publish the bag's time on `/clock`, each 10 ms of it")
    start_paused: bool = parameter(False, 'begin paused')
    discovery_time: float = parameter(
        2.0, 'the first message waits at most this long for subscribers that are there already, '
        'so that they miss none', 's', 0.0, 60.0)


PARAMETERS = tuple(replace(item, changes=START) for item in specifications(ReplaySettings))
