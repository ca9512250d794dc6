# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid body without external torques."""

from collections.abc import Sequence
from functools import partial

from hnn_vi_ros.hamiltonians.turning_body import spatial_component, TurningBody


class FreeRigidBody(TurningBody):
    """
    A rigid body that rotates freely about its centre of mass, H = sum of p_i^2 / (2 I_i).

    p is the angular momentum in the frame of the body; by Euler's equations p' = p x omega it is a
    Jacobi elliptic function of time. The spatial angular momentum is conserved. Rotation about the
    axis of the middle moment of inertia is unstable: the body tumbles.

    Parameters
    ----------
    inertia : list of float
        Moments of inertia I_1, I_2, I_3 about the axes of the body [kg m^2].

    Raises
    ------
    ValueError
        A moment is not a positive number, or no body has these moments.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, section 37.

    """

    separable = True
    # The spatial angular momentum [kg m^2/s] by component.
    known_invariants = {f'momentum_{axis}': partial(spatial_component, i)
                        for i, axis in enumerate('xyz')}

    def __init__(self, inertia: Sequence[float] = (1.0, 2.0, 2.5)):
        super().__init__(inertia, 0.0)
