# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Motions of exact systems in 40 digits, by formulas that are not those of the package."""

import mpmath
import numpy as np


def exact_pendulum(q0: float, p0: float, t: float) -> tuple[float, float]:
    """Return (q, p) of the pendulum of 1 kg, 1 m, 9.81 m/s2, by theta functions of 40 digits."""
    mpmath.mp.dps = 40
    omega = mpmath.sqrt(mpmath.mpf(9.81))
    m = mpmath.sin(mpmath.mpf(q0) / 2) ** 2 + (mpmath.mpf(p0) / (2 * omega)) ** 2
    if m < 1:
        k = mpmath.sqrt(m)
        phi = mpmath.atan2(mpmath.sin(mpmath.mpf(q0) / 2), mpmath.mpf(p0) / (2 * omega))
        u = omega * t + mpmath.ellipf(phi, m)
        q = 2 * mpmath.asin(k * mpmath.ellipfun('sn', u, m=m))
        return float(q), float(2 * omega * k * mpmath.ellipfun('cn', u, m=m))
    # Over the top: the angle is found again from its sine and cosine and the turns so far.
    k, n = mpmath.sqrt(m), 1 / m
    u = k * omega * t + mpmath.ellipf(mpmath.mpf(q0) / 2, n)
    turns = mpmath.floor((u + mpmath.ellipk(n)) / (2 * mpmath.ellipk(n)))
    rest = u - 2 * turns * mpmath.ellipk(n)
    q = 2 * (mpmath.asin(mpmath.ellipfun('sn', rest, m=n)) + turns * mpmath.pi)
    return float(q), float(2 * omega * k * mpmath.ellipfun('dn', rest, m=n))


def exact_orbit(e: float, t: float) -> np.ndarray:
    """Return (x, y, p_x, p_y) of the ellipse of a = 1, mu = 1, from its apocentre on -x."""
    mpmath.mp.dps = 40
    mean = mpmath.mpf(t) + mpmath.pi
    anomaly = mpmath.findroot(lambda E: E - e * mpmath.sin(E) - mean, mean)
    r, side = 1 - e * mpmath.cos(anomaly), mpmath.sqrt(1 - mpmath.mpf(e) ** 2)
    return np.array([mpmath.cos(anomaly) - e, side * mpmath.sin(anomaly),
                     -mpmath.sin(anomaly) / r, side * mpmath.cos(anomaly) / r], dtype=float)
