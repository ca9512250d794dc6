# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Write, read and recover MCAP and rosbag2 bags.

``mcap_sink`` writes, and the library mcap ends the chunks; ``mcap_reader`` reads bags, and
``mcap_file`` parses files that may be damaged.
"""
