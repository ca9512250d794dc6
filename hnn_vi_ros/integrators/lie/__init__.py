# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lie group variational integrators: the paper's principle for rotating bodies."""
