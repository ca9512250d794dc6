# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate learned Hamiltonian dynamics with variational integrators, in ROS 2 and in Python."""

from importlib import import_module
from typing import TYPE_CHECKING

from hnn_vi_ros.version import __version__

if TYPE_CHECKING:
    from hnn_vi_ros.run.companions.members import simulate_spread
    from hnn_vi_ros.scene import load_scene, Scene
    from hnn_vi_ros.simulation.trajectory.simulate import simulate, simulate_many
    from hnn_vi_ros.simulation.trajectory.trajectory import Trajectory
    from hnn_vi_ros.sweeps.running import sweep

__all__ = ['Scene', 'Trajectory', '__version__', 'load_scene', 'simulate', 'simulate_many',
           'simulate_spread', 'sweep']

_HOMES = {'load_scene': 'hnn_vi_ros.scene', 'simulate': 'hnn_vi_ros.simulation.trajectory.simulate',
          'simulate_many': 'hnn_vi_ros.simulation.trajectory.simulate', 'sweep': 'hnn_vi_ros.sweeps.running',
          'simulate_spread': 'hnn_vi_ros.run.companions.members', 'Scene': 'hnn_vi_ros.scene',
          'Trajectory': 'hnn_vi_ros.simulation.trajectory.trajectory'}


def __getattr__(name: str) -> object:
    # Imported on first use: an executable can then still report a missing dependency.
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    # For completion, which would not offer what is imported on first use.
    return sorted(__all__)
