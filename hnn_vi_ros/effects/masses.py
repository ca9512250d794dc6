# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The mass matrix and the vector potential, which relate momenta to velocities."""

from collections.abc import Sequence
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import columns, Coordinate
import numpy as np

# Number of states near the initial one at which different friction rates are tested. A random
# sample is no proof, but the mass matrices of mechanisms vary slowly.
_TESTED_STATES = 64
# Allowed relative coupling: a learned mass matrix couples, by its error, coordinates that the true
# one does not.
_MAX_COUPLING = 1e-3
# Allowed relative difference of a given mass from the mass of H.
_MASS_TOLERANCE = 1e-6


def momentum_index(coordinates: Sequence[Coordinate], name: str) -> int:
    """Return the column of a name in p, or raise ValueError with the valid names."""
    names = columns(coordinates)[1]
    if name not in names:
        raise ValueError(f'no coordinate {name!r}; valid coordinates: {listed(names)}')
    return names.index(name)


def check_rates(hamiltonian: Hamiltonian, q: np.ndarray, rate: np.ndarray) -> None:
    """Raise ValueError if the power -v . (rate M v) could be positive near q, shape (m d,)."""
    d = hamiltonian.dimension
    _warn_of_drift(hamiltonian, q[:d])
    if (rate == rate[0]).all():
        return
    states = q.reshape(-1, d)
    others = np.random.default_rng(0).normal(
        states[0], 1.0 + np.abs(states[0]), (_TESTED_STATES, d))
    for column in hamiltonian.rotations:
        attitudes = others[:, column:column + 4]
        attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    for state in [*states, *others]:
        inverse = hamiltonian.inverse_mass(state, np.zeros(rate.size))
        if np.isfinite(inverse).all() and np.linalg.matrix_rank(inverse) == rate.size:
            product = rate[:, None] * np.linalg.inv(inverse)
            powers = np.linalg.eigvalsh(product + product.T)
            if powers[0] < -_MAX_COUPLING * np.abs(powers).max():
                raise ValueError(
                    f'damping: the rates {rate.tolist()} of coordinates coupled by the mass '
                    f'matrix would add energy to some motions, at q = {state.round(3).tolist()}; '
                    'give one rate, or rates that differ less')


def _warn_of_drift(hamiltonian: Hamiltonian, q: np.ndarray) -> None:
    """Warn if H_p(q, 0) of an exact H is not 0, for q of shape (d,)."""
    base = getattr(hamiltonian, 'base', hamiltonian)
    zero = np.zeros(q.size - len(base.rotations))
    drift = np.abs(base.gradient(q, zero)[1]).max()
    # Learned models, which have a box, are exempt: some drift is part of their error.
    if base.box is None and drift > _MAX_COUPLING * np.abs(base.inverse_mass(q, zero)).max():
        warnings.warn(
            'damping: H_p is not 0 at p = 0, as in a rotating frame: damping reduces p, which is '
            'not proportional to the velocity, so H may grow',
            stacklevel=7)


class Friction(NamedTuple):
    """Friction rates on P = p - c A(q), one for each column [1/s], and EffectState.gauge."""

    rate: np.ndarray
    gauge: np.ndarray


def check_masses(hamiltonian: Hamiltonian, q: np.ndarray, given: np.ndarray | None) -> None:
    """Raise ValueError if H has no masses at q, shape (d,), or they differ from the given ones."""
    inverse = hamiltonian.inverse_mass(q, np.zeros(q.size))
    if not (np.isfinite(inverse).all() and np.linalg.eigvalsh(inverse)[0] > 0.0):
        raise ValueError(
            'thermostat: H_pp is not positive definite at the initial state, so there are no '
            'masses and no temperature; start elsewhere, or use another model')
    if given is not None and np.abs(
            np.diag(given) @ inverse - np.eye(q.size)).max() > _MASS_TOLERANCE:
        raise ValueError(
            f'thermostat: mass = {given.tolist()} does not match H, whose H_pp at the initial '
            f'state is {inverse.round(9).tolist()}; remove mass')


@inlined
def vector_potential(gauge: np.ndarray, q: np.ndarray, i: int) -> float:
    """Return component i of c A(q); see EffectState.gauge."""
    total = 0.0
    for j in range(q.size):
        total += gauge[i, j] * q[j]
    return total
