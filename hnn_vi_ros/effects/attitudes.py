# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotation of body vectors by attitudes, unit quaternions (x, y, z, w) = (u, w) in q.

R m = (w^2 - |u|^2) m + 2 (u . m) u + 2 w u cross m is quadratic in the quaternion. It is not
normalised here, because H must be smooth around norm 1, and its derivatives must match.
"""

from hnn_vi_ros.kernels import called, inlined
import numpy as np

Vector = tuple[float, float, float]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return a cross b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def rotate(q: np.ndarray, at: int, m: Vector) -> Vector:
    """Return R m, the vector m of the body in space, for the quaternion at column ``at``."""
    half = rotate_tangent(q, q, at, m)
    return 0.5 * half[0], 0.5 * half[1], 0.5 * half[2]


@inlined
def rotate_tangent(q: np.ndarray, v: np.ndarray, at: int, m: Vector) -> Vector:
    """Return the directional derivative of R m with respect to q, along v."""
    u, w = (q[at], q[at + 1], q[at + 2]), q[at + 3]
    du, dw = (v[at], v[at + 1], v[at + 2]), v[at + 3]
    own, along, change = w * dw - dot(u, du), dot(u, m), dot(du, m)
    first, second = cross(u, m), cross(du, m)
    return (2.0 * (own * m[0] + change * u[0] + along * du[0] + dw * first[0] + w * second[0]),
            2.0 * (own * m[1] + change * u[1] + along * du[1] + dw * first[1] + w * second[1]),
            2.0 * (own * m[2] + change * u[2] + along * du[2] + dw * first[2] + w * second[2]))


@inlined
def add_rotation_slope(q: np.ndarray, at: int, m: Vector, f: Vector, target: np.ndarray) -> None:
    """Add the derivative of f . R m with respect to the quaternion."""
    u, w = (q[at], q[at + 1], q[at + 2]), q[at + 3]
    both, along_f, along_m, lever = dot(m, f), dot(u, f), dot(u, m), cross(m, f)
    for i in range(3):
        target[at + i] += 2.0 * (along_f * m[i] + along_m * f[i] - both * u[i] + w * lever[i])
    target[at + 3] += 2.0 * (w * both + dot(u, lever))


@called
def lift_torques(rotations: np.ndarray, q: np.ndarray, forces: np.ndarray) -> None:
    """
    Convert forces with the layout of p to covectors with the layout of q, in place.

    A torque t in the frame of the body becomes 2 q (t, 0). The map from H_q to the rates of
    momenta converts that back to t.

    Parameters
    ----------
    rotations : np.ndarray of int
        Columns of q at which quaternions begin.
    q : np.ndarray, shape (d,)
        The coordinates.
    forces : np.ndarray, at least d long
        The forces, which are replaced.

    """
    # Backwards, because covectors have more columns: each moves to its own column or a later one.
    i, before = q.size - 1, rotations.size
    while i >= 0:
        if before > 0 and i == rotations[before - 1] + 3:
            i, before = i - 3, before - 1
            u, w = (q[i], q[i + 1], q[i + 2]), q[i + 3]
            torque = (forces[i - before], forces[i - before + 1], forces[i - before + 2])
            bend = cross(u, torque)
            for j in range(3):
                forces[i + j] = 2.0 * (w * torque[j] + bend[j])
            forces[i + 3] = -2.0 * dot(u, torque)
        else:
            forces[i] = forces[i - before]
        i -= 1
