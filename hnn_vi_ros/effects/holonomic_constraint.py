# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Holonomic constraints: a rod, plane, circle or sphere, or a user-defined equation."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal

from hnn_vi_ros.effects.base import Effect, EffectState, Place
from hnn_vi_ros.effects.points import resolve_pair
from hnn_vi_ros.effects.rattle import ConstraintEquation, suits_rattle
from hnn_vi_ros.files import import_named, NAMES_CODE
from hnn_vi_ros.hamiltonians import check_finite, check_positive
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# The options that each form requires, and its optional ones.
_OPTIONS = {
    'rod': (('point',), ('other', 'anchor', 'length')),
    'plane': (('point', 'anchor', 'normal'), ()),
    'circle': (('point', 'anchor', 'radius'), ('normal',)),
    'sphere': (('point', 'anchor', 'radius'), ()),
    'python': (('factory',), ()),
}


class HolonomicConstraint(Effect):
    """
    A holonomic constraint g(q) = 0 without friction, by RATTLE: a rod, or another ``form``.

    All constraints of a scene are solved together. H(q, p) is the Hamiltonian without them; the
    initial q and p must satisfy g(q) = 0 and g' H_p = 0. An elastic rod is `spring`. Energy
    account: no work.

    Parameters
    ----------
    form : str
        ``rod``: g = r - l, where r is the distance of two points, or of a point and a fixed one;
        ``plane``: g = n . (x - a); ``sphere``: g = abs(x - a) - R; ``circle``: a sphere,
        cut by a plane if there are three coordinates; ``python``: the function of a factory.
    point : list of str, optional
        Names of the coordinates of a point x [m].
    other : list of str, optional
        Names of the coordinates of the other end of a rod.
    anchor : list of float, optional
        The fixed position of the other end of a rod, the centre of a circle or a sphere, or a
        point of a plane [m].
    length : float, optional
        l > 0 of a rod [m]; 1 by default.
    radius : float, optional
        R > 0 of a circle or a sphere [m].
    normal : list of float, optional
        n of a plane or of a circle in space [1], of any nonzero length.
    factory : str, optional
        package.module:function; called without arguments, it returns a function g(q, gradient)
        that fills the gradient and returns g, for arrays of shape (d,); plain Python in numba's
        subset.

    Raises
    ------
    ValueError
        A value is out of its range, missing, or not used by the form; or the factory fails.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.1.

    """

    acts, conservative, batched = Place.MANIFOLD, True, False

    def __init__(self, point: list[str] | None = None, other: list[str] | None = None,
                 anchor: list[float] | None = None, length: float | None = None,
                 form: Literal['rod', 'plane', 'circle', 'sphere', 'python'] = 'rod',
                 radius: float | None = None, normal: list[float] | None = None,
                 factory: Annotated[str | None, NAMES_CODE] = None):
        self.form = form
        self._options = _check_options(form, {
            'point': point, 'other': other, 'anchor': anchor, 'length': length, 'radius': radius,
            'normal': normal, 'factory': factory})
        self._function = None if factory is None else _function_equation(factory)

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method is symmetric, symplectic and of order 2, like RATTLE."""
        return suits_rattle(integrator)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> tuple[ConstraintEquation, ...]:
        """Return the equations: two for a circle in space, else one."""
        if self._function is not None:
            return (self._function,)
        return _equations(self.form, self._options, coordinates)


def _check_options(form: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that are given, or raise ValueError if one does not match the form."""
    required, optional = _OPTIONS[form]
    there = {name: value for name, value in options.items() if value is not None}
    for name in required:
        if name not in there:
            raise ValueError(f'the form {form} requires {name}; valid keys: '
                             f'{", ".join(required + optional)}')
    for name in there:
        if name not in required + optional:
            raise ValueError(f'the form {form} does not use {name}; valid keys: '
                             f'{", ".join(required + optional)}')
    if form == 'rod':
        there.setdefault('length', 1.0)
    for name in ('length', 'radius'):
        if name in there:
            check_positive(**{name: there[name]})
    if 'normal' in there:
        size = float(np.linalg.norm(there['normal']))
        check_finite(normal=size)
        if size == 0.0:
            raise ValueError(f'normal = {there["normal"]} must not be zero')
    return there


def _equations(form: str, options: Mapping[str, Any], coordinates: Sequence[Coordinate]
               ) -> tuple[ConstraintEquation, ...]:
    """Return the equations of a form other than python, or raise ValueError."""
    point, anchor, normal = options['point'], options.get('anchor'), options.get('normal')
    ends = resolve_pair(coordinates, point, options.get('other'), anchor)
    if anchor is not None:
        check_finite(anchor=float(np.abs(anchor).max()))
    n = len(point)
    if normal is not None and len(normal) != n:
        raise ValueError(f'normal has {len(normal)} entries but point has {n}, expected the '
                         'same number')
    length = options.get('length', options.get('radius', 0.0))
    distance = ConstraintEquation(*ends, length, np.zeros(n))
    if form == 'plane':
        return (_plane(ends, options['normal']),)
    if form == 'circle' and n not in (2, 3):
        raise ValueError(f'point has {n} entries, expected 2 or 3 for a circle')
    if form == 'circle' and (n == 3) != (normal is not None):
        raise ValueError('give normal for a circle in 3 coordinates, but not in 2')
    if form == 'sphere' and n != 3:
        raise ValueError(f'point has {n} entries, expected 3 for a sphere')
    return (distance,) if normal is None else (distance, _plane(ends, normal))


def _plane(ends: tuple[np.ndarray, np.ndarray, np.ndarray], normal: Sequence[float]
           ) -> ConstraintEquation:
    return ConstraintEquation(*ends, 0.0, np.array(normal) / np.linalg.norm(normal))


def _function_equation(factory: str) -> ConstraintEquation:
    """Return the equation of a user-defined function, or raise ValueError if there is none."""
    try:
        function = _call(import_named(factory))
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise ValueError(f'factory = {factory!r}: {type(problem).__name__}: '
                         f'{" ".join(str(problem).split())}') from problem
    if not callable(function):
        raise ValueError(f'factory = {factory!r} returned a {type(function).__name__}, expected '
                         'a function g(q, gradient)')
    none = np.zeros(0, dtype=np.int64)
    # The Python code of a compiled function is used, to be compiled into the steps.
    return ConstraintEquation(none, none, np.zeros(0), 0.0, np.zeros(0),
                              getattr(function, 'py_func', function))


@cache
def _call(factory: Callable[[], object]) -> object:
    """Return the function of a factory, cached: another one would be compiled again."""
    return factory()
