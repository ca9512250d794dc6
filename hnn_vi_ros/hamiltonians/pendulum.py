# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The planar pendulum, the smallest nonlinear mechanism."""

import math

from hnn_vi_ros.hamiltonians.base import ExactMotion
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Near the separatrix the elliptic functions are inaccurate.
_SEPARATRIX_MARGIN = 1e-9


class Pendulum(AnalyticHamiltonian):
    """
    A bob on a massless rod, H(q, p) = p^2 / (2 m l^2) + m g l (1 - cos q).

    The angle q is measured from the lowest position, where H = 0. The bob swings below H = 2 m g l
    and rotates above; the separatrix between both has p = 2 m l sqrt(g l) at q = 0. Small
    oscillations have the angular frequency sqrt(g / l) [rad/s].

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    length : float
        l > 0 [m], from the pivot to the bob.
    gravity : float
        g > 0 [m/s^2].

    Raises
    ------
    ValueError
        A parameter is not a positive finite number.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.1.2.

    """

    coordinates = (Coordinate('angle', 'rad', 'kg m2/s'),)
    separable = True
    names, formula = ('q',), 'p^2 / (2 * m * l^2) + m * g * l * (1 - cos(q))'

    def __init__(self, mass: float = 1.0, length: float = 1.0, gravity: float = 9.81):
        check_positive(mass=mass, length=length, gravity=gravity)
        check_positive(inertia=mass * length * length, torque=mass * gravity * length)
        self.mass, self.length, self.gravity = float(mass), float(length), float(gravity)
        self.constants = {'m': self.mass, 'l': self.length, 'g': self.gravity}
        self.barrier = 'separatrix', 2.0 * self.mass * self.gravity * self.length

    def exact_motion(self, q: np.ndarray, p: np.ndarray, t: np.ndarray) -> ExactMotion | None:
        """
        Return the motion by Jacobi's elliptic functions, None near the separatrix.

        With k^2 = H / (2 m g l), an oscillation (k < 1) has sin(q / 2) = k sn(omega t + u0 | k^2)
        and a rotation (k > 1) has q / 2 = am(k omega t + u0 | 1 / k^2), where omega^2 = g / l.
        """
        # Imported lazily: reading a scene needs no special functions.
        from scipy.special import ellipj, ellipk, ellipkinc
        omega = math.sqrt(self.gravity / self.length)
        top = 2.0 * omega * self.mass * self.length ** 2
        turns = round(float(q[0]) / (2.0 * math.pi))
        half = 0.5 * (float(q[0]) - 2.0 * math.pi * turns)
        sine, speed = math.sin(half), float(p[0]) / top
        m = sine * sine + speed * speed
        if abs(m - 1.0) < _SEPARATRIX_MARGIN:
            return None
        k = math.sqrt(m)
        if m < 1.0:
            start = ellipkinc(math.atan2(sine, speed), m)
            sn, cn, _, _ = ellipj(np.remainder(omega * t + start, 4.0 * ellipk(m)), m)
            angle, momentum = 2.0 * np.arcsin(k * sn), top * k * cn
        else:
            sign = math.copysign(1.0, speed)
            u = k * omega * t + ellipkinc(sign * half, 1.0 / m)
            period = 2.0 * ellipk(1.0 / m)
            whole = np.floor(u / period)
            _, _, dn, amplitude = ellipj(u - whole * period, 1.0 / m)
            angle = 2.0 * sign * (amplitude + math.pi * whole)
            momentum = sign * top * k * dn
        path = np.column_stack([angle + 2.0 * math.pi * turns, momentum])
        # Relative change of the period for a relative change of the energy.
        return ExactMotion(path, max(1.0, 1.0 / abs(1.0 - m)), 'Jacobi elliptic functions')
