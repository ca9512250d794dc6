# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear systems, solved in compiled code."""

from hnn_vi_ros.compilation import inlined
import numpy as np


@inlined
def solve_linear(matrix: np.ndarray, right: np.ndarray) -> bool:
    """Solve in place by elimination with row pivots; False if the matrix is singular."""
    n = right.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 0.0:
            return False
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            right[i] -= factor * right[k]
            for j in range(k, n):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]
    return True


@inlined
def factorise(matrix: np.ndarray) -> bool:
    """
    Put the Cholesky factor C of a symmetric matrix C C^T into its lower triangle.

    The upper triangle is left as it is. False if the matrix is not positive definite.
    """
    for j in range(matrix.shape[0]):
        for i in range(j, matrix.shape[0]):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not matrix[j, j] > 0.0:
                    return False
                matrix[j, j] = np.sqrt(matrix[j, j])
            else:
                matrix[i, j] /= matrix[j, j]
    return True


@inlined
def solve_lower(factor: np.ndarray, right: np.ndarray) -> None:
    """Solve C x = right in place, with C in the lower triangle of ``factor``."""
    for i in range(right.size):
        for j in range(i):
            right[i] -= factor[i, j] * right[j]
        right[i] /= factor[i, i]


@inlined
def solve_upper(factor: np.ndarray, right: np.ndarray) -> None:
    """Solve C^T x = right in place, with C in the lower triangle of ``factor``."""
    for i in range(right.size - 1, -1, -1):
        for j in range(i + 1, right.size):
            right[i] -= factor[j, i] * right[j]
        right[i] /= factor[i, i]
