# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the example controller."""

from dataclasses import dataclass, replace

from hnn_vi_ros.ros.parameters import parameter, specifications, START


@dataclass(frozen=True)
class HoverSettings:
    """Point where the quadrotor is to be held."""

    x: float = parameter(1.0, 'of the place that it is led to', 'm', -1e3, 1e3)
    y: float = parameter(-1.0, 'the same', 'm', -1e3, 1e3)
    z: float = parameter(12.0, 'the same; upwards', 'm', -1e3, 1e3)


PARAMETERS = tuple(replace(item, changes=START) for item in specifications(HoverSettings))
