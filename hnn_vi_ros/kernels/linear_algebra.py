# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small linear systems, solved in compiled code."""

from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Fraction of the diagonal below which a pivot is rounding.
DEPENDENT = 1e-12


@inlined
def solve_linear(matrix: np.ndarray, right: np.ndarray) -> int:
    """Solve in place by elimination with row pivoting; return the sign of the determinant."""
    n, sign = right.size, 1
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 0.0:
            return 0
        if (matrix[pivot, k] < 0.0) != (pivot != k):
            sign = -sign
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        _clear_column(matrix, right, k)
    _substitute_back(matrix, right)
    return sign


@inlined
def factorise_rows(matrix: np.ndarray, pivots: np.ndarray) -> bool:
    """
    Factorise a matrix with row exchanges in place into L and U.

    Parameters
    ----------
    matrix : np.ndarray, shape (n, n)
        Matrix; on return U on and above its diagonal, and L, with a unit diagonal, below.
    pivots : np.ndarray, shape (n,)
        Receives the row with which each row was exchanged, in order.

    Returns
    -------
    bool
        False if the matrix is singular.

    """
    n = pivots.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        pivots[k] = pivot
        if not abs(matrix[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            matrix[i, k] = factor
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
    return True


@inlined
def solve_factorised(matrix: np.ndarray, pivots: np.ndarray, right: np.ndarray) -> None:
    """Solve in place with the result of ``factorise_rows``."""
    n = right.size
    for k in range(n):
        pivot = pivots[k]
        right[k], right[pivot] = right[pivot], right[k]
    for i in range(n):
        for j in range(i):
            right[i] -= matrix[i, j] * right[j]
    _substitute_back(matrix, right)


@inlined
def invert(matrix: np.ndarray, first: int, n: int) -> bool:
    """
    Invert a complex matrix in place, by Gauss-Jordan elimination without pivoting.

    For matrices near the identity, if a few digits of the inverse suffice.

    Parameters
    ----------
    matrix : np.ndarray of complex, shape (N,)
        The n x n entries, row by row.
    first : int
        Index of the first entry.
    n : int
        Number of rows.

    Returns
    -------
    bool
        False if a pivot vanishes.

    """
    for k in range(n):
        own = first + k * n
        pivot = matrix[own + k]
        size = pivot.real * pivot.real + pivot.imag * pivot.imag
        if not size > 0.0:
            return False
        inverse = 1.0 / size
        share = complex(pivot.real * inverse, -pivot.imag * inverse)
        matrix[own + k] = share
        # Zeros are skipped: of a separable H half of the entries are zero.
        for j in range(n):
            if j != k and matrix[own + j] != 0.0:
                entry = matrix[own + j] * share
                matrix[own + j] = entry
                for i in range(n):
                    if i != k:
                        matrix[first + i * n + j] -= matrix[first + i * n + k] * entry
        for i in range(n):
            if i != k:
                matrix[first + i * n + k] *= -share
    return True


@inlined
def solve_in_order(matrix: np.ndarray, right: np.ndarray, diagonal: np.ndarray) -> int:
    """
    Solve in place by elimination without pivoting, for a matrix close to a positive definite one.

    Parameters
    ----------
    matrix : np.ndarray, shape (n, n)
        Matrix; on return with pivots on its diagonal.
    right, diagonal : np.ndarray, shape (n,)
        The right-hand side, and workspace for the diagonal of the matrix.

    Returns
    -------
    int
        -1, or the first row whose pivot is negative or vanishes relative to its diagonal.

    """
    for k in range(right.size):
        diagonal[k] = matrix[k, k]
    for k in range(right.size):
        if not matrix[k, k] > DEPENDENT * abs(diagonal[k]):
            return k
        _clear_column(matrix, right, k)
    _substitute_back(matrix, right)
    return -1


@inlined
def _clear_column(matrix: np.ndarray, right: np.ndarray, k: int) -> None:
    """Subtract row k from the rows below it so that their column k vanishes."""
    for i in range(k + 1, right.size):
        factor = matrix[i, k] / matrix[k, k]
        right[i] -= factor * right[k]
        for j in range(k, right.size):
            matrix[i, j] -= factor * matrix[k, j]


@inlined
def _substitute_back(matrix: np.ndarray, right: np.ndarray) -> None:
    """Solve with the upper triangle."""
    for k in range(right.size - 1, -1, -1):
        for j in range(k + 1, right.size):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]


@inlined
def factorise(matrix: np.ndarray) -> bool:
    """
    Replace the lower triangle of a symmetric matrix C C^T by its Cholesky factor C.

    The upper triangle is unchanged. Returns False if the matrix is not positive definite.
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
def solve_cholesky(factor: np.ndarray, right: np.ndarray) -> None:
    """Solve C C^T x = right in place, with C in the lower triangle of ``factor``."""
    solve_lower(factor, right)
    solve_upper(factor, right)


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
