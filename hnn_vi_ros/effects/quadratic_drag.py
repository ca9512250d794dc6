# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Drag of a fast body in a fluid."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.effects.masses import momentum_index
from hnn_vi_ros.hamiltonians import check_names_once, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class DragParameters(NamedTuple):
    """Columns of the coordinates in p, and b [kg/m]."""

    columns: np.ndarray
    coefficient: float


class QuadraticDrag(Force):
    """
    Newton's drag, f = -b |v| v, where v is the joint velocity H_p of some coordinates.

    For slow motion use `damping`. Energy account: the power f . v = -b |v|^3.

    Parameters
    ----------
    coordinates : list of str
        Coordinates that move through the fluid [m]; for a body its position, such as body_x, or
        its rotation, such as body_rx, with a drag in N m s^2.
    coefficient : float
        b > 0 [kg/m], half the product of density, area and drag coefficient.

    Raises
    ------
    ValueError
        The coefficient is not positive, no coordinate is named, or one is named twice.

    References
    ----------
    G. Batchelor, An Introduction to Fluid Dynamics, 1967, section 5.11.

    """

    depends_on_momentum = turns = drawn = passive = True

    def __init__(self, coordinates: list[str], coefficient: float):
        check_positive(coefficient=coefficient)
        check_names_once(coordinates=coordinates)
        self.coordinates, self.coefficient = coordinates, float(coefficient)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> DragParameters:
        """Return the coordinates' columns and b."""
        return DragParameters(np.array([momentum_index(coordinates, name)
                                        for name in self.coordinates]), self.coefficient)

    def joints(self, parameters: DragParameters) -> np.ndarray:
        """Return the coordinates' columns."""
        return parameters.columns

    @staticmethod
    @inlined
    def add_force(parameters: DragParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add -b |v| v."""
        columns = parameters.columns
        square = 0.0
        for k in range(columns.size):
            square += velocity[columns[k]] * velocity[columns[k]]
        for k in range(columns.size):
            f_p[columns[k]] -= parameters.coefficient * np.sqrt(square) * velocity[columns[k]]
