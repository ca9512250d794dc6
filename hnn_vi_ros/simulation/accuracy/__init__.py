# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of a simulation, and selection of a method that meets a tolerance."""
