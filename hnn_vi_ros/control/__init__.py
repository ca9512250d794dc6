# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes as models to act on: steps with commands, equilibria, linear models and controllers."""

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.linear import find_equilibrium, Gain, linearise, lqr, momentum, velocity

__all__ = ['BatchStep', 'Gain', 'find_equilibrium', 'linearise', 'lqr', 'momentum', 'velocity']
