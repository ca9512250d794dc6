# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid body on which nothing acts."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.turning_body import (
    check_inertia, spatial_momentum, turning_body_kernel)
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class FreeRigidBody(Hamiltonian):
    """
    A rigid body that turns freely about its centre of mass, H = sum of p_i^2 / (2 I_i).

    p is the angular momentum in the frame of the body; Euler's equations p' = p x omega make it
    Jacobi elliptic functions of time. It conserves the angular momentum in space. Turns about
    the axis of the middle moment of inertia are unstable: the body tumbles.

    Parameters
    ----------
    inertia : list of float
        Moments of inertia I_1, I_2, I_3 about the axes of the body [kg m^2].

    Raises
    ------
    ValueError
        A moment that is not a positive number, or moments that no body has.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, section 37.

    """

    separable = True
    coordinates = (Coordinate('attitude', '1', 'kg m2/s', 'rotation'),)

    def __init__(self, inertia: Sequence[float] = (1.0, 2.0, 2.5)):
        check_inertia(inertia)
        self.inertia = tuple(float(value) for value in inertia)

    @property
    def known_invariants(self) -> dict[str, Callable[[np.ndarray, np.ndarray], float]]:
        """Return the angular momentum in space [kg m^2/s], component by component."""
        return {f'momentum_{axis}': partial(_component, i) for i, axis in enumerate('xyz')}

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return turning_body_kernel(self.inertia, 0.0)


def _component(i: int, q: np.ndarray, p: np.ndarray) -> float:
    return float(spatial_momentum(q, p)[i])
