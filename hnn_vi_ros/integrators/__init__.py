# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Integrators, by the name that a scene's YAML gives them, and which of them can do what."""
