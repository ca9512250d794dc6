# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Mass matrix and potential of a planar chain of rigid links, from its parameters.

Links rotate, and the first may be mounted on carts that move along straight rails. phi = A q are
the angles of links from the vertical, zero for carts; F has the rows of A, and e_i for a cart:

    M = sum_i I_i F_i F_i^T + sum_(i<j) C_ij cos(phi_i - phi_j) (F_i F_j^T + F_j F_i^T)
        + sum_(i>1) R_i e_i e_i^T
    V = sum_i G_i (1 - cos phi_i),  G_i q_i for a cart
        + q . k q / 2 - T . q + sum_(n>1) sum_i S_ni q_i^(n+1) / (n + 1)
        + sum_x B_x max(q_1 - x, 0)^2 / 2  with springs

I_i = J_i + m_i c_i^2 + l_i^2 sum_(k>i) m_k, C_ij = l_i (m_j c_j + l_j sum_(k>j) m_k) and
G_i = g (m_i c_i + l_i sum_(k>i) m_k), for masses m, lengths l, centres of mass c and inertias J
about them; R_i is the inertia of a motor on joint i. Only these combinations are identifiable.
For a cart, I_i is all that it carries, C_ij = m_j c_j + l_j sum_(k>j) m_k, and G_i a weight along
its rail. G_i < 0 if zero is upright. k is the stiffness of springs at joints and between them,
and T their force at q = 0 (for a cart, a part of G_i). S_n is the part of a spring's force that
grows with the n-th power, up to the fifth. B_x is the change of the stiffness of the spring of a
single coordinate at the knot x: a spline of first degree of the force. M and V are linear in
these parameters. Where sensors of rotating joints are off by constants z, q is measured, and
q - z is in place of it in M and V.

M is positive definite at all q if the matrix K of I_i and C_ij is, and without motors only if:
cos(phi_i - phi_j) is a Gram matrix, and Schur's product theorem holds.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import combinations
from typing import NamedTuple

from hnn_vi_ros.hamiltonians import Graph, mass_kernels, Symbol
from hnn_vi_ros.kernels import Kernel
import numpy as np

# Minimum and maximum number of coordinates. In files and configurations from before 0.4, the
# angles of the first two kinds are the features of V.
PLANAR_CHAIN = 'planar_chain'
CHAINS = {'pendulum': (1, 1), 'double_pendulum': (2, 2), PLANAR_CHAIN: (1, 4)}
# Highest power of the force of springs.
HIGHEST_POWER = 5
# Kind of the parameters that are offsets of sensors.
OFFSET = 'sensor_offset'
# Beginning of the names of the changes of a spring's stiffness; their knots follow.
_ABOVE = 'stiffness_above_'


class Terms(NamedTuple):
    """
    M = sum_k A_k cos(g_k . q), and a potential V.

        V = sum_l c_l (1 - cos(h_l . q)) + w . q + q . k q / 2 + sum_ni s_ni q_i^(n+1) / (n + 1)
            + sum_j b_j max(q_1 - x_j, 0)^2 / 2

    Parameters
    ----------
    mass_rows : np.ndarray, shape (k, d)
        g_k.
    matrices : np.ndarray, shape (k, d, d)
        A_k.
    rows : np.ndarray, shape (l, d)
        h_l.
    weights : np.ndarray, shape (l,)
        c_l.
    pull : np.ndarray, shape (d,)
        w.
    stiffness : np.ndarray, shape (d, d)
        k.
    powers : np.ndarray, shape (4, d)
        s_n for n of 2 to 5.
    knots, bends : np.ndarray, shape (j,)
        x_j and b_j.

    """

    mass_rows: np.ndarray
    matrices: np.ndarray
    rows: np.ndarray
    weights: np.ndarray
    pull: np.ndarray
    stiffness: np.ndarray
    powers: np.ndarray
    knots: np.ndarray
    bends: np.ndarray


def chain_angles(kinds: Sequence[str], features: Sequence[Sequence[float]] = ()
                 ) -> list[list[list[float]]]:
    """
    Return candidates for the angles A of the links of a chain, the likelier first.

    Candidates are the features, if valid; each coordinate; and sums up to each coordinate.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of the coordinates.
    features : sequence of sequence of float, optional
        Known combinations of coordinates.

    """
    turns = np.array([kind != 'prismatic' for kind in kinds])
    d, own = len(kinds), np.diag(turns.astype(float))
    found = []
    rows = np.reshape([row for row in features if np.any(np.array(row)[turns])], (-1, d))
    if len(rows) == turns.sum() and not rows[:, ~turns].any():
        known = np.zeros((d, d))
        known[turns] = rows
        found.append(known)
    found += [own, np.tril(np.ones((d, d))) @ own * turns[:, None]]
    unique = [one for k, one in enumerate(found)
              if not any(np.array_equal(one, other) for other in found[:k])]
    return [one.tolist() for one in unique if is_chain(PLANAR_CHAIN, one, kinds)]


