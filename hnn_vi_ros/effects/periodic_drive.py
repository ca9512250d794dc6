# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A force that oscillates in time."""

from collections.abc import Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Force
from hnn_vi_ros.hamiltonians import check_finite, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class DriveParameters(NamedTuple):
    """Column of the coordinate, amplitude [N], angular frequency [rad/s] and phase [rad]."""

    column: int
    amplitude: float
    omega: float
    phase: float


class PeriodicDrive(Force):
    """
    A harmonic drive of one coordinate, f = F cos(2 pi nu t + phi).

    t is the simulated time at the method's node. For other time functions use `external_force`.
    Energy account: the power f v.

    Parameters
    ----------
    coordinate : str
        The driven coordinate.
    amplitude : float
        F, in the unit of the coordinate's generalised force [N] or [N m].
    frequency : float
        nu > 0 [Hz].
    phase : float
        phi [rad].

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, 1976, section 22.

    """

    depends_on_momentum, depends_on_state, drawn = False, False, True

    def __init__(self, coordinate: str, amplitude: float, frequency: float, phase: float = 0.0):
        check_positive(frequency=frequency)
        check_finite(amplitude=amplitude, phase=phase)
        self.coordinate, self.frequency = coordinate, float(frequency)
        self.wave = float(amplitude), 2.0 * math.pi * frequency, float(phase)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> DriveParameters:
        """Return the coordinate's column, F, the angular frequency and phi."""
        return DriveParameters(coordinate_index(coordinates, self.coordinate), *self.wave)

    @staticmethod
    @inlined
    def add_force(parameters: DriveParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add F cos(2 pi nu t + phi)."""
        own = parameters
        f_p[own.column] += own.amplitude * math.cos(own.omega * t + own.phase)
