# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The inverse of the Legendre transform: momenta of given velocities."""

from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np

_ITERATIONS, _HALVINGS = 50, 20
# Rounding of a gradient, with room, relative to the larger of 1 and the size of the velocities.
_TOLERANCE = 1e-10


def momenta(hamiltonian: Hamiltonian, q: np.ndarray, velocity: np.ndarray, p0: np.ndarray
            ) -> np.ndarray:
    """
    Solve H_p(q, p) = velocity for p by Newton's method with halved steps.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H, of d degrees of freedom.
    q, velocity : np.ndarray, shape (d,)
        Coordinates, and the velocities q' that are wanted there.
    p0 : np.ndarray, shape (d,)
        Where to begin; of several solutions one near it is found.

    Returns
    -------
    np.ndarray, shape (d,)
        The momenta, with H_p(q, p) as close to the velocities as rounding allows.

    Raises
    ------
    ValueError
        No such momenta were found.

    """
    p, tolerance = np.array(p0, dtype=np.float64), _TOLERANCE * max(1.0, np.abs(velocity).max())
    residual = hamiltonian.gradient(q, p)[1] - velocity
    for _ in range(_ITERATIONS):
        size = np.abs(residual).max()
        try:
            change = np.linalg.solve(_mass_inverse(hamiltonian, q, p), residual)
        except np.linalg.LinAlgError:
            break
        scale = 1.0
        for _ in range(_HALVINGS):
            trial = p - scale * change
            found = hamiltonian.gradient(q, trial)[1] - velocity
            if np.abs(found).max() < size:
                break
            scale *= 0.5
        else:
            # No better one: as close as rounding allows, or stuck.
            break
        p, residual = trial, found
    # Written so that NaN is no solution.
    if not np.abs(residual).max() <= tolerance:
        raise ValueError(f'no momenta with the velocities {velocity.tolist()} were found at '
                         f'q = {q.tolist()}: H_p misses them by {np.abs(residual).max():.3g}')
    return p


def _mass_inverse(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return H_pp, shape (d, d)."""
    d = q.size
    rows = np.ones((d, 1))
    _, product = hamiltonian.hessian_vector(
        rows * q, rows * p, np.zeros((d, d)), np.eye(d))
    return product.T
