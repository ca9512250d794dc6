# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A uniform magnetic field across the plane of two coordinates."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Joined
from hnn_vi_ros.hamiltonians.parameters import check_finite
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FieldParameters(NamedTuple):
    """Places of the two coordinates of the plane, and c B / 2 [N s/m]."""

    x: int
    y: int
    half_strength: float


class MagneticField(Joined):
    """
    Minimal coupling, H(q, p - c A(q)), to the field B of A = B (-y, x) / 2 in the plane (x, y).

    A free particle of mass m circles with the angular frequency c B / m [rad/s]. p is the
    canonical momentum; the velocity is H_p. Energy account: the field joins H and does no work.

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
        Not two coordinates, or a number that is not finite.

    References
    ----------
    L. Landau, E. Lifshitz, The Classical Theory of Fields, 1975, sections 16 and 21.

    """

    def __init__(self, plane: list[str], charge: float = 1.0, field: float = 1.0):
        if len(plane) != 2 or plane[0] == plane[1]:
            raise ValueError(f'plane = {plane} must name two different coordinates')
        check_finite(charge=charge, field=field)
        self.plane, self.strength = plane, charge * field

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method takes an H that does not separate."""
        needs = integrator.requirements
        return needs.hamiltonian and not needs.separable

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> FieldParameters:
        """Return the places of x and y, and c B / 2 [kg/s]."""
        x, y = (coordinate_index(coordinates, name) for name in self.plane)
        parameters = FieldParameters(x, y, 0.5 * self.strength)
        self.add_gauge(parameters, state.gauge)
        return parameters

    def add_gauge(self, parameters: FieldParameters, gauge: np.ndarray) -> None:
        """Add c A(q), which is linear in q."""
        x, y, b = parameters.x, parameters.y, parameters.half_strength
        gauge[x, y] -= b
        gauge[y, x] += b

    def join(self, kernel: Kernel, parameters: FieldParameters) -> Kernel:
        """Return the kernel of H(q, p - c A(q))."""
        from hnn_vi_ros.effects.kernels import join_magnetic_field
        return join_magnetic_field(kernel, type(self), parameters)
