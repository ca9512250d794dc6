# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes that more than one test simulates."""

# The paper's iteration does not converge in its 17th step.
FAILING = """\
hamiltonian: {kind: tao}
integrator: {kind: variational_euler, solver: fixed_point}
step_size: 0.4
initial_state: {q: [1.0], p: [-1.0]}
"""
