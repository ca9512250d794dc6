# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Controllers: equilibria, linearisation, LQR, iLQR, MPPI and laws for specific machines.

A controller maps a state to a command. ``ros.controller_node`` runs one as a node;
``simulation.gradients`` provides gradients.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.control.balance import Balance
    from hnn_vi_ros.control.batch_step import BatchStep
    from hnn_vi_ros.control.costs import Cost, Energy, Kinetic, Point, Quadratic
    from hnn_vi_ros.control.energy_shaping import EnergyShaping
    from hnn_vi_ros.control.hover import Hover
    from hnn_vi_ros.control.ilqr import Ilqr, Regulator
    from hnn_vi_ros.control.linear import (
        find_equilibrium, Gain, linearise, lqr, momentum, state_space, velocity)
    from hnn_vi_ros.control.mppi import Mppi
    from hnn_vi_ros.control.planning import Planner
    from hnn_vi_ros.control.task import assign, Assignment

__getattr__, __dir__ = lazy_exports(__name__)
