# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A holonomic constraint: a rod, plane, circle or sphere, or an equation of the user's."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal

from hnn_vi_ros.effects.base import Constraint, ConstraintSet, EffectError, EffectState
from hnn_vi_ros.effects.points import resolve_pair
from hnn_vi_ros.effects.rattle import ConstraintEquation, Constraints, evaluator, rattle_kind
from hnn_vi_ros.files.named_code import import_named, NAMES_CODE
from hnn_vi_ros.hamiltonians.parameters import check_finite, check_positive
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linear_algebra import DEPENDENT
from hnn_vi_ros.phase_space import Coordinate
import numba
import numpy as np

# Relative error that an initial state may have. The first step removes it; a larger one is taken
# for a mistake instead of being projected silently.
_TOLERANCE = 1e-9
# Spacing of a central difference, and the relative error that is accepted of it, 1000 times its
# rounding. Constraints with a larger share than _SHARE are named where another depends on them.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
_SLOPE, _SHARE = 1e-6, 1e-6


class Manifold:
    """
    The holonomic constraints that a scene lists, solved together.

    Parameters
    ----------
    listed : sequence of (int, str, tuple of ConstraintEquation)
        For each constraint its index in the scene, its name and its equations.
    kernel : Kernel
        H with the forces, for d coordinates and their channels.
    effects : int
        Number of effects in the scene.

    Attributes
    ----------
    constraints : Constraints
        The parameters and the space of steps.
    kind : type
        The layer that Wrapped puts around a step.

    Raises
    ------
    EffectError
        There are more equations than coordinates, or a function cannot be compiled.

    """

    def __init__(self, listed: Sequence[tuple[int, str, tuple[ConstraintEquation, ...]]],
                 kernel: Kernel, effects: int):
        ordered = [(part, index, name) for index, name, parts in listed for part in parts]
        ordered.sort(key=lambda entry: entry[0].function is not None)
        self._listed = [part for part, _, _ in ordered]
        self._indices = [index for _, index, _ in ordered]
        self._names = [name for _, _, name in ordered]
        self._kernel, self._d = kernel, kernel.dimension - kernel.channels
        if len(self._listed) > self._d:
            raise EffectError(
                self._indices[-1], f'{len(self._listed)} constraints leave {self._d} coordinates '
                                   'no freedom; leave some out')
        functions = tuple(part.function for part in self._listed if part.function is not None)
        for function, index in zip(functions, self._indices[-len(functions):], strict=False):
            if kernel.compiled:
                _check_compiles(function, index)
        self.constraints = Constraints.of(self._listed, kernel.dimension, effects)
        self.kind, self._evaluate = rattle_kind(functions), evaluator(functions)

    @property
    def settings(self) -> Constraints:
        """Return the options of the steps; see ConstraintSet."""
        return self.constraints

    @property
    def dependent(self) -> str:
        """Return the name of the constraint that made a step fail as REDUNDANT."""
        return self._names[self.constraints.dependent[0]]

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:
        """
        Raise ValueError if a state, of shape (d,), does not move on the manifold.

        Raises
        ------
        EffectError
            A constraint depends on others there, or its gradient is wrong.
        ValueError
            q violates a constraint, or the velocity leads off it.

        """
        state, (velocity, force) = np.zeros((2, 2, self._kernel.dimension))
        state[0, :self._d], state[1, :self._d] = q, p
        gradient = np.zeros((len(self._listed), self._kernel.dimension))
        self._evaluate(self.constraints, state[0], gradient)
        defect = self.constraints.defect.copy()
        for k, part in enumerate(self._listed):
            if part.function is not None:
                self._check_gradient(k, part.function, q, gradient[k])
            self._check_position(k, q, float(defect[k]), float(np.abs(gradient[k]).max()))
        self._kernel.gradient(self._kernel.parameters, state[0], state[1], force, velocity)
        for k, slope in enumerate(gradient):
            self._check_velocity(k, float(slope @ velocity), np.abs(slope).max() *
                                 np.abs(velocity[:self._d]).max())
        self._check_independence(state, gradient)

    def _check_gradient(self, k: int, function: Callable[[np.ndarray, np.ndarray], float],
                        q: np.ndarray, gradient: np.ndarray) -> None:
        scale = float(np.abs(gradient).max())
        for i in range(self._d):
            sides, spacing = [], _SPACING * (1.0 + abs(q[i]))
            for sign in (1.0, -1.0):
                beside = q.copy()
                beside[i] += sign * spacing
                sides.append(function(beside, np.zeros(self._d)))
            slope = (sides[0] - sides[1]) / (2.0 * spacing)
            if not abs(slope - gradient[i]) <= _SLOPE * max(scale, abs(slope)) or scale == 0.0:
                raise EffectError(self._indices[k], (
                    f'factory: the gradient is not that of g: at the initial q its component {i} '
                    f'is {gradient[i]:.9g}, but differences of g give {slope:.9g}'))

    def _check_position(self, k: int, q: np.ndarray, g: float, slope: float) -> None:
        part = self._listed[k]
        if part.length > 0.0:
            if not abs(g) <= _TOLERANCE * part.length:
                raise ValueError(
                    f'{self._names[k]} asks for a distance of {part.length!r} m, but the initial '
                    f'q has {part.length + g!r} m, {abs(g):.3g} m off')
        elif not abs(g) <= _TOLERANCE * slope * (1.0 + np.abs(q).max()):
            raise ValueError(f'{self._names[k]} asks for g(q) = 0, but the initial q has '
                             f'g = {g:.9g}')

    def _check_velocity(self, k: int, rate: float, scale: float) -> None:
        if not abs(rate) <= _TOLERANCE * scale:
            distance = self._listed[k].length > 0.0
            what, unit = ('a distance', 'm/s') if distance else ('g(q) = 0', '1/s')
            raise ValueError(f'{self._names[k]} keeps {what}, but the initial p changes it by '
                             f'{rate:.3g} {unit}; choose p whose velocity is along the constraint')

    def _check_independence(self, state: np.ndarray, gradient: np.ndarray) -> None:
        """Find the first constraint whose gradient, measured by H_pp, depends on earlier ones."""
        response = np.zeros_like(gradient)
        zero, rest = np.zeros((2, gradient.shape[1]))
        for along, answer in zip(gradient, response, strict=True):
            self._kernel.hessian_vector(
                self._kernel.parameters, state[0], state[1], zero, along, rest, answer)
        gram = gradient @ response.T
        for k in range(len(gram)):
            if not gram[k, k] > 0.0:
                raise EffectError(self._indices[k], (
                    'H_pp is not positive across the constraint, so that no impulse can keep it; '
                    'leave it out, or start elsewhere'))
            shares = np.linalg.solve(gram[:k, :k], gram[:k, k])
            if gram[k, k] - shares @ gram[:k, k] <= DEPENDENT * gram[k, k]:
                sizes = np.abs(shares) * np.sqrt(np.diag(gram)[:k])
                others = dict.fromkeys(name for name, size in zip(self._names, sizes, strict=False)
                                       if size > _SHARE * np.sqrt(gram[k, k]))
                raise EffectError(self._indices[k], (
                    f'{self._names[k]} is redundant at the initial q: what it keeps, '
                    f'{", ".join(others)} {"keeps" if len(others) == 1 else "keep"} already; '
                    'leave one of them out, or start elsewhere'))


