# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The steps of methods written as partitioned Runge-Kutta methods, for their derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Node(NamedTuple):
    """
    A stage that begins where those before it have ended, by shares of the step size.

    From (x, c), which are q and p before the first node, it finds Q and P, and advances:

        Q = x + a h H_p(Q, P),  P = c - b h H_q(Q, P)
        x <- x + u h H_p(Q, P),  c <- c - w h H_q(Q, P)
    """

    a: float
    b: float
    u: float
    w: float


class PartitionedTableau(NamedTuple):
    """
    The coefficients of a step of s stages Z_i = (Q_i, P_i), one set for q and one for p.

        Q_i = q + h sum_j a_ij H_p(Z_j),  P_i = p - h sum_j A_ij H_q(Z_j)
        q_(n+1) = q + h sum_j b_j H_p(Z_j),  p_(n+1) = p - h sum_j B_j H_q(Z_j)

    Parameters
    ----------
    q_matrix, p_matrix : np.ndarray, shape (s, s)
        a_ij and A_ij.
    q_weights, p_weights : np.ndarray, shape (s,)
        b_j and B_j.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section II.2.

    """

    q_matrix: np.ndarray
    p_matrix: np.ndarray
    q_weights: np.ndarray
    p_weights: np.ndarray

    @property
    def stages(self) -> int:
        """Return s."""
        return self.q_weights.size

    def nodes(self) -> list[Node]:
        """
        Return the stages one after another.

        Raises
        ------
        ValueError
            A stage does not begin where those before it have ended, or depends on later ones.

        """
        for matrix, weights in ((self.q_matrix, self.q_weights), (self.p_matrix, self.p_weights)):
            ended = np.tril(np.tile(weights, (self.stages, 1)), -1)
            if (matrix - np.diag(np.diag(matrix)) != ended).any():
                raise ValueError('the stages cannot be solved one after another')
        return [Node(*map(float, numbers)) for numbers in zip(
            np.diag(self.q_matrix), np.diag(self.p_matrix), self.q_weights, self.p_weights,
            strict=True)]


def tableau(q_matrix: ArrayLike, p_matrix: ArrayLike, q_weights: ArrayLike,
            p_weights: ArrayLike) -> PartitionedTableau:
    """Return a tableau of numbers in lists; see PartitionedTableau."""
    return PartitionedTableau(*(np.array(part, dtype=np.float64) for part in (
        q_matrix, p_matrix, q_weights, p_weights)))


def in_sequence(base: PartitionedTableau, fractions: Sequence[float]) -> PartitionedTableau:
    """Return the tableau of one step made of steps of a base, of these fractions of h."""
    s, count = base.stages, len(fractions)
    matrices, weights = np.zeros((2, count * s, count * s)), np.zeros((2, count * s))
    for k, fraction in enumerate(fractions):
        own, later = slice(k * s, (k + 1) * s), slice((k + 1) * s, None)
        for matrix, weight, base_matrix, base_weight in zip(
                matrices, weights, base[:2], base[2:], strict=True):
            matrix[own, own] = fraction * base_matrix
            # Stages of later parts start from where this part has ended.
            matrix[later, own] = fraction * base_weight
            weight[own] = fraction * base_weight
    return PartitionedTableau(*matrices, *weights)
