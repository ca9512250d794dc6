# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories of one scene, in shards that any machine makes alike, kept as Parquet."""
