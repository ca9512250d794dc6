# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The planar Kepler problem, with close encounters."""

import math

from hnn_vi_ros.hamiltonians.base import ExactMotion
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Kepler(AnalyticHamiltonian):
    """
    A body of 1 kg around a fixed centre of attraction, H(q, p) = |p|^2 / 2 - mu / |q|.

    The angular momentum q_x p_y - q_y p_x is conserved as well. For H < 0 the orbit is an ellipse
    of semi-major axis a = -mu / (2 H) and period 2 pi sqrt(a^3 / mu); an orbit of eccentricity e
    starts at its pericentre at q = (a (1 - e), 0), p = (0, sqrt(mu (1 + e) / (a (1 - e)))). At the
    centre H is infinite.

    Parameters
    ----------
    mu : float
        Standard gravitational parameter, mu > 0 [m^3/s^2].

    Raises
    ------
    ValueError
        mu is not a positive finite number.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.2.

    """

    coordinates = (Coordinate('x', 'm', 'kg m/s'), Coordinate('y', 'm', 'kg m/s'))
    separable = True
    # The angular momentum [kg m^2/s].
    known_invariants = {'angular_momentum': lambda q, p: float(q[0] * p[1] - q[1] * p[0])}
    # At the centre the result is infinity or NaN, which the checks for non-finite states detect.
    names, formula = ('x', 'y'), '(p_x^2 + p_y^2) / 2 - mu / sqrt(x^2 + y^2)'

    def __init__(self, mu: float = 1.0):
        check_positive(mu=mu)
        self.mu = float(mu)
        self.constants = {'mu': self.mu}

    def exact_motion(self, q: np.ndarray, p: np.ndarray, t: np.ndarray) -> ExactMotion | None:
        """
        Return an ellipse by Kepler's equation for the change E of the eccentric anomaly.

            n t = E - (1 - r0 / a) sin E + (q . p) / sqrt(mu a) (1 - cos E)

        and from E by Lagrange's f and g (Battin, An Introduction to the Mathematics and Methods of
        Astrodynamics, section 4.3). None for an orbit that is open, or meets the centre.
        """
        mu, r0, squared = self.mu, float(np.hypot(*q)), float(p @ p)
        inverse = 2.0 / r0 - squared / mu
        if inverse <= 0.0 or q[0] * p[1] == q[1] * p[0]:
            return None
        a = 1.0 / inverse
        n = math.sqrt(mu / a ** 3)
        radial, along = 1.0 - r0 / a, float(q @ p) / math.sqrt(mu * a)
        mean = np.remainder(n * t, 2.0 * math.pi)
        low, high = mean - 4.0, mean + 4.0
        # Bisection: Newton's method would fail near the pericentre of an eccentric ellipse.
        for _ in range(64):
            middle = 0.5 * (low + high)
            ahead = (middle - radial * np.sin(middle)
                     + 2.0 * along * np.sin(0.5 * middle) ** 2) > mean
            low, high = np.where(ahead, low, middle), np.where(ahead, middle, high)
        change = 0.5 * (low + high)
        versine = 2.0 * np.sin(0.5 * change) ** 2
        r = a * (1.0 - radial * np.cos(change) + along * np.sin(change))
        f, g = 1.0 - a / r0 * versine, (mean - change + np.sin(change)) / n
        f_dot, g_dot = -math.sqrt(mu * a) / (r * r0) * np.sin(change), 1.0 - a / r * versine
        path = np.hstack([np.outer(f, q) + np.outer(g, p),
                          np.outer(f_dot, q) + np.outer(g_dot, p)])
        # 1 / a is a difference, and its relative error is that of the period.
        return ExactMotion(path, 1.5 * a * (2.0 / r0 + squared / mu), "Kepler's equation")
