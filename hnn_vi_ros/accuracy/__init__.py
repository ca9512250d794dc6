# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How accurate a simulation is, and what holds an error that is allowed."""
