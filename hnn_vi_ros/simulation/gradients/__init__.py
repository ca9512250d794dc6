# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of simulations with respect to parameters, initial states and weights."""
