# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The manifold of a scene's holonomic constraints, and checks of states on it."""

from collections.abc import Callable, Sequence
from functools import cache

from hnn_vi_ros.effects.base import EffectError
from hnn_vi_ros.effects.rattle import ConstraintEquation, Constraints, evaluator, rattle_kind
from hnn_vi_ros.kernels import DEPENDENT, Kernel
import numba
import numpy as np

# Relative error that an initial state may have. The first step removes it; a larger one is treated
# as a mistake instead of being projected silently.
_STATE_TOLERANCE = 1e-9
# Spacing of a central difference, and its allowed relative error, 1000 times its rounding.
# Constraints with a share above _MIN_SHARE are named if another depends on them.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
_MAX_ERROR, _MIN_SHARE = 1e-6, 1e-6


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
        Parameters and workspace of steps.
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
                self._indices[-1], f'{len(self._listed)} constraints on {self._d} coordinates '
                                   'leave no degree of freedom; remove some')
        functions = tuple(part.function for part in self._listed if part.function is not None)
        for function, index in zip(functions, self._indices[-len(functions):], strict=False):
            if kernel.compiled:
                _check_compiles(function, index)
        self.constraints = Constraints.of(self._listed, None, kernel.dimension, effects)
        self.kind, self._evaluate = rattle_kind(functions), evaluator(functions)

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
            q violates a constraint, or the velocity leaves the manifold.

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
            if not abs(slope - gradient[i]) <= _MAX_ERROR * max(scale, abs(slope)) or scale == 0.0:
                raise EffectError(self._indices[k], (
                    f'factory: wrong gradient of g: at the initial q its component {i} is '
                    f'{gradient[i]:.9g}, but finite differences of g give {slope:.9g}'))

    def _check_position(self, k: int, q: np.ndarray, g: float, slope: float) -> None:
        part = self._listed[k]
        if part.length > 0.0:
            if not abs(g) <= _STATE_TOLERANCE * part.length:
                raise ValueError(
                    f'{self._names[k]} requires a distance of {part.length!r} m, but the initial '
                    f'q has {part.length + g!r} m, an error of {abs(g):.3g} m')
        elif not abs(g) <= _STATE_TOLERANCE * slope * (1.0 + np.abs(q).max()):
            raise ValueError(f'{self._names[k]} requires g(q) = 0, but the initial q has '
                             f'g = {g:.9g}')

    def _check_velocity(self, k: int, rate: float, scale: float) -> None:
        if not abs(rate) <= _STATE_TOLERANCE * scale:
            distance = self._listed[k].length > 0.0
            what, unit = ('a distance', 'm/s') if distance else ('g(q) = 0', '1/s')
            raise ValueError(f'{self._names[k]} keeps {what}, but the initial p changes it by '
                             f'{rate:.3g} {unit}; choose p with a velocity along the constraint')

    def _check_independence(self, state: np.ndarray, gradient: np.ndarray) -> None:
        """Find the first constraint whose gradient depends on earlier ones, in the metric H_pp."""
        response = np.zeros_like(gradient)
        zero, rest = np.zeros((2, gradient.shape[1]))
        for along, answer in zip(gradient, response, strict=True):
            self._kernel.hessian_vector(
                self._kernel.parameters, state[0], state[1], zero, along, rest, answer)
        gram = gradient @ response.T
        for k in range(len(gram)):
            if not gram[k, k] > 0.0:
                raise EffectError(self._indices[k], (
                    'H_pp is not positive normal to the constraint, so no impulse can satisfy it; '
                    'remove it, or start elsewhere'))
            shares = np.linalg.solve(gram[:k, :k], gram[:k, k])
            if gram[k, k] - shares @ gram[:k, k] <= DEPENDENT * gram[k, k]:
                sizes = np.abs(shares) * np.sqrt(np.diag(gram)[:k])
                others = dict.fromkeys(name for name, size in zip(self._names, sizes, strict=False)
                                       if size > _MIN_SHARE * np.sqrt(gram[k, k]))
                raise EffectError(self._indices[k], (
                    f'{self._names[k]} is redundant at the initial q, because of '
                    f'{", ".join(others)}; remove one of them, or start elsewhere'))


@cache
def _compile_problem(function: object) -> str:
    """Return the reason numba cannot compile a user's function, '' if it can."""
    try:
        numba.njit(function).compile((numba.float64[::1], numba.float64[::1]))
    except numba.core.errors.NumbaError as problem:
        return ' '.join(str(problem).split())[:200]
    return ''


def _check_compiles(function: object, index: int) -> None:
    problem = _compile_problem(function)
    if problem:
        raise EffectError(index, f'factory: numba cannot compile the function: {problem}; use '
                                 'only plain Python and numpy in it')
