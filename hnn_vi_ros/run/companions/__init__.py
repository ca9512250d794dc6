# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that accompany a run: members of an ensemble, predictions of a twin, sensors."""
