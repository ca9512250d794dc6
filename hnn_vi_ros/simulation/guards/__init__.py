# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards that watch a run sample by sample and say when it is no longer to be trusted."""
