# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes: the schema of their YAML, and how one becomes a Hamiltonian and an integrator."""
