# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Data to learn from: exact, measured and recorded, from every format."""
