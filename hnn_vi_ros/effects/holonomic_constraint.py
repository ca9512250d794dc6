# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A holonomic constraint: rods, planes, circles, spheres, or an equation of the user's."""

from collections.abc import Sequence
from typing import Annotated, Literal

from hnn_vi_ros.effects.base import Constraint, EffectState, ConstraintSet
from hnn_vi_ros.effects.constraints import ConstraintEquation
from hnn_vi_ros.effects.shapes import check_keys, equations_of, function_equation
from hnn_vi_ros.files.named_code import NAMES_CODE
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate


class HolonomicConstraint(Constraint):
    """
    A holonomic constraint g(q) = 0, without friction, by RATTLE: a rod, unless form says else.

    Constraints that a scene lists are solved together. H(q, p) is that without them; the initial
    q and p must keep to them, g(q) = 0 and g' H_p = 0. Energy account: their forces do no work.

    Parameters
    ----------
    form : str
        ``rod``: g = r - l, with r the distance of two points, or of a point and a fixed place;
        ``plane``: g = n . (x - a); ``sphere``: g = abs(x - a) - R; ``circle``: a sphere, cut by
        a plane if there are three coordinates; ``python``: what a factory returns.
    point : list of str, optional
        Names of the coordinates of a point x [m].
    other : list of str, optional
        Names of the coordinates of the other end of a rod.
    anchor : list of float, optional
        The fixed place of the other end of a rod, the centre of a circle or a sphere, or a place
        in a plane [m].
    length : float, optional
        l > 0 of a rod [m]; 1 where it is not given.
    radius : float, optional
        R > 0 of a circle or a sphere [m].
    normal : list of float, optional
        n of a plane or of a circle in space [1], of any length but zero.
    factory : str, optional
        package.module:function; called without arguments, returns a function g(q, gradient) that
        fills the gradient and returns g, arrays of shape (d,); plain Python in numba's subset.

    Raises
    ------
    ValueError
        A value is out of its range, missing, or not one of the form; the factory fails.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """

    def __init__(self, point: list[str] | None = None, other: list[str] | None = None,
                 anchor: list[float] | None = None, length: float | None = None,
                 form: Literal['rod', 'plane', 'circle', 'sphere', 'python'] = 'rod',
                 radius: float | None = None, normal: list[float] | None = None,
                 factory: Annotated[str | None, NAMES_CODE] = None):
        self.form = form
        self._given = check_keys(form, {
            'point': point, 'other': other, 'anchor': anchor, 'length': length, 'radius': radius,
            'normal': normal, 'factory': factory})
        self._function = function_equation(self._given['factory']) if form == 'python' else None

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method is symmetric and of order 2, which RATTLE keeps."""
        keeps = integrator.requirements
        return keeps.symmetric and keeps.symplectic and integrator.order == 2 and keeps.hamiltonian

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> tuple[ConstraintEquation, ...]:
        """Return the equations, of which a circle in space has two."""
        if self._function is not None:
            return (self._function,)
        return equations_of(self.form, self._given, coordinates)

    @staticmethod
    def combine(listed: Sequence[tuple[int, str, tuple[ConstraintEquation, ...]]], kernel: Kernel,
                 effects: int) -> ConstraintSet:
        """Return the manifold that all constraints leave."""
        from hnn_vi_ros.effects.manifold import Manifold
        return Manifold(listed, kernel, effects)
