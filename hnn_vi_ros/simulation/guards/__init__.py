# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards that check a run at each sample and raise an alarm if it becomes unreliable."""
