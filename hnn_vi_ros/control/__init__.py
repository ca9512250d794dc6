# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes as models to act on: steps with commands, equilibria, linear models and controllers."""

from hnn_vi_ros.control.balance import Balance
from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost, Energy, Kinetic, Point, Quadratic
from hnn_vi_ros.control.energy_shaping import EnergyShaping
from hnn_vi_ros.control.hover import Hover
from hnn_vi_ros.control.ilqr import Ilqr, Regulator
from hnn_vi_ros.control.linear import (
    find_equilibrium, Gain, linearise, lqr, momentum, state_space, velocity)
from hnn_vi_ros.control.mppi import Mppi
from hnn_vi_ros.control.task import assign, Assignment

__all__ = ['Assignment', 'Balance', 'BatchStep', 'Cost', 'Energy', 'EnergyShaping', 'Gain',
           'Hover', 'Ilqr', 'Kinetic', 'Mppi', 'Point', 'Quadratic', 'Regulator', 'assign',
           'find_equilibrium', 'linearise', 'lqr', 'momentum', 'state_space', 'velocity']