def is_chain(kind: str, angles: Sequence[Sequence[float]] | np.ndarray, kinds: Sequence[str]
             ) -> bool:
    """Return True if these can be the angles of the links of a chain, with carts first."""
    d, (least, most) = len(kinds), CHAINS[kind]
    A, carts = np.array(angles), [*kinds].count('prismatic')
    return bool(least <= d <= most and A.shape == (d, d)
                and 'prismatic' not in kinds[carts:]
                and not A[:carts].any() and not A[:, :carts].any()
                and np.linalg.matrix_rank(A) == d - carts)


def parameter_places(angles: Sequence[Sequence[float]], springs: int = 0, offsets: bool = False,
                     knots: Sequence[float] = ()) -> list[tuple[str, tuple[int, ...]]]:
    """
    Return the kind of each parameter, and its link or its two links.

    Forces of springs grow up to the power ``springs``; 0 for none. ``offsets`` are of sensors.
    At ``knots`` the stiffness of the spring of a single coordinate changes.
    """
    d, carts = len(angles), sum(not any(row) for row in angles)
    # For links whose coordinates are their own angles, it is a part of the inertia.
    relative = bool((np.count_nonzero(angles, axis=1) > 1).any())
    links: list[tuple[int, ...]] = [(i,) for i in range(d)]
    pairs: list[tuple[int, ...]] = [*combinations(range(d), 2)]
    places = {'inertia': links, 'coupling': pairs, 'gravity': links,
              'motor_inertia': links[carts + 1:] if relative else []}
    if springs:
        places |= {'stiffness': [*links, *pairs], 'spring_force': links[carts:]} | {
            f'spring{power}_': links for power in range(2, springs + 1)} | {
            f'{_ABOVE}{knot}_': links for knot in knots}
    places |= {OFFSET: links[carts:]} if offsets else {}
    return [(kind, place) for kind, own in places.items() for place in own]


def parameter_names(angles: Sequence[Sequence[float]], springs: int = 0, offsets: bool = False,
                    knots: Sequence[float] = ()) -> list[str]:
    """Return the names: inertia1, coupling12, gravity1, stiffness1, spring_force1, spring2_1."""
    return [kind + ''.join(str(link + 1) for link in place)
            for kind, place in parameter_places(angles, springs, offsets, knots)]


def is_spring(name: str) -> bool:
    """Return True if this is the name of a parameter of springs."""
    return name.startswith(('stiffness', 'spring'))


def has_offsets(parameters: Iterable[str]) -> bool:
    """Return True if the offsets of sensors are among the parameters of a chain."""
    return any(name.startswith(OFFSET) for name in parameters)


def sensor_offsets(d: int, parameters: Mapping[str, float]) -> np.ndarray:
    """Return the offsets of the sensors of a chain, shape (d,)."""
    return np.array([parameters.get(f'{OFFSET}{i + 1}', 0.0) for i in range(d)])


def power_of_springs(parameters: Iterable[str]) -> int:
    """Return the highest power of the springs among parameters of a chain, 0 for none."""
    return max((power for power in range(1, HIGHEST_POWER + 1)
                if (f'spring{power}_1' if power > 1 else 'stiffness1') in parameters), default=0)


def knots_of(parameters: Iterable[str]) -> tuple[float, ...]:
    """Return the coordinates at which the stiffness of a spring changes."""
    return tuple(float(name.removeprefix(_ABOVE).removesuffix('_1'))
                 for name in parameters if name.startswith(_ABOVE))


