# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Dry friction, smoothed where the velocity changes its sign."""

from collections.abc import Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Force
from hnn_vi_ros.hamiltonians import check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FrictionParameters(NamedTuple):
    """Column of the coordinate, F [N] and the speed u [m/s]; [N m] and [rad/s] for angles."""

    column: int
    force: float
    speed: float


class DryFriction(Force):
    """
    Smoothed Coulomb friction, f = -F tanh(v / u), where v = H_p of one coordinate.

    Well above the speed u it has the magnitude F; below, it is viscous with F / u, so a loaded
    body creeps instead of sticking. For joints: `joint_friction`. Energy account: f v <= 0.

    Parameters
    ----------
    coordinate : str
        The coordinate with friction.
    force : float
        F > 0, in the unit of the coordinate's generalised force [N] or [N m].
    speed : float
        u > 0, in the unit of the coordinate per second; steps h should resolve m u / F.

    Raises
    ------
    ValueError
        A parameter is not positive.

    References
    ----------
    E. Pennestrì et al., Review and comparison of dry friction force models, Nonlinear Dynamics
    83 (2016), section 2.2.

    """

    depends_on_momentum = drawn = passive = True

    def __init__(self, coordinate: str, force: float, speed: float = 0.01):
        check_positive(force=force, speed=speed)
        self.coordinate, self.force, self.speed = coordinate, float(force), float(speed)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> FrictionParameters:
        """Return the coordinate's column, F and u."""
        return FrictionParameters(coordinate_index(coordinates, self.coordinate), self.force,
                                  self.speed)

    @staticmethod
    @inlined
    def add_force(parameters: FrictionParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add -F tanh(v / u)."""
        c = parameters.column
        f_p[c] -= parameters.force * math.tanh(velocity[c] / parameters.speed)
