# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations within the arrays of a step: quaternions (x, y, z, w), and what acts on them."""

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.lie.retractions import Coefficients
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


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
    Return g^* H_g, the derivative of H along turns in the body frame: minus the torque [N m].

    q' = q (omega, 0) / 2 for an angular velocity omega in the body frame, so this is the half of
    the transposed map of H_q.
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

    A small turn adds little, so that compensated summation keeps the part that is rounded off. The
    product of unit quaternions is one; only rounding makes its norm wrong, so that one Newton step
    to norm 1, less than the last digits, is enough to keep it.
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