def chain_terms(angles: Sequence[Sequence[float]], parameters: Mapping[str, float]) -> Terms:
    """Return M and V of a chain with these parameters."""
    A = np.array(angles, dtype=np.float64)
    d, slides = len(A), ~A.any(axis=1)
    F = A + np.diag(slides)
    constant = np.einsum('i,ij,ik->jk', [parameters[f'inertia{i + 1}'] for i in range(d)], F, F)
    for i in range(1, d):
        constant[i, i] += parameters.get(f'motor_inertia{i + 1}', 0.0)
    rows, matrices = [np.zeros(d)], [constant]
    for i in range(d):
        for j in range(i + 1, d):
            both = np.outer(F[i], F[j])
            rows.append(A[i] - A[j])
            matrices.append(parameters[f'coupling{i + 1}{j + 1}'] * (both + both.T))
    gravity = np.array([parameters[f'gravity{i + 1}'] for i in range(d)])
    force = np.array([parameters.get(f'spring_force{i + 1}', 0.0) for i in range(d)])
    stiffness = symmetric(d, parameters, 'stiffness', 'stiffness')
    powers = np.array([[parameters.get(f'spring{power}_{i + 1}', 0.0) for i in range(d)]
                       for power in range(2, HIGHEST_POWER + 1)])
    knots = knots_of(parameters)
    return Terms(np.array(rows), np.array(matrices), A, gravity, gravity * slides - force,
                 stiffness, powers, np.array(knots),
                 np.array([parameters[f'{_ABOVE}{knot}_1'] for knot in knots]))


def unit_terms(angles: Sequence[Sequence[float]], springs: int = 0, offsets: bool = False,
               knots: Sequence[float] = ()) -> list[Terms]:
    """Return M and V, linear in the parameters, for each parameter at 1 and others at 0."""
    names = parameter_names(angles, springs, offsets, knots)
    return [chain_terms(angles, dict(zip(names, row, strict=True))) for row in np.eye(len(names))]


def chain_kernel(angles: Sequence[Sequence[float]], parameters: Mapping[str, float]) -> Kernel:
    """Return the functions of H of a chain, as code without loops."""
    terms = power_of_springs(parameters), has_offsets(parameters), knots_of(parameters)
    return _kernels(tuple(map(tuple, angles)), *terms)({
        name: parameters[name] for name in parameter_names(angles, *terms)})


@cache
def _kernels(angles: tuple[tuple[float, ...], ...], springs: int, offsets: bool,
             knots: tuple[float, ...]) -> Callable[[Mapping[str, float]], Kernel]:
    """Return the functions as a function of the parameters; fits try many of them."""
    graph, d = Graph(), len(angles)
    names, momenta = ([f'{kind}{i}' for i in range(d)] for kind in 'qp')
    q, p = ([Symbol(graph, graph.name(name)) for name in both] for both in (names, momenta))
    for kind, place in parameter_places(angles, 0, offsets):
        if kind == OFFSET:
            q[place[0]] -= Symbol(graph, graph.name(f'{OFFSET}{place[0] + 1}'))

    def combined(row: np.ndarray) -> Symbol:
        return sum((float(row[i]) * q[i] for i in np.flatnonzero(row)),
                   Symbol(graph, graph.number(0.0)))
    mass, energy = np.zeros((d, d), dtype=object), combined(np.zeros(d))
    for name, terms in zip(parameter_names(angles, springs, knots=knots),
                           unit_terms(angles, springs, knots=knots), strict=True):
        parameter = Symbol(graph, graph.name(name))
        for row, matrix in zip(terms.mass_rows, terms.matrices, strict=True):
            for i, j in np.argwhere(np.tril(matrix)):
                mass[i, j] += float(matrix[i, j]) * (parameter * combined(row).cos())
        for row, weight in zip(terms.rows, terms.weights, strict=True):
            energy += float(weight) * (parameter * (1.0 - combined(row).cos()))
        energy += parameter * combined(terms.pull)
        for i, j in np.argwhere(terms.stiffness):
            energy += 0.5 * (parameter * q[i] * q[j])
        for n, i in np.argwhere(terms.powers).tolist():
            energy += 1.0 / (n + 3) * (parameter * q[i]**(n + 3))
        for knot in terms.knots[terms.bends != 0.0].tolist():
            above = q[0] - knot
            energy += 0.5 * parameter * Symbol(graph, graph.where(
                above.node, (above * above).node, graph.number(0.0)))
    return mass_kernels(graph, mass, energy, p, (names, momenta))


def symmetric(d: int, parameters: Mapping[str, float], own: str = 'inertia',
              pair: str = 'coupling') -> np.ndarray:
    """Return K, shape (d, d), of inertias and couplings, or of others; 0 for what is absent."""
    K = np.diag([parameters.get(f'{own}{i + 1}', 0.0) for i in range(d)])
    for i in range(d):
        for j in range(i + 1, d):
            K[i, j] = K[j, i] = parameters.get(f'{pair}{i + 1}{j + 1}', 0.0)
    return K
