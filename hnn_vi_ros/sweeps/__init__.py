# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Sweeps: one scene simulated with many values, on one machine or with Ray.

Results are Parquet files. ``simulation.trajectory`` computes a single trajectory.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.sweeps.plan import SweepPlan
    from hnn_vi_ros.sweeps.running import sweep

__getattr__, __dir__ = lazy_exports(__name__)