@cache
def _compiles(function: object) -> str:
    """Return the reason why numba cannot compile a user's function; empty if it can."""
    try:
        numba.njit(function).compile((numba.float64[::1], numba.float64[::1]))
    except numba.core.errors.NumbaError as problem:
        return ' '.join(str(problem).split())[:200]
    return ''


def _check_compiles(function: object, index: int) -> None:
    problem = _compiles(function)
    if problem:
        raise EffectError(index, f'factory: numba cannot compile the function: {problem}; use '
                                 'plain Python and numpy in it')


# The options that each form requires, and those that it accepts as well.
_OPTIONS = {
    'rod': (('point',), ('other', 'anchor', 'length')),
    'plane': (('point', 'anchor', 'normal'), ()),
    'circle': (('point', 'anchor', 'radius'), ('normal',)),
    'sphere': (('point', 'anchor', 'radius'), ()),
    'python': (('factory',), ()),
}


class HolonomicConstraint(Constraint):
    """
    A holonomic constraint g(q) = 0 without friction, by RATTLE: a rod, or another ``form``.

    The constraints of a scene are solved together. H(q, p) is the Hamiltonian without them; the
    initial q and p must satisfy g(q) = 0 and g' H_p = 0. Energy account: their forces do no work.

    Parameters
    ----------
    form : str
        ``rod``: g = r - l, where r is the distance of two points, or of a point and a fixed
        one; ``plane``: g = n . (x - a); ``sphere``: g = abs(x - a) - R; ``circle``: a sphere,
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
        A value is out of its range, missing, or not used by the form; the factory fails.

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
        self._options = _check_options(form, {
            'point': point, 'other': other, 'anchor': anchor, 'length': length, 'radius': radius,
            'normal': normal, 'factory': factory})
        self._function = None if factory is None else _function_equation(factory)

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method is symmetric, symplectic and of order 2, like RATTLE."""
        keeps = integrator.requirements
        return keeps.symmetric and keeps.symplectic and integrator.order == 2 and keeps.hamiltonian

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> tuple[ConstraintEquation, ...]:
        """Return the equations: two for a circle in space, else one."""
        if self._function is not None:
            return (self._function,)
        return _equations(self.form, self._options, coordinates)

    @staticmethod
    def combine(listed: Sequence[tuple[int, str, tuple[ConstraintEquation, ...]]], kernel: Kernel,
                effects: int) -> ConstraintSet:
        """Return the manifold on which all constraints hold."""
        # Imported here, since it loads the compiler, which reading a scene does not need.
        from hnn_vi_ros.effects.holonomic_constraint import Manifold
        return Manifold(listed, kernel, effects)


