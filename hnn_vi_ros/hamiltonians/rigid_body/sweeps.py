# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Recursions over a tree of bodies: outward from the base, and inward from the tips.

With joint axes S_j, velocities v_i = sum over the path to body i of S_k q'_k, and inertias I_i,

    M_jk = S_j . I_j^c S_k (k on the path to j),    I_j^c = sum of I_i,    h_j = sum of I_i v_i

over the bodies i behind joint j (composite bodies), and at fixed p, with a_g = (0, g),

    H_p = v = M^-1 p,    H_q,j = (S_j x v_j) . h_j - S_j . (I_j^c a_g)

since d v_i / dq_j = S_j x (v_i - v_j) and d I_i / dq_j = S_j x* I_i - I_i S_j x.

References
----------
R. Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 2 and 6.

"""

from typing import NamedTuple

from hnn_vi_ros.hamiltonians.rigid_body.spatial import (
    add_cross_force, add_force_to_parent, add_inertia_to_parent, body_momentum, cross_motion,
    power, set_parent_motion, weight_power)
from hnn_vi_ros.kernels import factorise, inlined, solve_cholesky
import numpy as np
from numpy.typing import DTypeLike


class Bodies(NamedTuple):
    """
    A tree of d bodies, each behind one joint; row 0 of the arrays is the base, which is fixed.

    In the axes of a body its joint rotates about z, or slides along it.

    Parameters
    ----------
    parent : np.ndarray of int, shape (d + 1,)
        Row of the parent of each body, which precedes it.
    coordinate : np.ndarray of int, shape (d + 1,)
        Index of the coordinate of its joint.
    prismatic : np.ndarray of int, shape (d + 1,)
        1 if the joint slides, 0 if it rotates.
    placement : np.ndarray, shape (d + 1, 12)
        The rotation, row by row, and the origin [m] in the parent's frame, at q = 0.
    inertia : np.ndarray, shape (d + 1, 10)
        m [kg], h [kg m] and I [kg m2] in the body's own frame; see spatial.
    armature : np.ndarray, shape (d + 1,)
        Inertia of the rotor behind each joint, in its coordinate [kg m2], [kg].
    gravity : np.ndarray, shape (3,)
        g [m/s2], in the frame of the base.
    load : np.ndarray, shape (d + 1,)
        A constant force against each coordinate [N m], [N].

    """

    parent: np.ndarray
    coordinate: np.ndarray
    prismatic: np.ndarray
    placement: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    gravity: np.ndarray
    load: np.ndarray


class Following(NamedTuple):
    """
    Joints that follow others: the values q of d joints are G y + c, with k coordinates y.

    Parameters
    ----------
    leader : np.ndarray of int, shape (d,)
        Column of the one entry in each row of G.
    multiplier, offset : np.ndarray, shape (d,)
        The entries, and c.

    """

    leader: np.ndarray
    multiplier: np.ndarray
    offset: np.ndarray

    @property
    def size(self) -> int:
        """Return k."""
        return int(self.leader.max()) + 1

    def matrix(self) -> np.ndarray:
        """Return G, shape (d, k)."""
        G = np.zeros((self.leader.size, self.size))
        G[np.arange(self.leader.size), self.leader] = self.multiplier
        return G


class TreeWork(NamedTuple):
    """
    Workspace for one state of d bodies; names ending in ``_v`` are changes along a direction.

    Parameters
    ----------
    rotation : np.ndarray, shape (d + 1, 9)
        Rotation of each body from the base, row by row.
    offset : np.ndarray, shape (d + 1, 3)
        Origin of each body relative to its parent's, in the axes of the base [m].
    inertia, composite : np.ndarray, shape (d + 1, 10)
        Inertia of each body, and including all bodies behind it.
    axis, velocity, momentum : np.ndarray, shape (d + 1, 6)
        S, v, and the momentum h of all bodies behind the joint.
    product : np.ndarray, shape (d + 1, 6)
        S x v.
    shift, axis_v, velocity_v, momentum_v : np.ndarray, shape (d + 1, 6)
        The displacement of each body along a direction, and the changes.
    spare, impulse : np.ndarray, shape (d + 1, 6)
        Temporary vectors.
    first_v : np.ndarray, shape (d + 1, 4)
        Change of the first moment of all bodies behind a joint, from index 1.
    mass : np.ndarray, shape (d, d)
        M, in its lower triangle, and then its Cholesky factor.
    rates, rates_v : np.ndarray, shape (d,)
        Velocities of the joints in the order of the bodies.

    """

    rotation: np.ndarray
    offset: np.ndarray
    inertia: np.ndarray
    composite: np.ndarray
    axis: np.ndarray
    velocity: np.ndarray
    momentum: np.ndarray
    product: np.ndarray
    shift: np.ndarray
    axis_v: np.ndarray
    velocity_v: np.ndarray
    momentum_v: np.ndarray
    spare: np.ndarray
    impulse: np.ndarray
    first_v: np.ndarray
    mass: np.ndarray
    rates: np.ndarray
    rates_v: np.ndarray

    @classmethod
    def empty(cls, d: int, dtype: DTypeLike = np.float64) -> 'TreeWork':
        """Return workspace for d bodies, with the base at rest."""
        widths = (9, 3, 10, 10, *[6] * 10, 4)
        work = cls._make([*(np.zeros((d + 1, n), dtype) for n in widths),
                          np.zeros((d, d), dtype), *np.zeros((2, d), dtype)])
        work.rotation[0, ::4] = 1
        return work


class TreeParameters(NamedTuple):
    """Parameters of the functions of a tree, their first argument: the bodies, and workspace."""

    bodies: Bodies
    work: TreeWork


@inlined
def fill_frames(bodies: Bodies, work: TreeWork, q: np.ndarray, start: int) -> None:
    """Fill positions, axes and inertias of the bodies for the state at offset ``start``."""
    rotation, offset, axis = work.rotation, work.offset, work.axis
    placement, own, inertia = bodies.placement, bodies.inertia, work.inertia
    inertia[0, :] = 0.0
    for i in range(1, bodies.parent.size):
        parent, value = bodies.parent[i], q[start + bodies.coordinate[i]]
        slides = bodies.prismatic[i] == 1
        cosine, sine = np.cos(value), np.sin(value)
        inertia[i, 0] = own[i, 0]
        for k in range(3):
            x, y, z = (rotation[parent, 3 * k], rotation[parent, 3 * k + 1],
                       rotation[parent, 3 * k + 2])
            a = x * placement[i, 0] + y * placement[i, 3] + z * placement[i, 6]
            b = x * placement[i, 1] + y * placement[i, 4] + z * placement[i, 7]
            c = x * placement[i, 2] + y * placement[i, 5] + z * placement[i, 8]
            offset[i, k] = x * placement[i, 9] + y * placement[i, 10] + z * placement[i, 11]
            if slides:
                offset[i, k] += c * value
                axis[i, k], axis[i, 3 + k] = 0.0, c
            else:
                a, b = cosine * a + sine * b, cosine * b - sine * a
                axis[i, k], axis[i, 3 + k] = c, 0.0
            rotation[i, 3 * k], rotation[i, 3 * k + 1], rotation[i, 3 * k + 2] = a, b, c
            inertia[i, 1 + k] = a * own[i, 1] + b * own[i, 2] + c * own[i, 3]
            u = a * own[i, 4] + b * own[i, 5] + c * own[i, 7]
            v = a * own[i, 5] + b * own[i, 6] + c * own[i, 8]
            w = a * own[i, 7] + b * own[i, 8] + c * own[i, 9]
            for j in range(k + 1):
                inertia[i, 4 + k * (k + 1) // 2 + j] = (
                    u * rotation[i, 3 * j] + v * rotation[i, 3 * j + 1]
                    + w * rotation[i, 3 * j + 2])


@inlined
def fill_mass_matrix(bodies: Bodies, work: TreeWork) -> None:
    """Fill the composite inertias and the lower triangle of M; call ``fill_frames`` first."""
    composite, axis, offset, force = work.composite, work.axis, work.offset, work.spare
    for i in range(bodies.parent.size):
        for k in range(10):
            composite[i, k] = work.inertia[i, k]
    for i in range(bodies.parent.size - 1, 0, -1):
        add_inertia_to_parent(offset, bodies.parent[i], i, composite)
        body_momentum(composite, axis, i, force)
        x, y, z = force[i, 0], force[i, 1], force[i, 2]
        u, v, w = force[i, 3], force[i, 4], force[i, 5]
        for j in range(i - 1):
            work.mass[i - 1, j] = 0.0
        work.mass[i - 1, i - 1] = power(axis, force, i) + bodies.armature[i]
        at, j = i, bodies.parent[i]
        while j > 0:
            # Moment about the origin of the next body towards the base.
            a, b, c = offset[at, 0], offset[at, 1], offset[at, 2]
            x, y, z = x + b * w - c * v, y + c * u - a * w, z + a * v - b * u
            work.mass[i - 1, j - 1] = (axis[j, 0] * x + axis[j, 1] * y + axis[j, 2] * z
                                       + axis[j, 3] * u + axis[j, 4] * v + axis[j, 5] * w)
            at, j = j, bodies.parent[j]


@inlined
def solve_rates(bodies: Bodies, work: TreeWork, p: np.ndarray, start: int) -> None:
    """Fill v = M^-1 p, NaN if M is not positive definite, and store the factor of M."""
    regular = factorise(work.mass)
    for i in range(work.rates.size):
        work.rates[i] = p[start + bodies.coordinate[i + 1]] if regular else np.nan
    solve_cholesky(work.mass, work.rates)


@inlined
def fill_velocities(bodies: Bodies, work: TreeWork) -> None:
    """Fill velocities, momenta and S x v; call ``solve_rates`` first."""
    velocity, momenta, axis = work.velocity, work.momentum, work.axis
    for k in range(6):
        momenta[0, k] = 0.0
    for i in range(1, bodies.parent.size):
        set_parent_motion(work.offset, bodies.parent[i], i, velocity)
        for k in range(6):
            velocity[i, k] += axis[i, k] * work.rates[i - 1]
        body_momentum(work.inertia, velocity, i, momenta)
        cross_motion(axis, velocity, i, work.product)
    for i in range(bodies.parent.size - 1, 0, -1):
        add_force_to_parent(work.offset, bodies.parent[i], i, momenta)


@inlined
def force_of(bodies: Bodies, work: TreeWork, i: int) -> float:
    """Return H_q of the joint of body i; call ``fill_velocities`` first."""
    composite = work.composite
    return (power(work.product, work.momentum, i)
            - weight_power(work.axis, composite[i, 0], composite, bodies.gravity, i)
            + bodies.load[i])


@inlined
def fill_changes(bodies: Bodies, work: TreeWork, v_q: np.ndarray, start: int) -> None:
    """Fill the changes along v_q at constant rates; call ``fill_velocities`` first."""
    shift, axis, axis_v = work.shift, work.axis, work.axis_v
    velocity_v, momentum_v, first_v, spare = (
        work.velocity_v, work.momentum_v, work.first_v, work.spare)
    for k in range(6):
        momentum_v[0, k] = 0.0
    for k in range(4):
        first_v[0, k] = 0.0
    for i in range(1, bodies.parent.size):
        set_parent_motion(work.offset, bodies.parent[i], i, shift)
        set_parent_motion(work.offset, bodies.parent[i], i, velocity_v)
        for k in range(6):
            shift[i, k] += axis[i, k] * v_q[start + bodies.coordinate[i]]
        cross_motion(shift, axis, i, axis_v)
        for k in range(6):
            velocity_v[i, k] += axis_v[i, k] * work.rates[i - 1]
        # I v changes by shift x* (I v) + I (v' - shift x v), and h by the momentum of the shift.
        body_momentum(work.inertia, shift, i, spare)
        for k in range(3):
            first_v[i, 1 + k] = spare[i, 3 + k]
        cross_motion(shift, work.velocity, i, spare)
        for k in range(6):
            spare[i, k] = velocity_v[i, k] - spare[i, k]
        body_momentum(work.inertia, spare, i, momentum_v)
        body_momentum(work.inertia, work.velocity, i, spare)
        add_cross_force(shift, spare, i, momentum_v)
    for i in range(bodies.parent.size - 1, 0, -1):
        parent = bodies.parent[i]
        add_force_to_parent(work.offset, parent, i, momentum_v)
        for k in range(1, 4):
            first_v[parent, k] += first_v[i, k]


@inlined
def solve_rate_changes(bodies: Bodies, work: TreeWork, v_p: np.ndarray, start: int) -> None:
    """Fill the change of the rates, M^-1 (v_p - (M v)')."""
    for i in range(1, bodies.parent.size):
        work.rates_v[i - 1] = (v_p[start + bodies.coordinate[i]]
                               - power(work.axis_v, work.momentum, i)
                               - power(work.axis, work.momentum_v, i))
    solve_cholesky(work.mass, work.rates_v)


@inlined
def add_rate_changes(bodies: Bodies, work: TreeWork) -> None:
    """Add the contributions of the changes of the rates; call ``solve_rate_changes`` first."""
    axis, momentum_v, rate, impulse = work.axis, work.momentum_v, work.spare, work.impulse
    for k in range(6):
        impulse[0, k] = 0.0
    for i in range(1, bodies.parent.size):
        set_parent_motion(work.offset, bodies.parent[i], i, rate)
        for k in range(6):
            rate[i, k] += axis[i, k] * work.rates_v[i - 1]
            work.velocity_v[i, k] += rate[i, k]
        body_momentum(work.inertia, rate, i, impulse)
    for i in range(bodies.parent.size - 1, 0, -1):
        # The bodies behind it have been processed.
        for k in range(6):
            momentum_v[i, k] += impulse[i, k]
        add_force_to_parent(work.offset, bodies.parent[i], i, impulse)


@inlined
def force_change_of(bodies: Bodies, work: TreeWork, i: int) -> float:
    """Return the change of H_q of the joint of body i; call ``add_rate_changes`` first."""
    composite, spare = work.composite, work.spare
    cross_motion(work.axis_v, work.velocity, i, spare)
    change = power(spare, work.momentum, i)
    cross_motion(work.axis, work.velocity_v, i, spare)
    return (change + power(spare, work.momentum, i) + power(work.product, work.momentum_v, i)
            - weight_power(work.axis_v, composite[i, 0], composite, bodies.gravity, i)
            - weight_power(work.axis, 0.0, work.first_v, bodies.gravity, i))
