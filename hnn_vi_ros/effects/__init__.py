# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that a scene can add to its Hamiltonian, by the kind that its YAML names."""
