# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The momentum that belongs to a velocity."""

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np

# Newton's steps for the momentum of a velocity; H is quadratic in p as a rule, where one is all.
_ITERATIONS = 20


def momentum(hamiltonian: Hamiltonian, q: np.ndarray, v: np.ndarray, start: np.ndarray
             ) -> np.ndarray:
    """
    Return p with H_p(q, p) = v, by Newton's method.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.
    q, v, start : np.ndarray, shape (..., d)
        Coordinates, velocities, and momenta to begin from.

    Raises
    ------
    ModelError
        A velocity has no momentum.

    """
    p, zero = start.copy(), np.zeros_like(q)
    least = 1e-12 * np.maximum(1.0, np.abs(v).max(axis=-1, keepdims=True))
    for _ in range(_ITERATIONS):
        missing = v - hamiltonian.gradient(q, p)[1]
        wrong = ~(np.abs(missing) <= least).all(axis=-1)
        if not wrong.any():
            return p
        inverse = np.stack([
            hamiltonian.hessian_vector(q, p, zero, np.broadcast_to(unit, q.shape))[1]
            for unit in np.eye(q.shape[-1])], axis=-1)
        try:
            p = p + np.linalg.solve(inverse, missing[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
    raise ModelError(f'no momentum belongs to the velocity {v[wrong][0].tolist()} at q = '
                     f'{q[wrong][0].tolist()}: H_p(q, p) = v has no solution; the state is '
                     'outside what the model learned')
