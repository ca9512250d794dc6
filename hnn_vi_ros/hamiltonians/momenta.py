# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Inverse Legendre transform: momenta of given velocities."""

from hnn_vi_ros.errors import StateError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np

_MAX_ITERATIONS, _MAX_HALVINGS = 50, 20
# Residuals relative to the velocities, to H_pp p and to the rounding of H_p: the iteration stops
# at the first; the result is accepted at the second, which is larger.
_GOAL, _MAX_RESIDUAL = 1e-12, 1e-10


def momentum(hamiltonian: Hamiltonian, q: np.ndarray, v: np.ndarray, start: np.ndarray
             ) -> np.ndarray:
    """
    Return p with H_p(q, p) = v, by Newton's method with halved steps.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of d coordinates.
    q, v : np.ndarray, shape (..., d)
        Coordinates, and the required velocities q'.
    start : np.ndarray, shape (..., d)
        Initial guess; of several solutions one near it is returned.

    Returns
    -------
    np.ndarray, shape (..., d)
        The momenta, with H_p(q, p) as close to the velocities as rounding allows.

    Raises
    ------
    StateError
        A velocity has no momentum.

    """
    p = np.array(start, dtype=np.float64)
    rounding = hamiltonian.kernel.gradient_scale[1]
    missing = v - hamiltonian.gradient(q, p)[1]
    for _ in range(_MAX_ITERATIONS):
        size = np.abs(missing).max(axis=-1, keepdims=True)
        inverse = hamiltonian.inverse_mass(q, p)
        terms = np.maximum(np.abs(v), (np.abs(inverse) * np.abs(p)[..., None, :]).sum(axis=-1))
        scale = np.maximum(rounding, terms.max(axis=-1, keepdims=True))
        if (size <= _GOAL * scale).all():
            return p
        try:
            change = np.linalg.solve(inverse, missing[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
        share = np.ones_like(size)
        for _ in range(_MAX_HALVINGS):
            trial = p + share * change
            found = v - hamiltonian.gradient(q, trial)[1]
            worse = ~(np.abs(found).max(axis=-1, keepdims=True) < size) & ~(size <= _GOAL * scale)
            if not worse.any():
                break
            share[worse] *= 0.5
        p, missing = np.where(worse, p, trial), np.where(worse, missing, found)
        # As close as rounding allows, or no progress.
        if worse.all():
            break
    size = np.abs(missing).max(axis=-1, keepdims=True)
    # The negated form also rejects NaN.
    if not (size <= _MAX_RESIDUAL * scale).all():
        first = np.unravel_index(np.argmax(~(size <= _MAX_RESIDUAL * scale)), size.shape)[:-1]
        raise StateError(
            f'no momentum gives the velocity {v[first].tolist()} at q = {q[first].tolist()}: '
            f'H_p differs by {float(size[first][0]):.3g}; ' + (
                'H has no Legendre transform there' if hamiltonian.box is None else
                'the state is outside the training domain of the model'))
    return p
