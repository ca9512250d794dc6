# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of implicit methods that gradients go through."""

from collections.abc import Callable

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.partitioned import Node
from hnn_vi_ros.learning.families.newton import newton
import torch

# Share of the states to which equations are solved before a last step of Newton's method. Losses
# fall to 1e-10 of the squared rates, where an error of 1e-6 in their gradients would show.
_ENOUGH = 1e-9
_EPS = torch.finfo(torch.float64).eps

Field = Callable[[torch.Tensor], torch.Tensor]


def nodes(integrator: str) -> list[Node]:
    """Return the stages of a method that can be solved one after another, from its tableau."""
    tableau = INTEGRATORS[integrator]().partitioned
    assert tableau is not None, 'the methods of training have one'
    return tableau.nodes()


def step(field: Field, integrator: str, z0: torch.Tensor, h: float) -> torch.Tensor:
    """
    Return the states after a step, differentiable by all that they depend on.

    Each implicit equation R(Z, z, theta) = 0 of a node is solved by Newton's method. By the
    implicit function theorem dZ = -(R_Z)^-1 (R_z dz + R_theta dtheta), which is the derivative of
    one more step of Newton's method from the solution, its matrix held fixed.

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
    z, d = z0, z0.shape[1] // 2
    for node in nodes(integrator):
        own, onward = (h * z0.new_tensor(pair).repeat_interleave(d) for pair in (
            (node.a, node.b), (node.u, node.w)))
        at = _solve(field, z, own) if own.any() else z
        z = z + onward * field(at)
    if not z.isfinite().all():
        raise DataError(f'a step of {h:g} s is too large for the field that is being learned: its '
                        'equation was not solved; take a smaller loss.step_size')
    return z


def _solve(field: Field, z: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
    """Return Z of Z = z + own field(Z), each of shape (N, 2 d)."""
    start = z.detach()
    unit = start.abs().amax(dim=0) + _EPS
    found, matrix = newton(lambda at: at - start - own * field(at),
                           start + own * field(start).detach(), None, unit, unit, _ENOUGH)
    missing = found - z - own * field(found)
    return found - torch.linalg.solve_ex(matrix, missing[:, :, None])[0][:, :, 0]
