# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Mass matrix and potential of a chain of rigid links that turn in a plane, by its parameters.

With the angles phi = F q of the links from the vertical, and F_i the rows of features,

    M = sum_i I_i F_i F_i^T + sum_(i<j) C_ij cos(phi_i - phi_j) (F_i F_j^T + F_j F_i^T)
        + sum_(i>1) R_i e_i e_i^T
    V = sum_i G_i (1 - cos phi_i)

I_i = J_i + m_i c_i^2 + l_i^2 sum_(k>i) m_k, C_ij = l_i (m_j c_j + l_j sum_(k>j) m_k) and
G_i = g (m_i c_i + l_i sum_(k>i) m_k), for masses m, lengths l, centres of mass c and inertias J
about them; R_i is the inertia of a motor that turns with joint i. No motion tells more of it.
All of it is linear in these parameters. G_i < 0 where zero is upright.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

# How many links they have.
CHAINS = {'pendulum': 1, 'double_pendulum': 2}


class Terms(NamedTuple):
    """
    M = sum_k A_k cos(g_k . q), V = sum_l c_l (1 - cos(h_l . q)).

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

    """

    mass_rows: np.ndarray
    matrices: np.ndarray
    rows: np.ndarray
    weights: np.ndarray


def no_terms(d: int) -> Terms:
    """Return M = 0 and V = 0."""
    return Terms(np.zeros((0, d)), np.zeros((0, d, d)), np.zeros((0, d)), np.zeros(0))


def check_chain(kind: str, features: Sequence[Sequence[float]], d: int) -> None:
    """Raise ValueError if these cannot be the angles of the links of a chain."""
    links = CHAINS[kind]
    if d != links:
        raise ValueError(f'prior: {kind} has {links} coordinates, not {d}')
    if len(features) != d or np.linalg.matrix_rank(np.array(features)) < d:
        raise ValueError(f'prior: {kind}: features must be the angles of its {links} links from '
                         'the vertical: [a, a + b] for an angle b from the first link, [a, b] for '
                         'two from the vertical')


def parameter_names(features: Sequence[Sequence[float]]) -> list[str]:
    """Return the names of the parameters: inertia, coupling, gravity, motor_inertia."""
    d = len(features)
    own = [f'inertia{i + 1}' for i in range(d)]
    pairs = [f'coupling{i + 1}{j + 1}' for i in range(d) for j in range(i + 1, d)]
    gravity = [f'gravity{i + 1}' for i in range(d)]
    # For links whose coordinates are their own angles, it is a part of the inertia.
    relative = bool((np.count_nonzero(features, axis=1) > 1).any())
    motors = [f'motor_inertia{i + 1}' for i in range(1, d)] if relative else []
    return own + pairs + gravity + motors


def chain_terms(features: Sequence[Sequence[float]], parameters: Mapping[str, float]) -> Terms:
    """Return M and V of a chain of these parameters."""
    F = np.array(features, dtype=np.float64)
    d = len(F)
    constant = np.einsum('i,ij,ik->jk', [parameters[f'inertia{i + 1}'] for i in range(d)], F, F)
    for i in range(1, d):
        constant[i, i] += parameters.get(f'motor_inertia{i + 1}', 0.0)
    rows, matrices = [np.zeros(d)], [constant]
    for i in range(d):
        for j in range(i + 1, d):
            both = np.outer(F[i], F[j])
            rows.append(F[i] - F[j])
            matrices.append(parameters[f'coupling{i + 1}{j + 1}'] * (both + both.T))
    return Terms(np.array(rows), np.array(matrices), F,
                 np.array([parameters[f'gravity{i + 1}'] for i in range(d)]))
