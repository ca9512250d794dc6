# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of scenes in Python; storage, plots and export of trajectories."""
