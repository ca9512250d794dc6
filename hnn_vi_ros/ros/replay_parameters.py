# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the replay node, which are its options as well."""

from dataclasses import replace

from hnn_vi_ros.ros.parameters import Specification, START

PARAMETERS = tuple(replace(item, changes=START) for item in (
    Specification('rate', 1.0, 'seconds of the bag per second of wall time', '1', 1e-3, 1e3),
    Specification('loop', False, 'begin again at the end'),
    Specification('start_offset', 0.0, 'time of the bag that is left out at its start', 's',
                  0.0, 1e9),
    Specification('duration', 0.0, 'time of the bag that is played; 0 plays to its end', 's',
                  0.0, 1e9),
    Specification('topics', '', 'names of the topics to publish, separated by commas; empty '
                  'publishes all but the commands that a simulator heard'),
    Specification('publish_clock', False, "publish the bag's time on `/clock`, each 10 ms of it"),
    Specification('start_paused', False, 'begin paused'),
    Specification('discovery_time', 2.0,
                  'the first message waits at most this long for subscribers that are there '
                  'already, so that they miss none', 's', 0.0, 60.0),
))
