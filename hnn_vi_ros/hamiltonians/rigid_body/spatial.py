# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Spatial vectors and inertias of bodies, one per row, in base axes with origin at each body.

A motion is (angular, linear), where linear is the velocity of the body's point at its origin; a
force or momentum is (moment about that origin, linear). An inertia is (m, h, I): mass, first
moment and, of the symmetric matrix about that origin, xx, xy, yy, xz, yz, zz. Row 0 is the base;
``offset`` is the origin of each body relative to that of its parent.
"""

from hnn_vi_ros.kernels import inlined
import numpy as np


@inlined
def body_momentum(inertia: np.ndarray, motion: np.ndarray, i: int, force: np.ndarray) -> None:
    """Store the momentum of body i in its row of ``force``."""
    m, x, y, z = inertia[i, 0], inertia[i, 1], inertia[i, 2], inertia[i, 3]
    xx, xy, yy = inertia[i, 4], inertia[i, 5], inertia[i, 6]
    xz, yz, zz = inertia[i, 7], inertia[i, 8], inertia[i, 9]
    a, b, c = motion[i, 0], motion[i, 1], motion[i, 2]
    u, v, w = motion[i, 3], motion[i, 4], motion[i, 5]
    force[i, 0] = xx * a + xy * b + xz * c + y * w - z * v
    force[i, 1] = xy * a + yy * b + yz * c + z * u - x * w
    force[i, 2] = xz * a + yz * b + zz * c + x * v - y * u
    force[i, 3] = m * u + b * z - c * y
    force[i, 4] = m * v + c * x - a * z
    force[i, 5] = m * w + a * y - b * x


@inlined
def set_parent_motion(offset: np.ndarray, parent: int, i: int, motion: np.ndarray) -> None:
    """Store the motion of the parent, at the origin of body i, in its row of ``motion``."""
    x, y, z = offset[i, 0], offset[i, 1], offset[i, 2]
    a, b, c = motion[parent, 0], motion[parent, 1], motion[parent, 2]
    motion[i, 0], motion[i, 1], motion[i, 2] = a, b, c
    motion[i, 3] = motion[parent, 3] + b * z - c * y
    motion[i, 4] = motion[parent, 4] + c * x - a * z
    motion[i, 5] = motion[parent, 5] + a * y - b * x


@inlined
def add_force_to_parent(offset: np.ndarray, parent: int, i: int, force: np.ndarray) -> None:
    """Add the force on body i to the force on its parent."""
    x, y, z = offset[i, 0], offset[i, 1], offset[i, 2]
    u, v, w = force[i, 3], force[i, 4], force[i, 5]
    force[parent, 0] += force[i, 0] + y * w - z * v
    force[parent, 1] += force[i, 1] + z * u - x * w
    force[parent, 2] += force[i, 2] + x * v - y * u
    force[parent, 3] += u
    force[parent, 4] += v
    force[parent, 5] += w


@inlined
def add_inertia_to_parent(offset: np.ndarray, parent: int, i: int, inertia: np.ndarray) -> None:
    """Add the inertia of body i to that of its parent, by the parallel axis theorem."""
    m, x, y, z = inertia[i, 0], offset[i, 0], offset[i, 1], offset[i, 2]
    a = inertia[i, 1] + 0.5 * m * x
    b = inertia[i, 2] + 0.5 * m * y
    c = inertia[i, 3] + 0.5 * m * z
    inertia[parent, 0] += m
    inertia[parent, 1] += inertia[i, 1] + m * x
    inertia[parent, 2] += inertia[i, 2] + m * y
    inertia[parent, 3] += inertia[i, 3] + m * z
    inertia[parent, 4] += inertia[i, 4] + 2.0 * (b * y + c * z)
    inertia[parent, 5] += inertia[i, 5] - a * y - b * x
    inertia[parent, 6] += inertia[i, 6] + 2.0 * (a * x + c * z)
    inertia[parent, 7] += inertia[i, 7] - a * z - c * x
    inertia[parent, 8] += inertia[i, 8] - b * z - c * y
    inertia[parent, 9] += inertia[i, 9] + 2.0 * (a * x + b * y)


@inlined
def cross_motion(left: np.ndarray, right: np.ndarray, i: int, motion: np.ndarray) -> None:
    """Store left x right, the change of ``right`` when it moves with ``left``, in row i."""
    a, b, c = left[i, 0], left[i, 1], left[i, 2]
    u, v, w = left[i, 3], left[i, 4], left[i, 5]
    x, y, z = right[i, 0], right[i, 1], right[i, 2]
    motion[i, 0], motion[i, 1], motion[i, 2] = b * z - c * y, c * x - a * z, a * y - b * x
    motion[i, 3] = b * right[i, 5] - c * right[i, 4] + v * z - w * y
    motion[i, 4] = c * right[i, 3] - a * right[i, 5] + w * x - u * z
    motion[i, 5] = a * right[i, 4] - b * right[i, 3] + u * y - v * x


@inlined
def add_cross_force(motion: np.ndarray, force: np.ndarray, i: int, change: np.ndarray) -> None:
    """Add the change of a force that is carried along by a motion."""
    a, b, c = motion[i, 0], motion[i, 1], motion[i, 2]
    u, v, w = motion[i, 3], motion[i, 4], motion[i, 5]
    x, y, z = force[i, 3], force[i, 4], force[i, 5]
    change[i, 0] += b * force[i, 2] - c * force[i, 1] + v * z - w * y
    change[i, 1] += c * force[i, 0] - a * force[i, 2] + w * x - u * z
    change[i, 2] += a * force[i, 1] - b * force[i, 0] + u * y - v * x
    change[i, 3] += b * z - c * y
    change[i, 4] += c * x - a * z
    change[i, 5] += a * y - b * x


@inlined
def power(motion: np.ndarray, force: np.ndarray, i: int) -> float:
    """Return motion . force of body i."""
    return (motion[i, 0] * force[i, 0] + motion[i, 1] * force[i, 1] + motion[i, 2] * force[i, 2]
            + motion[i, 3] * force[i, 3] + motion[i, 4] * force[i, 4]
            + motion[i, 5] * force[i, 5])


@inlined
def weight_power(motion: np.ndarray, mass: float, first: np.ndarray, gravity: np.ndarray, i: int
                 ) -> float:
    """Return motion . (h x g, m g) of body i, with the first moment h in ``first[i, 1:4]``."""
    x, y, z = first[i, 1], first[i, 2], first[i, 3]
    a, b, c = gravity[0], gravity[1], gravity[2]
    return (motion[i, 0] * (y * c - z * b) + motion[i, 1] * (z * a - x * c)
            + motion[i, 2] * (x * b - y * a)
            + mass * (motion[i, 3] * a + motion[i, 4] * b + motion[i, 5] * c))
