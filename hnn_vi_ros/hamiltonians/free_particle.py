# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The free particle; effects of a scene add all forces."""

from collections.abc import Sequence
from functools import cached_property
import re

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_names_once, check_positive
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FreeParticle(Hamiltonian):
    """
    A mass without forces, H(q, p) = |p|^2 / (2 m).

    It moves straight at the velocity p / m. Several particles of the same mass are one particle
    with the coordinates of all.

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    names : sequence of str
        Distinct names of its Cartesian coordinates [m]: a letter or underscore, then letters,
        digits, underscores.

    Raises
    ------
    ValueError
        The mass is not positive and finite, or a name is invalid.

    """

    separable = True

    def __init__(self, mass: float = 1.0, names: Sequence[str] = ('x',)):
        check_positive(mass=mass)
        check_names_once(names=names)
        for name in names:
            if not re.fullmatch(r'[^\W\d]\w*', name):
                raise ValueError(f'names: {name!r} must be a letter or underscore, then letters, '
                                 'digits, underscores')
        self.mass = float(mass)
        self.coordinates = tuple(Coordinate(name, 'm', 'kg m/s') for name in names)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        return compiled_kernel((_energy, _gradient, _hessian_vector), (self.mass,), self.dimension)


def _energy(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray) -> float:
    (mass,) = parameters
    energy = 0.5 * p[0] * p[0] / mass
    for i in range(1, p.size):
        energy += 0.5 * p[i] * p[i] / mass
    return energy


@inlined
def _gradient(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    (mass,) = parameters
    for i in range(q.size):
        dH_dq[i] = 0.0
        dH_dp[i] = p[i] / mass


def _hessian_vector(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    # The gradient is linear.
    _gradient(parameters, v_q, v_p, product_q, product_p)
