# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations: H, a method and effects compiled into one kernel that advances a state.

A scene becomes one in ``build``, whose steps ``events`` watches and ``dense_step`` looks into;
``rescue`` takes steps that fail. Here is nothing that measures or judges a run: see guards,
accuracy and trajectory.
"""

from hnn_vi_ros.simulation.simulation import RescuePending, Simulation
from hnn_vi_ros.recording.sample import Sample

__all__ = ['RescuePending', 'Simulation']
