# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Retractions tau: from a rotation vector x, an angular velocity times h, to a rotation.

All that a step needs of one depends on x through y = |x|^2 / 4 alone: the eight numbers of
``Coefficients``. The formulas have no quotient that vanishes at x = 0 and no difference of numbers
that are nearly equal, so they are exact to round-off everywhere, in the arithmetic of y.

References
----------
N. Bou-Rabee, J. Marsden, Hamilton-Pontryagin integrators on Lie groups, part I, Found. Comput.
Math. 9 (2009).
A. Iserles et al., Lie-group methods, Acta Numerica 9 (2000).

"""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Terms of a power series; for y <= 2.25, a turn of 3 rad, some 12 of them count in doubles.
_MOST_TERMS = 100


class Coefficients(NamedTuple):
    """
    A retraction at one x.

    Parameters
    ----------
    vector, less_one : float
        The unit quaternion of tau(x) has the vector part vector x and the scalar part
        1 + less_one.
    along, squared : float
        (dtau^-1_x)^* m = m + x cross m / 2 + along (x . m) x - squared |x|^2 m, with the
        right-trivialised tangent dtau: (d/dt tau(x)) tau(x)^-1 = dtau_x x'. Of -x the second term
        has the other sign.
    own, cross, line : float
        dtau_x^* m = own m - cross x cross m + line (x . m) x.

    """

    vector: float
    less_one: float
    along: float
    squared: float
    own: float
    cross: float
    line: float


@inlined
def cayley(y: float) -> Coefficients:
    """Return the Cayley map (1 - x^ / 2)^-1 (1 + x^ / 2), which turns by 2 atan(|x| / 2)."""
    root = np.sqrt(1 + y)
    share = 1 / (1 + y)
    zero = 0 * y
    return Coefficients(0.5 / root, -y / (root * (1 + root)), 0.25 + zero, zero,
                        share, 0.5 * share, zero)


@inlined
def exponential(y: float) -> Coefficients:
    """Return the exponential map, which turns by |x|."""
    # With phi = |x| / 2: sin(phi) / phi = 1 - y P and cos(phi) = 1 - y D - y P, where
    # P = sum over k of (-y)^k / (2 k + 3)! and D = sum of (2 k + 2) (-y)^k / (2 k + 3)!.
    term = 1 + 0 * y
    sines, rest = term / 6, term / 3
    for k in range(1, _MOST_TERMS):
        term = -term * y / ((2 * k - 1) * (2 * k))
        more = term / ((2 * k + 1) * (2 * k + 3))
        sines += more / (2 * k + 2)
        if rest + more == rest:
            break
        rest += more
    sine, cosine = 1 - y * sines, 1 - y * (sines + rest)
    bend = rest / (4 * sine)
    line = 0.25 * (sines + sine * (sines + rest))
    return Coefficients(0.5 * sine, -y * (sines + rest), bend, bend,
                        sine * cosine, 0.5 * sine * sine, line)


RETRACTIONS: dict[str, Callable[[float], Coefficients]] = {
    'cayley': cayley, 'exponential': exponential}
