# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Uniform gravity along one coordinate."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Potential
from hnn_vi_ros.hamiltonians import check_finite, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class GravityParameters(NamedTuple):
    """Column c of the coordinate, and m g [N]."""

    column: int
    weight: float


class Gravity(Potential):
    """
    Weight of a mass in a uniform field, V = m g q_c.

    The gravity of a robot is already in its URDF. Energy account: V is part of H; no work.

    Parameters
    ----------
    coordinate : str
        The coordinate c that points up [m].
    mass : float
        m > 0 [kg].
    acceleration : float
        g [m/s^2]; negative if the coordinate points down.

    Raises
    ------
    ValueError
        The mass is not positive, or a number is not finite.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, 1976, section 5.

    """

    turns = drawn = True

    def __init__(self, coordinate: str, mass: float = 1.0, acceleration: float = 9.81):
        check_positive(mass=mass)
        check_finite(weight=mass * acceleration)
        self.coordinate, self.weight = coordinate, mass * acceleration

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> GravityParameters:
        """Return the coordinate's column and the weight [N]."""
        return GravityParameters(coordinate_index(coordinates, self.coordinate), self.weight)

    @staticmethod
    @inlined
    def energy(parameters: GravityParameters, q: np.ndarray) -> float:
        """Return V [J]."""
        return parameters.weight * q[parameters.column]

    @staticmethod
    @inlined
    def add_gradient(parameters: GravityParameters, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V'."""
        dH_dq[parameters.column] += parameters.weight

    @staticmethod
    @inlined
    def add_hessian_vector(parameters: GravityParameters, q: np.ndarray, v: np.ndarray,
                           product: np.ndarray) -> None:
        """Add nothing: V is linear."""
