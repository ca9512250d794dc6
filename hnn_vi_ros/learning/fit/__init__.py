# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fitting of model families to data: configurations, losses, steps, training loop."""
