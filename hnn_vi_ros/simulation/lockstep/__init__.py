# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Thousands of trajectories in lockstep, in torch, on the processor or on a GPU.

Each trajectory has equations of its own, which are solved until they are at round-off, by the
criteria of ``integrators.solvers``; gradients are taken of all that are left, as matrix products.
All arrays have the trajectories along their last axis.
"""
