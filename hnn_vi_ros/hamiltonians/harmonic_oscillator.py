# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The harmonic oscillator, the paper's example."""

import math

from hnn_vi_ros.hamiltonians.base import ExactMotion
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class HarmonicOscillator(AnalyticHamiltonian):
    """
    A mass on a linear spring, H(q, p) = p^2 / (2 m) + k q^2 / 2.

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    stiffness : float
        k > 0 [N/m]; the angular frequency is sqrt(k / m) [rad/s].

    Raises
    ------
    ValueError
        A parameter is not a positive finite number.

    """

    coordinates = (Coordinate('x', 'm', 'kg m/s'),)
    separable = True
    names, formula = ('q',), 'p^2 / (2 * m) + k * q^2 / 2'

    def __init__(self, mass: float = 1.0, stiffness: float = 1.0):
        check_positive(mass=mass, stiffness=stiffness)
        self.mass, self.stiffness = float(mass), float(stiffness)
        self.constants = {'m': self.mass, 'k': self.stiffness}

    def exact_motion(self, q: np.ndarray, p: np.ndarray, t: np.ndarray) -> ExactMotion:
        """Return the motion, with angular frequency sqrt(k / m)."""
        inertia = math.sqrt(self.mass * self.stiffness)
        phase = math.sqrt(self.stiffness / self.mass) * t[:, None]
        sine, cosine = np.sin(phase), np.cos(phase)
        path = np.hstack([q * cosine + p / inertia * sine, p * cosine - q * inertia * sine])
        return ExactMotion(path, 1.0, 'sine and cosine')
