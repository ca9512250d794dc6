# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate learned Hamiltonian dynamics with variational integrators, in ROS 2 and in Python."""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports
from hnn_vi_ros.version import __version__

if TYPE_CHECKING:
    from hnn_vi_ros.learning import export
    from hnn_vi_ros.run import simulate_spread
    from hnn_vi_ros.scene import list_effects, list_integrators, list_scenes, load_scene, Scene
    from hnn_vi_ros.simulation import simulate, simulate_many, Trajectory
    from hnn_vi_ros.sweeps import sweep

__all__ = ['Scene', 'Trajectory', '__version__', 'export', 'list_effects',
           'list_integrators', 'list_scenes', 'load_scene', 'simulate', 'simulate_many',
           'simulate_spread', 'sweep']

# Without `__version__`, which is defined directly.
__getattr__, __dir__ = lazy_exports(__name__)
