# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Batches of thousands of trajectories in torch, on the CPU or on a GPU.

The equations of each trajectory are solved separately to round-off, by the criteria of
``integrators.solvers``; gradients of all unsolved trajectories are evaluated together, as matrix
products. The last axis of all arrays is the trajectory.
"""
