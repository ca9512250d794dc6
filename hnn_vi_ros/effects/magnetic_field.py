# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A homogeneous magnetic field normal to a plane."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Joined
from hnn_vi_ros.hamiltonians import check_finite
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.kernels import Energy, Functions, Gradient, HessianVector, inlined, Parameters
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FieldParameters(NamedTuple):
    """Columns of the two coordinates of the plane, and c B / 2 [N s/m]."""

    x: int
    y: int
    half_strength: float


class MagneticField(Joined):
    """
    Minimal coupling, H(q, p - c A(q)), to the field B of A = B (-y, x) / 2 in the plane (x, y).

    A free particle of mass m circles with the angular frequency c B / m [rad/s]. p is the
    canonical momentum; the velocity is H_p. Energy account: part of H, no work.

    Parameters
    ----------
    plane : list of str
        Names of the two coordinates x and y [m].
    charge : float
        c [C].
    field : float
        B [T].

    Raises
    ------
    ValueError
        The plane is not two coordinates, or a number is not finite.

    References
    ----------
    L. Landau, E. Lifshitz, The Classical Theory of Fields, 1975, sections 16 and 21.

    """

    drawn = True

    def __init__(self, plane: list[str], charge: float = 1.0, field: float = 1.0):
        if len(plane) != 2 or plane[0] == plane[1]:
            raise ValueError(f'plane = {plane} must name two different coordinates')
        check_finite(charge=charge, field=field)
        self.plane, self.strength = plane, charge * field

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method supports a nonseparable H."""
        needs = integrator.requirements
        return needs.hamiltonian and not needs.separable

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> FieldParameters:
        """Return the columns of x and y, and c B / 2 [kg/s]."""
        x, y = (coordinate_index(coordinates, name) for name in self.plane)
        parameters = FieldParameters(x, y, 0.5 * self.strength)
        self.add_gauge(parameters, state.gauge)
        return parameters

    def add_gauge(self, parameters: FieldParameters, gauge: np.ndarray) -> None:
        """Add c A(q), which is linear in q."""
        x, y, b = parameters
        gauge[x, y] -= b
        gauge[y, x] += b

    @classmethod
    @cache
    def compose(cls, base_energy: Energy, base_gradient: Gradient,
                base_hessian_vector: HessianVector) -> Functions:
        """Return the functions of H(q, p - c A(q))."""
        def energy(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
            base, own, work = parameters
            _kinetic(own, q, p, work[0])
            return base_energy(base, q, work[0])

        def gradient(parameters: Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                     dH_dp: np.ndarray) -> None:
            base, own, work = parameters
            x, y, b = own
            d = work.shape[1]
            for a in range(0, q.size, d):
                end = a + d
                _kinetic(own, q[a:end], p[a:end], work[0])
                base_gradient(base, q[a:end], work[0], dH_dq[a:end], dH_dp[a:end])
                dH_dq[a + x] -= b * dH_dp[a + y]
                dH_dq[a + y] += b * dH_dp[a + x]

        def hessian_vector(parameters: Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                           v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
            base, own, work = parameters
            x, y, b = own
            d = work.shape[1]
            for a in range(0, q.size, d):
                end = a + d
                _kinetic(own, q[a:end], p[a:end], work[0])
                _kinetic(own, v_q[a:end], v_p[a:end], work[1])
                base_hessian_vector(base, q[a:end], work[0], v_q[a:end], work[1],
                                    product_q[a:end], product_p[a:end])
                product_q[a + x] -= b * product_p[a + y]
                product_q[a + y] += b * product_p[a + x]
        return energy, gradient, hessian_vector


@inlined
def _kinetic(own: FieldParameters, q: np.ndarray, p: np.ndarray, target: np.ndarray) -> None:
    """Fill the target with p - c A(q), which is linear in (q, p)."""
    x, y, b = own
    for i in range(p.size):
        target[i] = p[i]
    target[x] += b * q[y]
    target[y] -= b * q[x]