def _check_options(form: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that are given, or raise ValueError if one does not fit the form."""
    required, optional = _OPTIONS[form]
    there = {name: value for name, value in options.items() if value is not None}
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


def _equations(form: str, options: Mapping[str, Any], coordinates: Sequence[Coordinate]
               ) -> tuple[ConstraintEquation, ...]:
    """Return the equations of a form other than python, or raise ValueError."""
    point, anchor, normal = options['point'], options.get('anchor'), options.get('normal')
    ends = resolve_pair(coordinates, point, options.get('other'), anchor)
    if anchor is not None:
        check_finite(anchor=float(np.abs(anchor).max()))
    n = len(point)
    if normal is not None and len(normal) != n:
        raise ValueError(f'normal has {len(normal)} entries, point has {n}: expected the same '
                         'number')
    length = options.get('length', options.get('radius', 0.0))
    distance = ConstraintEquation(*ends, length, np.zeros(n))
    if form == 'plane':
        return (_plane(ends, options['normal']),)
    if form == 'circle' and n not in (2, 3):
        raise ValueError(f'point has {n} entries, but a circle is in 2 or 3 coordinates')
    if form == 'circle' and (n == 3) != (normal is not None):
        raise ValueError('normal is required for a circle in 3 coordinates; leave it out in 2')
    if form == 'sphere' and n != 3:
        raise ValueError(f'point has {n} entries, but a sphere is in 3 coordinates')
    return (distance,) if normal is None else (distance, _plane(ends, normal))


def _plane(ends: tuple[np.ndarray, np.ndarray, np.ndarray], normal: Sequence[float]
           ) -> ConstraintEquation:
    return ConstraintEquation(*ends, 0.0, np.array(normal) / np.linalg.norm(normal))


def _function_equation(factory: str) -> ConstraintEquation:
    """Return the equation of a user's function, or raise ValueError if there is none."""
    try:
        function = _call(import_named(factory))
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise ValueError(f'factory = {factory!r}: {type(problem).__name__}: '
                         f'{" ".join(str(problem).split())}') from problem
    if not callable(function):
        raise ValueError(f'factory = {factory!r} returned a {type(function).__name__}, expected '
                         'a function g(q, gradient)')
    none = np.zeros(0, dtype=np.int64)
    # If the function is compiled already, its Python code is taken, to be compiled into the steps.
    return ConstraintEquation(none, none, np.zeros(0), 0.0, np.zeros(0),
                              getattr(function, 'py_func', function))


@cache
def _call(factory: Callable[[], object]) -> object:
    """Return the function of a factory, the same each time: another would be compiled again."""
    return factory()
