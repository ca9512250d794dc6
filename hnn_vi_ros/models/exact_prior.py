# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
An exact system as a prior, whose M and V are added to learned ones; computed from its kernel.

H = p . M^-1 p / 2 + V gives M as the inverse of H_pp, and with the momentum pi = M v

    V_q - (v . M v)_q / 2 = H_q(q, pi),    M' v = -M H_pq(q, pi) q'

for the change M' of M along q', since H_p(q, M v) = v does not change with q.
"""

from functools import cache
import inspect
from typing import Any, NamedTuple

from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.kernels import Functions
import numpy as np

# Number of random states of the test of p . M^-1 p, and its tolerance.
_TESTED_STATES, _TOLERANCE = 5, 1e-9


class ExactSystem(NamedTuple):
    """
    A system by name, and its fit parameters.

    Parameters
    ----------
    kind : str
        Its name.
    defaults : dict of str to float
        Its parameters, all positive.
    dimension : int
        Number of coordinates.
    places : list of int
        Places of the parameters in the first argument of its kernel's functions.
    others : tuple
        First argument of the functions.

    """

    kind: str
    defaults: dict[str, float]
    dimension: int
    places: list[int]
    others: tuple[Any, ...]


def create(kind: str, parameters: dict[str, float]) -> Hamiltonian:
    """Return a system with these parameters; ValueError if they are not the expected ones."""
    names = [*parameters_of(kind)]
    if sorted(parameters) != sorted(names):
        raise ValueError(f'prior: parameters {listed(parameters) or "none"}, expected '
                         f'{", ".join(names) or "none"}')
    return HAMILTONIANS[kind](**parameters)


def parameters_of(kind: str) -> dict[str, float]:
    """Return the float parameters of a system and their defaults; others are not fitted."""
    signature = inspect.signature(HAMILTONIANS[kind])
    return {name: parameter.default for name, parameter in signature.parameters.items()
            if isinstance(parameter.default, float)}


def functions_of(kernel: Any) -> Functions:
    """Return energy, gradient and Hessian-vector product of a kernel in plain Python."""
    return kernel.energy.py_func, kernel.gradient.py_func, kernel.hessian_vector.py_func


@cache
def exact_system(kind: str) -> ExactSystem:
    """
    Return the fit parameters of a system.

    Raises
    ------
    ValueError
        H is not p . M(q)^-1 p / 2 + V(q), or the parameters are not arguments of its functions.

    """
    defaults = parameters_of(kind)
    # Distinct numbers that no other parameter has by chance.
    probes = {name: value * (1.0 + 0.1 * k) for k, (name, value) in enumerate(defaults.items(), 1)}
    hamiltonian: Hamiltonian = HAMILTONIANS[kind](**probes)
    kernel = hamiltonian.kernel
    if not all(value in kernel.parameters for value in probes.values()):
        raise ValueError(f'prior: {kind}: its functions do not take {", ".join(defaults)}')
    if not _is_mechanical(hamiltonian):
        raise ValueError(f'prior: {kind} does not have the form p . M(q)^-1 p / 2 + V(q)')
    return ExactSystem(kind, defaults, hamiltonian.dimension,
                       [kernel.parameters.index(value) for value in probes.values()],
                       kernel.parameters)


def exact_systems() -> list[str]:
    """Return the names of all systems that can be fitted."""
    found = []
    for kind in HAMILTONIANS:
        try:
            exact_system(kind)
        except ValueError:
            continue
        found.append(kind)
    return found


def _is_mechanical(hamiltonian: Hamiltonian) -> bool:
    """Return True if H_p is linear in p at random states."""
    if hamiltonian.gauge is not None or not hamiltonian.canonical or hamiltonian.rotations:
        return False
    _, gradient, _ = functions_of(hamiltonian.kernel)
    rng, d = np.random.default_rng(0), hamiltonian.dimension

    def rate(q: np.ndarray, p: np.ndarray) -> np.ndarray:
        slopes = np.empty((2, d))
        gradient(hamiltonian.kernel.parameters, q, p, *slopes)
        return slopes[1]
    for q, p, other in rng.uniform(0.5, 1.5, (_TESTED_STATES, 3, d)):
        both = rate(q, p + 2.0 * other)
        error = both - rate(q, p) - 2.0 * rate(q, other)
        if not np.abs(error).max() <= _TOLERANCE * np.abs(both).max():
            return False
    return True
