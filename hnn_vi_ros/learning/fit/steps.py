# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of implicit methods that gradients go through."""

from collections.abc import Callable

from hnn_vi_ros.errors import DataError
import torch

_ITERATIONS = 30
_EPS = torch.finfo(torch.float64).eps

Field = Callable[[torch.Tensor], torch.Tensor]


def step(field: Field, integrator: str, z0: torch.Tensor, h: float) -> torch.Tensor:
    """
    Return the states that a method of SCHEMES makes of others, differentiable by all they need.

    Each implicit equation R(z1, z0, w) = 0 of the parameters w is solved to round-off by Newton's
    method. By the implicit function theorem dz1 = -(R_z1)^-1 (R_z0 dz0 + R_w dw), which is the
    derivative of one more step of Newton's method from the solution, its matrix held fixed.

    Parameters
    ----------
    field : callable
        ``field(z)`` returns (dq/dt, dp/dt), shape (N, 2 d), of states (q, p) of that shape.
    integrator : str
        The method.
    z0 : torch.Tensor, shape (N, 2 d)
        States.
    h : float
        Step size [s].

    Raises
    ------
    DataError
        An equation has no solution that is found: the step is too large for the field.

    """
    for residual, share in SCHEMES[integrator]:
        z0 = _solve(residual, field, z0, share * h)
    return z0


def _solve(residual: Callable, field: Field, z0: torch.Tensor, h: float) -> torch.Tensor:
    start = z0.detach()
    z, before = start + h * field(start).detach(), float('inf')
    for _ in range(_ITERATIONS):
        value, matrix = _linearised(residual, field, start, z, h)
        change = torch.linalg.solve(matrix, value[:, :, None])[:, :, 0]
        size = float((change.abs() / (z.abs().amax(dim=0) + _EPS)).max())
        z = z - change
        if size <= _EPS or (size >= before and size <= 1e3 * _EPS):
            value = residual(field, z0, z, h)
            return z - torch.linalg.solve(matrix, value[:, :, None])[:, :, 0]
        before = size
    raise DataError(f'a step of {h:g} s is too large for the field that is being learned: its '
                    'equation was not solved; take a smaller loss.step_size')


def _linearised(residual: Callable, field: Field, z0: torch.Tensor, z: torch.Tensor, h: float
                ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the residual, shape (N, 2 d), and its derivative by z, shape (N, 2 d, 2 d)."""
    z = z.detach().requires_grad_(True)
    value = residual(field, z0, z, h)
    rows = [torch.autograd.grad(entry.sum(), z, retain_graph=True)[0]
            for entry in value.unbind(dim=1)]
    return value.detach(), torch.stack(rows, dim=1)


def _mixed(q_from: torch.Tensor, p_from: torch.Tensor) -> torch.Tensor:
    return torch.cat([q_from.chunk(2, dim=1)[0], p_from.chunk(2, dim=1)[1]], dim=1)


def _midpoint(field: Field, z0: torch.Tensor, z1: torch.Tensor, h: float) -> torch.Tensor:
    return z1 - z0 - h * field(0.5 * (z0 + z1))


def _variational_euler(field: Field, z0: torch.Tensor, z1: torch.Tensor, h: float
                       ) -> torch.Tensor:
    return z1 - z0 - h * _mixed(field(z0), field(z1))


def _symplectic_euler(field: Field, z0: torch.Tensor, z1: torch.Tensor, h: float
                      ) -> torch.Tensor:
    return z1 - z0 - h * field(_mixed(z0, z1))


def _adjoint(field: Field, z0: torch.Tensor, z1: torch.Tensor, h: float) -> torch.Tensor:
    return z1 - z0 - h * field(_mixed(z1, z0))


# The equations of each method, one after another, and their shares of the step.
SCHEMES = {
    'variational_euler': ((_variational_euler, 1.0),),
    'symplectic_euler': ((_symplectic_euler, 1.0),),
    'symplectic_euler_adjoint': ((_adjoint, 1.0),),
    'generalized_leapfrog': ((_symplectic_euler, 0.5), (_adjoint, 0.5)),
    'implicit_midpoint': ((_midpoint, 1.0),),
}
