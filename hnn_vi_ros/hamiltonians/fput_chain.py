# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Fermi-Pasta-Ulam-Tsingou chain with stiff springs: slow and fast motions in one system."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FputChain(Hamiltonian):
    """
    Unit masses between fixed walls, connected by alternating soft and stiff springs.

    There are m pairs of masses. A stiff linear spring connects the two masses of a pair; soft
    quartic springs connect the pairs with one another and with the walls. The coordinates for pair
    i, whose masses are displaced by u_(2 i - 1) and u_(2 i), are

        c_i = (u_(2 i) + u_(2 i - 1)) / sqrt(2)    centre, slow
        s_i = (u_(2 i) - u_(2 i - 1)) / sqrt(2)    stretch of the stiff spring, fast

    in the order q = (c_1, ..., c_m, s_1, ..., s_m), a canonical change of variables. With
    c_0 = s_0 = c_(m + 1) = s_(m + 1) = 0,

        H = |p|^2 / 2 + (omega^2 / 2) sum_(i = 1..m) s_i^2
            + (1/4) sum_(i = 0..m) (c_(i + 1) - s_(i + 1) - c_i - s_i)^4

    All quantities are dimensionless. The energies I_i = (p_(s_i)^2 + omega^2 s_i^2) / 2 of the
    stiff springs are exchanged slowly; their sum is an adiabatic invariant, conserved to
    O(1 / omega) over times that grow exponentially with omega.

    Parameters
    ----------
    pairs : int
        m, from 1 to 1000.
    omega : float
        Angular frequency of the stiff springs, omega > 0 [1].

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    L. Galgani, A. Giorgilli, A. Martinoli, S. Vanzini, On the problem of energy equipartition
    for large systems of the Fermi-Pasta-Ulam type, Physica D 59, 334 (1992).
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section I.5.1.

    """

    separable = True

    def __init__(self, pairs: int = 3, omega: float = 50.0):
        if not (1 <= pairs <= 1000 and pairs == int(pairs)):
            raise ValueError(f'pairs = {pairs} must be a whole number from 1 to 1000')
        check_positive(omega=omega)
        self.pairs, self.omega = int(pairs), float(omega)
        self.coordinates = tuple(
            Coordinate(f'{kind}{i}') for kind in ('centre', 'stretch')
            for i in range(1, self.pairs + 1))

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        # Scale for stretches of 1 / omega, at which a spring has an energy of order one.
        return compiled_kernel((_energy, _gradient, _hessian_vector), (self.pairs, self.omega),
                               self.dimension, (self.omega, 0.0))


@inlined
def _extension(m: int, q: np.ndarray, i: int) -> float:
    """Return sqrt(2) times the extension of soft spring i, 0 to m; q has shape (2 m,)."""
    if i == 0:
        return q[0] - q[m]
    if i == m:
        return -q[m - 1] - q[2 * m - 1]
    return q[i] - q[m + i] - q[i - 1] - q[m + i - 1]


def _energy(parameters: tuple[int, float], q: np.ndarray, p: np.ndarray) -> float:
    m, omega = parameters
    energy = 0.5 * p[0] * p[0]
    for i in range(1, 2 * m):
        energy += 0.5 * p[i] * p[i]
    for i in range(m, 2 * m):
        energy += 0.5 * (omega * q[i]) * (omega * q[i])
    for i in range(m + 1):
        squared = _extension(m, q, i) * _extension(m, q, i)
        energy += 0.25 * squared * squared
    return energy


def _gradient(parameters: tuple[int, float], q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    m, omega = parameters
    for start in range(0, q.size, 2 * m):
        one = q[start:start + 2 * m]
        for i in range(m):
            left, right = _extension(m, one, i), _extension(m, one, i + 1)
            left, right = left * left * left, right * right * right
            dH_dq[start + i] = left - right
            dH_dq[start + m + i] = omega * omega * one[m + i] - left - right
    for i in range(q.size):
        dH_dp[i] = p[i]


def _hessian_vector(parameters: tuple[int, float], q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    m, omega = parameters
    for start in range(0, q.size, 2 * m):
        one, v = q[start:start + 2 * m], v_q[start:start + 2 * m]
        for i in range(m):
            left, right = _extension(m, one, i), _extension(m, one, i + 1)
            left = 3.0 * left * left * _extension(m, v, i)
            right = 3.0 * right * right * _extension(m, v, i + 1)
            product_q[start + i] = left - right
            product_q[start + m + i] = omega * omega * v[m + i] - left - right
    for i in range(q.size):
        product_p[i] = v_p[i]
