# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Terms of a parametric system added to a learned M and V: planar_chain.py, compiled."""

from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.planar_chain import Terms
import numpy as np


def prior_gradient(terms: Terms, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M, shape (m, d, d), and V_q - (v . M v)_q / 2 of (m, d), in extended precision."""
    q = q.astype(np.longdouble)
    y, phi = q @ terms.mass_rows.T, q @ terms.rows.T
    squares = np.einsum('mi,kij,mj->mk', v, terms.matrices, v)
    return (np.einsum('mk,kij->mij', np.cos(y), terms.matrices),
            0.5 * (np.sin(y) * squares) @ terms.mass_rows
            + (terms.weights * np.sin(phi)) @ terms.rows + terms.pull)


@part(error_model='numpy')
def angle(row: np.ndarray, q: np.ndarray) -> float:
    """Return a linear combination of coordinates."""
    y = 0.0
    for i in range(q.size):
        y += row[i] * q[i]
    return y


@part(error_model='numpy')
def add_mass(prior: Terms, q: np.ndarray, scale: np.ndarray, gram: np.ndarray) -> None:
    """Add S^-1 M S^-1 on and below the diagonal."""
    rows, matrices = prior.mass_rows, prior.matrices
    for k in range(rows.shape[0]):
        c = np.cos(angle(rows[k], q))
        for i in range(q.size):
            for j in range(i + 1):
                gram[i, j] += c * matrices[k, i, j] / (scale[i] * scale[j])


@part(error_model='numpy')
def prior_potential(prior: Terms, q: np.ndarray) -> float:
    """Return V."""
    rows, weights = prior.rows, prior.weights
    energy = 0.0
    for k in range(rows.shape[0]):
        # 1 - cos y = 2 sin(y / 2)^2 keeps its digits in small swings.
        half = np.sin(0.5 * angle(rows[k], q))
        energy += 2.0 * weights[k] * half * half
    return energy + angle(prior.pull, q)


@part(error_model='numpy')
def product_between(matrix: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Return a . A b."""
    total = 0.0
    for i in range(a.size):
        for j in range(b.size):
            total += a[i] * matrix[i, j] * b[j]
    return total


@part(error_model='numpy')
def add_prior_slope(prior: Terms, q: np.ndarray, v: np.ndarray, covector: np.ndarray) -> None:
    """Add V_q - (v . M v)_q / 2 at held v."""
    mass_rows, matrices = prior.mass_rows, prior.matrices
    rows, weights = prior.rows, prior.weights
    for k in range(mass_rows.shape[0]):
        slope = 0.5 * np.sin(angle(mass_rows[k], q)) * product_between(matrices[k], v, v)
        for i in range(q.size):
            covector[i] += slope * mass_rows[k, i]
    for k in range(rows.shape[0]):
        slope = weights[k] * np.sin(angle(rows[k], q))
        for i in range(q.size):
            covector[i] += slope * rows[k, i]
    for i in range(q.size):
        covector[i] += prior.pull[i]


@part(error_model='numpy')
def subtract_turned_mass(prior: Terms, q: np.ndarray, v_q: np.ndarray, v: np.ndarray,
                         scale: np.ndarray, right: np.ndarray) -> None:
    """Subtract S^-1 M' v, M' being the change of M along v_q."""
    rows, matrices = prior.mass_rows, prior.matrices
    for k in range(rows.shape[0]):
        change = -np.sin(angle(rows[k], q)) * angle(rows[k], v_q)
        for i in range(q.size):
            for j in range(q.size):
                right[i] -= change * matrices[k, i, j] * v[j] / scale[i]


@part(error_model='numpy')
def add_prior_slope_change(prior: Terms, q: np.ndarray, v: np.ndarray, v_q: np.ndarray,
                           v_change: np.ndarray, covector: np.ndarray) -> None:
    """Add the change of V_q - (v . M v)_q / 2 along changes of q and of v."""
    mass_rows, matrices = prior.mass_rows, prior.matrices
    rows, weights = prior.rows, prior.weights
    for k in range(mass_rows.shape[0]):
        y = angle(mass_rows[k], q)
        slope = (0.5 * np.cos(y) * angle(mass_rows[k], v_q) * product_between(matrices[k], v, v)
                 + np.sin(y) * product_between(matrices[k], v_change, v))
        for i in range(q.size):
            covector[i] += slope * mass_rows[k, i]
    for k in range(rows.shape[0]):
        slope = weights[k] * np.cos(angle(rows[k], q)) * angle(rows[k], v_q)
        for i in range(q.size):
            covector[i] += slope * rows[k, i]
