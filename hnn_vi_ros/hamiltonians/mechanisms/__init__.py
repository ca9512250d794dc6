# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bodies to draw: a scene's coordinates as lines, boxes and balls in metres."""
