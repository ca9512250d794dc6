# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid body that flies."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_not_negative, check_positive
from hnn_vi_ros.hamiltonians.turning_body import check_inertia, spatial_momentum
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Mass [kg], weight [N], moments of inertia I1, I2, I3 [kg m^2].
_Parameters = tuple[float, float, float, float, float]
# Columns of a pose, in q and in p.
_COLUMNS = 7


class Quadrotor(Hamiltonian):
    """
    A rigid body under its weight, H = |p|^2 / (2 m) + sum of L_i^2 / (2 I_i) + m g z.

    q is the place of its centre of mass, z upwards, then its attitude; the momenta are p in space,
    then the angular momentum L in the frame of the body. Its rotors are no part of H: the effect
    ``external_force`` takes their thrust and torques as commands.

    Parameters
    ----------
    mass : float
        m > 0 [kg].
    inertia : list of float
        Moments of inertia I_1, I_2, I_3 about the axes of the body [kg m^2].
    gravity : float
        g >= 0 [m/s^2]; 0 for a body in free space.

    Raises
    ------
    ValueError
        A constant out of its range, or moments that no body has.

    References
    ----------
    T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE
    CDC 2010.

    """

    separable = True
    coordinates = (Coordinate('body', 'm', 'kg m/s', 'pose'),)

    def __init__(self, mass: float = 0.8, inertia: Sequence[float] = (0.006, 0.006, 0.011),
                 gravity: float = 9.81):
        check_inertia(inertia)
        check_positive(mass=mass)
        check_not_negative(gravity=gravity)
        self.inertia = tuple(float(value) for value in inertia)
        self.mass, self.weight = float(mass), float(mass) * float(gravity)

    @property
    def known_invariants(self) -> dict[str, Callable[[np.ndarray, np.ndarray], float]]:
        """Return the horizontal momentum [kg m/s], and that of turning, in space [kg m^2/s]."""
        known: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
            f'momentum_{axis}': partial(_momentum, i) for i, axis in enumerate('xy')}
        return known | {f'spin_{axis}': partial(_spin, i) for i, axis in enumerate('xyz')}

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return compiled_kernel((_energy, _gradient, _hessian_vector),
                               (self.mass, self.weight, *self.inertia), _COLUMNS, rotations=(3,))


def _momentum(i: int, q: np.ndarray, p: np.ndarray) -> float:
    return float(p[i])


def _spin(i: int, q: np.ndarray, p: np.ndarray) -> float:
    return float(spatial_momentum(q[3:], p[3:])[i])


def _energy(parameters: _Parameters, q: np.ndarray, p: np.ndarray) -> float:
    mass, weight, I1, I2, I3 = parameters
    return (0.5 * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) / mass
            + 0.5 * (p[3] * p[3] / I1 + p[4] * p[4] / I2 + p[5] * p[5] / I3) + weight * q[2])


def _gradient(parameters: _Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    _apply(parameters, p, dH_dq, dH_dp)
    for i in range(0, q.size, _COLUMNS):
        dH_dq[i + 2] = parameters[1]


def _hessian_vector(parameters: _Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    _apply(parameters, v_p, product_q, product_p)


@inlined
def _apply(parameters: _Parameters, p: np.ndarray, at_q: np.ndarray, at_p: np.ndarray) -> None:
    """Apply H'', which is constant and zero but for the momenta."""
    mass, _, I1, I2, I3 = parameters
    for i in range(0, p.size, _COLUMNS):
        for j in range(i, i + _COLUMNS):
            at_q[j] = 0.0
        for j in range(i, i + 3):
            at_p[j] = p[j] / mass
        at_p[i + 3], at_p[i + 4], at_p[i + 5] = p[i + 3] / I1, p[i + 4] / I2, p[i + 5] / I3
        at_p[i + 6] = 0.0
