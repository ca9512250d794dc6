# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trees of rigid bodies: robots from URDF, and recursive algorithms for them."""
