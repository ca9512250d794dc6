# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A spring between two points, or from a point to a fixed place."""

from collections.abc import Sequence

from hnn_vi_ros.effects.base import EffectState, Potential
from hnn_vi_ros.effects.body_points import BodyElastic, BodySpring
from hnn_vi_ros.effects.points import (
    add_along, add_curvature, distance, Elastic, resolve_pair, separation)
from hnn_vi_ros.hamiltonians.parameters import check_not_negative, check_positive
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Spring(Potential):
    """
    A linear spring, V = k (r - l)^2 / 2, with r the distance of its ends.

    Between points of one coordinate, r is the signed difference. Energy account: V joins H.

    Parameters
    ----------
    point : list of str
        Names of the coordinates of one end [m], or of the body that it is fixed to.
    other : list of str, optional
        Names of the coordinates of the other end, or of its body, or
    anchor : list of float, optional
        the fixed place of the other end [m].
    stiffness : float
        k > 0 [N/m].
    rest_length : float
        l >= 0 [m].
    point_in_body, other_in_body : list of float, optional
        Where on their bodies the ends are, in the frame of each [m]; in its origin if not given.

    Raises
    ------
    ValueError
        A parameter out of its range.

    References
    ----------
    L. Landau, E. Lifshitz, Mechanics, 1976, section 21.

    """

    turns = True

    def __init__(self, point: list[str], other: list[str] | None = None,
                 anchor: list[float] | None = None, stiffness: float = 1.0,
                 rest_length: float = 0.0, point_in_body: list[float] | None = None,
                 other_in_body: list[float] | None = None):
        check_positive(stiffness=stiffness)
        check_not_negative(rest_length=rest_length)
        self.ends, self.elastic = (point, other, anchor), (float(stiffness), float(rest_length))
        self._on_bodies = BodySpring(self.ends, (point_in_body, other_in_body), *self.elastic)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> Elastic | BodyElastic:
        """Return the ends, the stiffness [N/m] and the length at rest [m]."""
        if self._on_bodies.applies(coordinates):
            return self._on_bodies.resolve(coordinates, state)
        return Elastic(*resolve_pair(coordinates, *self.ends), *self.elastic)

    def join(self, kernel: Kernel, parameters: Parameters) -> Kernel:
        """Return the kernel of H + V, by the formulas of its ends."""
        if isinstance(parameters, BodyElastic):
            return self._on_bodies.join(kernel, parameters)
        return super().join(kernel, parameters)

    @staticmethod
    @inlined
    def energy(parameters: Elastic, q: np.ndarray) -> float:
        """Return V [J]."""
        first, second, anchor, stiffness, rest = parameters
        stretch = distance(first, second, anchor, q) - rest
        return 0.5 * stiffness * stretch * stretch

    @staticmethod
    @inlined
    def add_gradient(parameters: Elastic, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V' = k (1 - l / r) times the vector between the ends."""
        first, second, anchor, stiffness, rest = parameters
        r = distance(first, second, anchor, q)
        for k in range(first.size):
            along = separation(first, second, anchor, q, k)
            # At r = 0 the direction of a spring at rest length l > 0 is undefined: no force.
            pull = stiffness * (along - (rest * along / r if r != 0.0 else 0.0))
            add_along(first, second, k, pull, dH_dq)

    @staticmethod
    @inlined
    def add_hessian_vector(parameters: Elastic, q: np.ndarray, v: np.ndarray, product: np.ndarray
                           ) -> None:
        """Add V'' v."""
        add_curvature(parameters, q, v, product)
