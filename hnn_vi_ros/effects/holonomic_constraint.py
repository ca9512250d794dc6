# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rod: two points, or a point and a fixed place, that keep their distance."""

from collections.abc import Callable, Sequence
from functools import cache

from hnn_vi_ros.effects.base import Live, StepEffect
from hnn_vi_ros.effects.points import distance, resolve_pair, separation
from hnn_vi_ros.effects.rattle import rattle
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Relative error of an initial state; a step takes away what it leaves.
_TOLERANCE = 1e-9


class HolonomicConstraint(StepEffect):
    """
    A massless rod, g(q) = r - l = 0, with r the distance of its ends, by RATTLE.

    Rods that a scene lists are solved together. H(q, p) is that without rods; q and p must keep
    to them. Energy account: the rods' forces do no work.

    Parameters
    ----------
    point : list of str
        Names of the coordinates of one end [m].
    other : list of str, optional
        Names of the coordinates of the other end (a distance kept), or
    anchor : list of float, optional
        the fixed place of the other end [m] (a rod from a pivot).
    length : float
        l > 0 [m].

    Raises
    ------
    ValueError
        The length is not positive.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """

    conservative = True

    def __init__(self, point: list[str], other: list[str] | None = None,
                 anchor: list[float] | None = None, length: float = 1.0):
        check_positive(length=length)
        self.ends, self.length = (point, other, anchor), float(length)

    def accepts(self, integrator: Integrator) -> bool:
        """Tell whether the method is symmetric and of order 2, which RATTLE keeps."""
        return integrator.symmetric and integrator.symplectic and integrator.order == 2 and \
            integrator.uses_hamiltonian

    def resolve(self, coordinates: Sequence[Coordinate], live: Live) -> tuple:
        """Return the two ends, the anchor and the length [m]."""
        return (*resolve_pair(coordinates, *self.ends), self.length)

    def check_state(self, parameters: tuple, q: np.ndarray, velocity: np.ndarray) -> None:
        """Raise ValueError if q is not as long as the rod, or its velocity is along it."""
        *ends, length = parameters
        r = float(distance(*ends, q))
        if abs(r - length) > _TOLERANCE * length:
            raise ValueError(f'a holonomic_constraint asks for a distance of {length!r} m, but '
                             f'the initial q has {r!r} m, {abs(r - length):.3g} m off')
        # The anchor, in place of a second point, does not move.
        still = (*ends[:2], np.zeros_like(ends[2]))
        along = sum(separation(*ends, q, k) * separation(*still, velocity, k)
                    for k in range(ends[0].size)) / r
        if abs(along) > _TOLERANCE * np.abs(velocity).max():
            raise ValueError(f'a holonomic_constraint keeps a distance, but the initial p changes '
                             f'it by {float(along):.3g} m/s; choose p across the rod')

    @staticmethod
    @cache
    def wrap(step: Callable, keeps_gradient: bool) -> Callable:
        """Return the step between two impulses of the rods; see StepEffect."""
        return rattle(step)
