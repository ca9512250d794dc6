# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The discrete Euler-Lagrange equations, for any discrete Lagrangian."""

from collections.abc import Callable
from typing import Annotated

from hnn_vi_ros.files import import_named, NAMES_CODE
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators.base import (
    Integrator, NO_CONVERGENCE, NOT_FINITE, OK, PhasePoint, Requirements)
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models import load_checkpoint
import numpy as np

_MAX_ITERATIONS = 30
_EPS = float(np.finfo(np.float64).eps)


class DiscreteEulerLagrange(Integrator):
    """
    Variational integrator of a discrete Lagrangian L_d(q0, q1, h), section 2 of the paper.

    D_1 L_d(q_n, q_(n+1)) + D_2 L_d(q_(n-1), q_n) = 0, stepped in position-momentum form:

        p_n = -D_1 L_d(q_n, q_(n+1), h)     solved for q_(n+1) by Newton's method
        p_(n+1) = D_2 L_d(q_n, q_(n+1), h)

    Derivatives come from torch's automatic differentiation. L_d is the action of one step [J s]:
    the factor h of the paper's sum is inside L_d. Symplectic for every L_d, which determines the
    order and symmetry. Use it for an L_d of your own, otherwise `gauss8`.

    Parameters
    ----------
    discrete_lagrangian : str, optional
        ``package.module:function``; the function takes tensors q0 and q1 of shape (d,) and the
        float h, and returns a scalar tensor. It must be smooth, and D_1 D_2 L_d regular.
    order : int
        Order of L_d, used in reports only.
    model : str, optional
        A learned Lagrangian, instead of a function: the midpoint rule for its action, of order 2,
        L_d = h L((q0 + q1) / 2, (q1 - q0) / h). The Hamiltonian must be that of the same model.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or belongs to another family.
    ValueError
        The function cannot be imported, or not exactly one of function and model is given.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 2001,
    sections 1.3 and 1.5.

    """

    explicit, compiled = False, False
    requirements = Requirements(symmetric=False, symplectic=True, hamiltonian=False, forces=False)

    def __init__(self, discrete_lagrangian: Annotated[str | None, NAMES_CODE] = None,
                 order: int = 1, model: str | None = None):
        if (discrete_lagrangian is None) == (model is None):
            raise ValueError('give either discrete_lagrangian or model')
        self._model = None if model is None else load_checkpoint(model)
        if self._model is not None:
            # Imported lazily: reading a scene needs no compiled networks.
            from hnn_vi_ros.models import midpoint_action
            self.discrete_lagrangian, self.order = midpoint_action(self._model), 2
            return
        try:
            self.discrete_lagrangian = import_named(discrete_lagrangian or '')
        except (Exception, SystemExit) as problem:  # noqa: B902  the user's module may raise any
            raise ValueError(
                f'discrete_lagrangian = {discrete_lagrangian!r}: {type(problem).__name__}: '
                f'{" ".join(str(problem).split())}; expected package.module:function'
            ) from problem
        self.order = order

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Refuse a Hamiltonian other than that of the learned Lagrangian."""
        if self._model and hamiltonian.provenance.get('model_sha256') != self._model.sha256:
            return ('needs the Hamiltonian of its own model, because other momenta differ: '
                    'name the same model in both')
        return super().refusal(hamiltonian)

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return the discrete Lagrangian."""
        return (self.discrete_lagrangian,)

    def start(self, q0: np.ndarray, q1: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the state (q1, p1) that continues two configurations.

        Parameters
        ----------
        q0, q1 : np.ndarray, shape (d,)
            Coordinates at two times h apart.
        h : float
            Step size [s].

        """
        return np.array(q1, dtype=np.float64), _derivatives(
            self.discrete_lagrangian, np.array(q0), np.array(q1), h)[1]

    @staticmethod
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        (discrete_lagrangian,) = options
        q1 = z.q + h * z.dH_dp
        previous = np.inf
        scale = np.maximum(np.abs(z.p), h * np.abs(z.dH_dq))
        for iteration in range(1, _MAX_ITERATIONS + 1):
            d1, d2, mixed = _derivatives(discrete_lagrangian, z.q, q1, h)
            defect = z.p + d1
            if not np.isfinite(defect).all():
                return NOT_FINITE, np.inf, iteration
            # D_1 L_d has the rounding error of terms of size D_2 D_1 L_d times q.
            size = np.maximum(scale, np.abs(mixed) @ np.abs(q1))
            residual = np.abs(np.divide(defect, size, where=size > 0.0,
                                        out=np.zeros_like(defect))).max()
            if residual <= _EPS or (residual >= previous and residual <= max(8, q1.size) * _EPS):
                z1.q[:], z1.p[:] = q1, d2
                return OK, residual, iteration
            previous = residual
            try:
                q1 = q1 - np.linalg.solve(mixed, defect)
            except np.linalg.LinAlgError:
                break
        return NO_CONVERGENCE, previous, _MAX_ITERATIONS


def _derivatives(discrete_lagrangian: Callable, q0: np.ndarray, q1: np.ndarray, h: float
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return D_1 L_d and D_2 L_d, of shape (d,), and D_2 D_1 L_d, of shape (d, d)."""
    import torch
    a, b = (torch.tensor(q, dtype=torch.float64, requires_grad=True) for q in (q0, q1))
    d1, d2 = torch.autograd.grad(discrete_lagrangian(a, b, h), (a, b), create_graph=True)
    rows = [torch.autograd.grad(entry, b, retain_graph=True)[0] for entry in d1]
    return d1.detach().numpy(), d2.detach().numpy(), torch.stack(rows).numpy()
