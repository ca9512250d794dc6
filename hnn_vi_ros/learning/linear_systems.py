# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Linear systems in traced modules, by operations that stored graphs have.

Elimination without exchanges of rows: stable for positive definite matrices, as the masses of
mechanical systems are; where others lose accuracy, the comparison with the module refuses them.
"""

from collections.abc import Callable
from typing import Any

import torch


def eliminated(a: torch.Tensor, b: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the inverse of a times b, and the pivots, shape (..., n)."""
    n, pivots = a.shape[-1], []
    rows, unit = torch.cat([a, b], -1), torch.eye(n, dtype=a.dtype)
    for k in range(n):
        row = rows[..., k:k + 1, :]
        pivot = row[..., k:k + 1]
        rows = rows - (rows[..., k:k + 1] - unit[:, k:k + 1]) * (row / pivot)
        pivots.append(pivot[..., 0, 0])
    return rows[..., n:], torch.stack(pivots, -1)


def _unknown(like: torch.Tensor) -> torch.Tensor:
    """Return a factor that only derivatives inside the module would read: it makes H nan."""
    return torch.full_like(like, torch.nan)


def _no_error(like: torch.Tensor) -> torch.Tensor:
    return torch.zeros(like.shape[:-2], dtype=torch.int32)


def _solved(a: torch.Tensor, b: torch.Tensor, left: bool) -> torch.Tensor:
    """Return the solution of a x = b, or of x a = b."""
    if not left:
        return eliminated(a.mT, b.mT)[0].mT
    if b.ndim == 1 or b.shape == a.shape[:-1]:
        return eliminated(a, b[..., None])[0][..., 0]
    return eliminated(a, b)[0]


def _inverse(a: torch.Tensor, check_errors: bool = False) -> tuple[torch.Tensor, ...]:
    unit = torch.eye(a.shape[-1], dtype=a.dtype).expand(a.shape)
    return eliminated(a, unit)[0], _no_error(a)


def _solve(a: torch.Tensor, b: torch.Tensor, *, left: bool = True, check_errors: bool = False
           ) -> tuple[torch.Tensor, ...]:
    return _solved(a, b, left), _unknown(a), _no_error(a), _no_error(a)


def _triangular(a: torch.Tensor, b: torch.Tensor, *, upper: bool, left: bool = True,
                unitriangular: bool = False) -> torch.Tensor:
    part, edge = (torch.triu, 1) if upper else (torch.tril, -1)
    return _solved(part(a, edge) + torch.eye(a.shape[-1], dtype=a.dtype) if unitriangular
                   else part(a), b, left)


def _cholesky(a: torch.Tensor, *, upper: bool = False, check_errors: bool = False
              ) -> tuple[torch.Tensor, ...]:
    columns, rest = [], a
    for k in range(a.shape[-1]):
        column = rest[..., k:k + 1] / torch.sqrt(rest[..., k:k + 1, k:k + 1])
        rest = rest - column * column.mT
        columns.append(column)
    # Above the diagonal round-off remains.
    lower = torch.tril(torch.cat(columns, -1))
    return lower.mT if upper else lower, _no_error(a)


def _cholesky_solve(b: torch.Tensor, factor: torch.Tensor, upper: bool = False) -> torch.Tensor:
    return _solved(factor.mT @ factor if upper else factor @ factor.mT, b, True)


def _determinant(a: torch.Tensor) -> tuple[torch.Tensor, ...]:
    return eliminated(a, a[..., :0])[1].prod(-1), _unknown(a), _no_error(a)


def _log_determinant(a: torch.Tensor) -> tuple[torch.Tensor, ...]:
    pivots = eliminated(a, a[..., :0])[1]
    return torch.sign(pivots).prod(-1), torch.log(torch.abs(pivots)).sum(-1), _unknown(a), \
        _no_error(a)


def _trilinear(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor, in_x: list[int],
               in_y: list[int], in_z: list[int], summed: list[int], unroll_dim: int = 1
               ) -> torch.Tensor:
    """Return the sum of products of three tensors, each with new axes in some places."""
    for places, k in ((in_x, 0), (in_y, 1), (in_z, 2)):
        for place in sorted(places):
            x, y, z = (one.unsqueeze(place) if k == i else one for i, one in enumerate((x, y, z)))
    return (x * y * z).sum(summed)


def _unchecked(*arguments: Any, **keywords: Any) -> None:
    """Report no failure of a factorisation: H would not be finite."""


# Keys are names of operations of torch.
LINEAR_SYSTEMS: dict[str, Callable[..., Any]] = {
    'linalg_inv_ex': _inverse, '_linalg_solve_ex': _solve, 'linalg_solve_triangular': _triangular,
    'linalg_cholesky_ex': _cholesky, '_cholesky_solve_helper': _cholesky_solve,
    'cholesky_solve': _cholesky_solve, '_linalg_det': _determinant,
    '_linalg_slogdet': _log_determinant, '_trilinear': _trilinear,
    '_linalg_check_errors': _unchecked}
