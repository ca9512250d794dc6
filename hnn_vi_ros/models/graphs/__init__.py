# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Functions as graphs of a fixed list of operations, from files, evaluated by compiled loops."""
