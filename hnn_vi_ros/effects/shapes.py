# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The forms of holonomic constraints that have a name, as equations between coordinates."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

from hnn_vi_ros.effects.constraints import ConstraintEquation
from hnn_vi_ros.effects.points import resolve_pair
from hnn_vi_ros.files.named_code import import_named
from hnn_vi_ros.hamiltonians.parameters import check_finite, check_positive
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# What each form must be given, and what it may be.
_KEYS = {
    'rod': (('point',), ('other', 'anchor', 'length')),
    'plane': (('point', 'anchor', 'normal'), ()),
    'circle': (('point', 'anchor', 'radius'), ('normal',)),
    'sphere': (('point', 'anchor', 'radius'), ()),
    'python': (('factory',), ()),
}


def check_keys(form: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return what a form needs of what was given.

    Raises
    ------
    ValueError
        Something is missing, has no meaning for the form, or is out of its range.

    """
    required, optional = _KEYS[form]
    there = {name: value for name, value in given.items() if value is not None}
    for name in required:
        if name not in there:
            raise ValueError(f'{name} is required by the form {form}, which takes '
                             f'{", ".join(required + optional)}')
    for name in there:
        if name not in required + optional:
            raise ValueError(f'{name} has no meaning for the form {form}, which takes '
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


def equations_of(form: str, given: Mapping[str, Any], coordinates: Sequence[Coordinate]
                 ) -> tuple[ConstraintEquation, ...]:
    """
    Return the equations of a form, other than python.

    Raises
    ------
    ValueError
        Unknown coordinates, or lists of lengths that do not fit.

    """
    point, anchor, normal = given['point'], given.get('anchor'), given.get('normal')
    ends = resolve_pair(coordinates, point, given.get('other'), anchor)
    if anchor is not None:
        check_finite(anchor=float(np.abs(anchor).max()))
    n = len(point)
    if normal is not None and len(normal) != n:
        raise ValueError(f'normal has {len(normal)} entries, point has {n}: expected the same '
                         'number')
    length = given.get('length', given.get('radius', 0.0))
    distance = ConstraintEquation(*ends, length, np.zeros(n))
    if form == 'plane':
        return (_plane(ends, given['normal']),)
    if form == 'circle' and n not in (2, 3):
        raise ValueError(f'point has {n} entries, but a circle is in 2 or 3 coordinates')
    if form == 'circle' and (n == 3) != (normal is not None):
        raise ValueError('normal is what a circle in 3 coordinates needs, and one in 2 has not')
    if form == 'sphere' and n != 3:
        raise ValueError(f'point has {n} entries, but a sphere is in 3 coordinates')
    return (distance,) if normal is None else (distance, _plane(ends, normal))


def _plane(ends: tuple[np.ndarray, np.ndarray, np.ndarray], normal: Sequence[float]
           ) -> ConstraintEquation:
    return ConstraintEquation(*ends, 0.0, np.array(normal) / np.linalg.norm(normal))


def function_equation(factory: str) -> ConstraintEquation:
    """
    Return the equation that a user's function makes.

    Raises
    ------
    ValueError
        It cannot be imported, fails, or returns something else than a function.

    """
    try:
        function = _call(import_named(factory))
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise ValueError(f'factory = {factory!r}: {type(problem).__name__}: '
                         f'{" ".join(str(problem).split())}') from problem
    if not callable(function):
        raise ValueError(f'factory = {factory!r} returned a {type(function).__name__}, expected '
                         'a function g(q, gradient)')
    none = np.zeros(0, dtype=np.int64)
    # Of a function that is compiled already, the Python: it will be compiled into the steps.
    return ConstraintEquation(none, none, np.zeros(0), 0.0, np.zeros(0),
                              getattr(function, 'py_func', function))


@cache
def _call(factory: Callable[[], Any]) -> Any:
    """Return what a factory makes, once for all: another function would be compiled anew."""
    return factory()
