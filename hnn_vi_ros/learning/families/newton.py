# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Newton's method in torch, for many small equations at once."""

from collections.abc import Callable

import torch

# Steps end where they change unknowns by less than this share of their usual sizes: the error
# that is left is the square of it. The first steps take the matrix that the caller has, which
# costs a third of a step with a new one. Where friction jumps there are more steps than
# elsewhere, and some of them are halved.
ENOUGH = 1e-6
_CHEAP, _MOST = 2, 40


def newton(residual: Callable[[torch.Tensor], torch.Tensor], guess: torch.Tensor,
           matrix: torch.Tensor | None, unit: torch.Tensor, residual_unit: torch.Tensor,
           enough: float = ENOUGH) -> tuple[torch.Tensor, torch.Tensor]:
    """
    Return the roots of equations, shape (N, d), and their matrices, by Newton's method.

    Parameters
    ----------
    residual : callable
        Of shape (N, d), at unknowns of that shape, row by row.
    guess : torch.Tensor, shape (N, d)
        Where to begin.
    matrix : torch.Tensor, shape (N, d, d), optional
        About the derivative of the residual, for the first steps.
    unit, residual_unit : torch.Tensor, shape (d,)
        Usual sizes of the unknowns, and of the residual.
    enough : float
        Share of the unknowns' sizes below which a step is the last one. The matrices returned
        are those before that step, so derivatives that they make are off by about this share.

    Returns
    -------
    tuple of torch.Tensor
        Roots, NaN where none was found, and the derivatives of the residual at them.

    """
    best = w = guess
    least = torch.full(guess.shape[:1], torch.inf, dtype=guess.dtype)
    share, step = torch.ones_like(least), torch.zeros_like(guess)
    for k in range(_MOST):
        cheap = matrix is not None and k < _CHEAP
        value, slopes = (_value(residual, w), matrix) if cheap else _with_slopes(residual, w)
        size = (value / residual_unit).square().sum(dim=1)
        # Halve a step that makes the residual worse, or not a number.
        better = size < least
        least, share = torch.where(better, size, least), torch.where(better, 1.0, 0.5 * share)
        best = torch.where(better[:, None], w, best)
        step = torch.where(better[:, None], _solve(slopes, value), step)
        w = best - share[:, None] * step
        # This also ends where only rounding is left, and no step improves the residual.
        done = (step.abs() <= enough * unit).all(dim=1)
        if not cheap and done.all():
            break
    return torch.where(done[:, None], w, torch.nan), slopes


def _value(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return residual(w)


def _with_slopes(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor
                 ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return r, shape (N, d), and r_w, shape (N, d, d), by one backward pass for all rows."""
    with torch.enable_grad():
        w = w.detach().requires_grad_()
        value = residual(w)
        units = torch.eye(w.shape[1], dtype=w.dtype)[:, None, :].expand(-1, len(w), -1)
        (rows,) = torch.autograd.grad(value, w, units, is_grads_batched=True)
    return value.detach(), rows.transpose(0, 1)


def _solve(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    return torch.linalg.solve_ex(matrix, right[:, :, None])[0][:, :, 0]
