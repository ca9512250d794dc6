# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Recordings of runs: MCAP bags and the rerun viewer.

``bags`` writes, reads and recovers bags; ``viewer`` shows samples. Neither depends on ROS. ``ros``
defines the topics of a bag.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.recording.bags.bag_files import bag_files, digest_of, is_sqlite
    from hnn_vi_ros.recording.bags.bag_metadata import BagTopics, qos_profiles, Topic
    from hnn_vi_ros.recording.bags.cdr import (
        ARRAY, decode, decode_float64_multi_array, decode_joint_state, decode_joint_trajectory,
        decode_state, INERTIA, JOINT_STATE, MOMENTUM, RATE, serialize, state_names, StateMessage,
        STRING, Template, TRAJECTORY, WRENCH)
    from hnn_vi_ros.recording.bags.mcap_reader import BagReader, RecordedMessage
    from hnn_vi_ros.recording.bags.mcap_sink import FLUSH_INTERVAL, McapSink
    from hnn_vi_ros.recording.sample import Sample
    from hnn_vi_ros.recording.viewer.phase_portrait import (
        Bounds, box_of, contours, ends_of, Frame, reach_of)
    from hnn_vi_ros.recording.viewer.rerun_sink import RerunSink
    from hnn_vi_ros.recording.viewer.rerun_stream import Target

__getattr__, __dir__ = lazy_exports(__name__)
