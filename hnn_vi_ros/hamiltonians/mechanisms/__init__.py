# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Mechanisms for display: a scene's coordinates as lines, boxes and balls in metres."""
