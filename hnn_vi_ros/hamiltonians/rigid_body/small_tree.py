# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
H of a tree of few bodies as a formula, which becomes code without loops.

The composite bodies of ``sweeps`` are computed here in the frame of each body: a joint then only
rotates the bodies behind it, and M depends on as few angles as possible. Entries that are zero or
one for this robot, such as most entries of rotations between its axes, cost no operation. With
M = L D L^T and y = L^-1 p,

    H = sum of y_i^2 / (2 D_i) + V(q).
"""

from collections.abc import Callable, Mapping, Sequence

from hnn_vi_ros.hamiltonians.expressions import Graph
from hnn_vi_ros.hamiltonians.rigid_body.spatial import (
    add_force_to_parent, add_inertia_to_parent, body_momentum, power)
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies, Following
from hnn_vi_ros.hamiltonians.straight_code import graph_kernels
from hnn_vi_ros.hamiltonians.tracing import Symbol
from hnn_vi_ros.kernels import Kernel
import numpy as np

# Maximum number of joints for code without loops, which takes at most a fourth of the time of
# sweeps; it grows with the cube of their number, like the time to compile it.
MOST_STRAIGHT = 3
# Entries of rotations closer to -1, 0 and 1 than this are replaced by these numbers.
_ENTRY_TOLERANCE = 1e-14


def small_tree_kernel(bodies: Bodies, following: Following | None = None) -> Kernel:
    """Return the functions of H of some bodies as code without loops; see sweeps."""
    graph, d = Graph(), bodies.parent.size - 1 if following is None else following.size
    names, momenta = ([f'{kind}{i}' for i in range(d)] for kind in 'qp')
    q, p = ([Symbol(graph, graph.name(name)) for name in both] for both in (names, momenta))
    values: dict[str, float] = {}

    def symbols(array: np.ndarray) -> np.ndarray:
        made = np.zeros(array.shape, dtype=object)
        for place in zip(*np.nonzero(array), strict=True):
            name = f'constant {len(values)}'
            values[name] = float(array[place])
            made[place] = Symbol(graph, graph.name(name))
        return made

    turns = bodies.placement[:, :9]
    whole = np.abs(turns - np.round(turns)) < _ENTRY_TOLERANCE
    turns = np.where(whole, np.round(turns), symbols(np.where(whole, 0.0, turns)))
    placement = np.hstack([turns, symbols(bodies.placement[:, 9:])])
    if following is None:
        joints, rows = ([own[at] for at in bodies.coordinate[1:]] for own in (q, p))
    else:
        G = symbols(following.matrix())
        joints, rows = G @ q + symbols(following.offset), p
    mass, first = _mass_and_first_moment(bodies._replace(
        placement=placement, inertia=symbols(bodies.inertia),
        armature=symbols(bodies.armature)), joints)
    energy = symbols(bodies.load[1:]) @ joints - first @ symbols(bodies.gravity)
    if following is not None:
        mass = G.T @ (mass + np.tril(mass, -1).T) @ G
    return mass_kernels(graph, mass, energy, rows, (names, momenta))(values)


def mass_kernels(graph: Graph, mass: np.ndarray, energy: Symbol, y: list[Symbol],
                 names: tuple[Sequence[str], Sequence[str]]
                 ) -> Callable[[Mapping[str, float]], Kernel]:
    """
    Return the functions of H = p . M^-1 p / 2 + V as code without loops, for values of names.

    Parameters
    ----------
    graph : Graph
        The graph with M and V.
    mass : np.ndarray of Symbol, shape (d, d)
        M in its lower triangle; overwritten.
    energy : Symbol
        V.
    y : list of Symbol
        p in the order of the rows of M; overwritten.
    names : pair of sequence of str
        Names of coordinates and momenta.

    """
    for j in range(len(y)):
        inverse = Symbol(graph, graph.number(1.0)) / mass[j, j]
        for i in range(j + 1, len(y)):
            factor = mass[i, j] * inverse
            y[i] = y[i] - factor * y[j]
            for k in range(j + 1, i + 1):
                mass[i, k] = mass[i, k] - factor * mass[k, j]
        energy = energy + 0.5 * y[j] * y[j] * inverse
    return graph_kernels(graph, energy.node, *names)


def _mass_and_first_moment(bodies: Bodies, values: Sequence[Symbol]
                           ) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower triangle of M, and the total first moment, for values of the joints."""
    n = bodies.parent.size
    axis, force = (np.zeros((n, 6), dtype=object) for _ in range(2))
    mass, inertia = np.zeros((n - 1, n - 1), dtype=object), bodies.inertia.copy()
    turns, offset = bodies.placement[:, :9].reshape(n, 3, 3), bodies.placement[:, 9:].copy()
    slides = bodies.prismatic == 1
    for i in range(1, n):
        axis[i, 5 if slides[i] else 2] = 1.0
        if slides[i]:
            offset[i] = offset[i] + turns[i, :, 2] * values[i - 1]
    inertia[0] = 0.0
    for i in range(n - 1, 0, -1):
        body_momentum(inertia, axis, i, force)
        mass[i - 1, i - 1] = power(axis, force, i) + bodies.armature[i]
        at, parent = i, bodies.parent[i]
        while parent > 0:
            for half in (slice(0, 3), slice(3, 6)):
                force[at, half] = turns[at] @ _in_zero_axes(
                    force[at, half], slides[at], values[at - 1])
            force[parent] = 0.0
            add_force_to_parent(offset, parent, at, force)
            mass[i - 1, parent - 1] = power(axis, force, parent)
            at, parent = parent, bodies.parent[parent]
        inertia[i, 1:4] = turns[i] @ _in_zero_axes(inertia[i, 1:4], slides[i], values[i - 1])
        if bodies.parent[i] > 0:
            xx, xy, yy, xz, yz, zz = inertia[i, 4:]
            if not slides[i]:
                c, s = values[i - 1].cos(), values[i - 1].sin()
                change = s * (xx - yy) + 2.0 * (c * xy)
                xx, yy, xy = xx - s * change, yy + s * change, c * change - xy
                xz, yz = c * xz - s * yz, s * xz + c * yz
            moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=object)
            inertia[i, 4:] = (turns[i] @ moments @ turns[i].T)[np.tril_indices(3)]
        add_inertia_to_parent(offset, bodies.parent[i], i, inertia)
    return mass, inertia[0, 1:4]


def _in_zero_axes(vector: np.ndarray, slides: bool, angle: Symbol) -> np.ndarray:
    """Return a vector of a body in its axes at joint value zero."""
    if slides:
        return vector
    (x, y, z), c, s = vector, angle.cos(), angle.sin()
    return np.array([c * x - s * y, s * x + c * y, z], dtype=object)
