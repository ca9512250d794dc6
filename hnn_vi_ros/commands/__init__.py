# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command ``hnn``: the table of its commands, and those that no other room has."""
