# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A smooth repulsive wall."""

from collections.abc import Sequence
import math
from typing import Literal, NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Potential
from hnn_vi_ros.hamiltonians import check_finite, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class SoftWallParameters(NamedTuple):
    """Column of the coordinate; a, the sign of the depth, k and w of the wall."""

    column: int
    position: float
    sign: float
    stiffness: float
    width: float


class SoftWall(Potential):
    """
    A one-sided smooth spring, V = k w^2 s(x / w)^2 / 2 with s(y) = log(1 + e^y).

    x is the depth behind the wall. Far behind it, V approaches k x^2 / 2; far in front of it, V
    vanishes like exp(2 x / w). V is smooth, so that methods keep their order; a spring that starts
    at x = 0 has a jump in V''. For a rigid wall use `impact`. Energy account: V is part of H.

    Parameters
    ----------
    coordinate : str
        The coordinate that the wall bounds.
    position : float
        Position of the wall, in the coordinate's unit.
    side : str
        Side of free motion, ``'above'`` or ``'below'``.
    stiffness : float
        k > 0 [N/m], [N m/rad].
    width : float
        w > 0, the width of the transition, in the coordinate's unit.

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    C. Dugas et al., Incorporating second-order functional knowledge for better option pricing,
    NIPS 2000 (the function s, there called softplus).

    """

    drawn = True

    def __init__(self, coordinate: str, position: float = 0.0,
                 side: Literal['above', 'below'] = 'above', stiffness: float = 100.0,
                 width: float = 0.01):
        check_positive(stiffness=stiffness, width=width)
        check_finite(position=position)
        self.coordinate, self.position = coordinate, float(position)
        self.sign = {'above': -1.0, 'below': 1.0}[side]
        self.stiffness, self.width = float(stiffness), float(width)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> SoftWallParameters:
        """Return the coordinate's column, the position, the sign, the stiffness and the width."""
        return SoftWallParameters(coordinate_index(coordinates, self.coordinate), self.position,
                                  self.sign, self.stiffness, self.width)

    @staticmethod
    @inlined
    def energy(own: SoftWallParameters, q: np.ndarray) -> float:
        """Return V [J]."""
        s = own.width * _depth(own, q)[0]
        return 0.5 * own.stiffness * s * s

    @staticmethod
    @inlined
    def add_gradient(own: SoftWallParameters, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add V' = k w s s'."""
        s, slope = _depth(own, q)
        dH_dq[own.column] += own.sign * own.stiffness * own.width * s * slope

    @staticmethod
    @inlined
    def add_hessian_vector(own: SoftWallParameters, q: np.ndarray, v: np.ndarray,
                           product: np.ndarray) -> None:
        """Add V'' v, with V'' = k (s'^2 + s s' (1 - s'))."""
        (s, slope), c = _depth(own, q), own.column
        product[c] += own.stiffness * (slope * slope + s * slope * (1.0 - slope)) * v[c]


@inlined
def _depth(own: SoftWallParameters, q: np.ndarray) -> tuple[float, float]:
    """Return s = log(1 + e^y) and s' for the depth y of q in units of w, without overflow."""
    y = own.sign * (q[own.column] - own.position) / own.width
    e = math.exp(-abs(y))
    return max(y, 0.0) + math.log1p(e), (1.0 if y >= 0.0 else e) / (1.0 + e)
