# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations within the arrays of a step: quaternions (x, y, z, w), and operations on them."""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.kernels import inlined
import numpy as np

# Terms of a power series; for y <= 2.25, a rotation of 3 rad, 12 of them suffice in double.
_MAX_TERMS = 100


class Coefficients(NamedTuple):
    """
    Coefficients of a retraction at one x.

    Parameters
    ----------
    vector, less_one : float
        The unit quaternion of tau(x) has the vector part vector x and the scalar part
        1 + less_one.
    along, squared : float
        (dtau^-1_x)^* m = m + x cross m / 2 + along (x . m) x - squared |x|^2 m, with the
        right-trivialised tangent dtau: (d/dt tau(x)) tau(x)^-1 = dtau_x x'. For -x the second term
        has the opposite sign.
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
    """Return the Cayley map (1 - x^ / 2)^-1 (1 + x^ / 2), a rotation by 2 atan(|x| / 2)."""
    root = np.sqrt(1 + y)
    share = 1 / (1 + y)
    zero = 0 * y
    return Coefficients(0.5 / root, -y / (root * (1 + root)), 0.25 + zero, zero,
                        share, 0.5 * share, zero)


@inlined
def exponential(y: float) -> Coefficients:
    """Return the exponential map, a rotation by |x|."""
    # With phi = |x| / 2: sin(phi) / phi = 1 - y P and cos(phi) = 1 - y D - y P, where
    # P = sum over k of (-y)^k / (2 k + 3)! and D = sum of (2 k + 2) (-y)^k / (2 k + 3)!.
    term = 1 + 0 * y
    sines, rest = term / 6, term / 3
    for k in range(1, _MAX_TERMS):
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


@inlined
def cross(x: np.ndarray, m: np.ndarray, at: int) -> tuple[float, float, float]:
    """Return x cross m for the vectors at one place of both arrays."""
    return (x[at + 1] * m[at + 2] - x[at + 2] * m[at + 1],
            x[at + 2] * m[at] - x[at] * m[at + 2],
            x[at] * m[at + 1] - x[at + 1] * m[at])


@inlined
def dot(x: np.ndarray, m: np.ndarray, at: int) -> float:
    """Return x . m for the vectors at one place of both arrays."""
    return x[at] * m[at] + x[at + 1] * m[at + 1] + x[at + 2] * m[at + 2]


@inlined
def trivialised(q: np.ndarray, dH_dq: np.ndarray, at: int) -> tuple[float, float, float]:
    """
    Return g^* H_g, the derivative of H by rotations in the body frame: minus the torque [N m].

    q' = q (omega, 0) / 2 for an angular velocity omega in the body frame, so the result is half
    the transposed map applied to H_q.
    """
    x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
    a, b, c, d = dH_dq[at], dH_dq[at + 1], dH_dq[at + 2], dH_dq[at + 3]
    return (0.5 * (w * a + z * b - y * c - x * d),
            0.5 * (w * b + x * c - z * a - y * d),
            0.5 * (w * c + y * a - x * b - z * d))


@inlined
def turn(q: np.ndarray, carry: np.ndarray, at: int, x: np.ndarray, place: int,
         tau: Coefficients, q1: np.ndarray, carry1: np.ndarray) -> None:
    """
    Fill q1 with q tau(x), for the quaternion at one place and the rotation vector at another.

    A small rotation adds little, so compensated summation keeps the rounding error. The product of
    unit quaternions has norm 1 up to rounding, so one Newton step on the norm keeps it there.
    """
    a, b, c = (tau.vector * x[place], tau.vector * x[place + 1], tau.vector * x[place + 2])
    d = tau.less_one
    x0, y0, z0, w0 = q[at], q[at + 1], q[at + 2], q[at + 3]
    added = (w0 * a + y0 * c - z0 * b + x0 * d, w0 * b + z0 * a - x0 * c + y0 * d,
             w0 * c + x0 * b - y0 * a + z0 * d, w0 * d - x0 * a - y0 * b - z0 * c)
    excess = -1 + 0 * d
    for i in range(4):
        q1[at + i], carry1[at + i] = plus(q[at + i], carry[at + i], added[i])
        excess += q1[at + i] * (q1[at + i] + 2 * carry1[at + i])
    for i in range(4):
        q1[at + i], carry1[at + i] = plus(q1[at + i], carry1[at + i], -0.5 * excess * q1[at + i])
