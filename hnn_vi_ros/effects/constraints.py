# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of holonomic constraints g(q) = 0: distances, planes, functions of the user's."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

from hnn_vi_ros.effects.points import add_along, distance, separation
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np


class ConstraintEquation(NamedTuple):
    """
    One equation g(q) = 0 between coordinates, of n of them.

    Parameters
    ----------
    first, second, anchor : np.ndarray, shape (n,)
        Two points, or a point and a place; see points.resolve_pair.
    length : float
        Of a distance [m], 0 for a plane.
    normal : np.ndarray, shape (n,)
        The unit normal of a plane, zero for a distance.
    function : callable or None
        ``function(q, gradient)`` of the user's in place of all that; see HolonomicConstraint.

    """

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    length: float
    normal: np.ndarray
    function: Callable[..., float] | None = None


class Constraints(NamedTuple):
    """
    K constraints, and the space to solve for their impulses; functions of the user's come last.

    Parameters
    ----------
    first, second, anchor, normal : np.ndarray, shape (L, n)
        See ConstraintEquation; for the L distances and planes.
    sizes, planes : np.ndarray, shape (L,)
        The number of coordinates of each, and whether it is a plane.
    lengths : np.ndarray, shape (L,)
        Their lengths [m].
    old, new, response : np.ndarray, shape (K, D)
        The gradient G of g at the start and at the end, and how q answers to impulses G^T.
    variation : np.ndarray, shape (4, D)
        A variation of q and p, and what it is mapped to.
    matrix : np.ndarray, shape (K, K)
        The linear system.
    right, defect, scale, pending : np.ndarray, shape (K,), and that of EffectState.pending
        Its right-hand side, g(q), the diagonal of the matrix, and the effects' work before the
        step.
    dependent : np.ndarray, shape (1,)
        The constraint that was last found to depend on those before it.
    middle : np.ndarray, shape (2, D)
        q and p half-way.

    """

    first: np.ndarray
    second: np.ndarray
    anchor: np.ndarray
    normal: np.ndarray
    sizes: np.ndarray
    planes: np.ndarray
    lengths: np.ndarray
    old: np.ndarray
    new: np.ndarray
    response: np.ndarray
    variation: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    defect: np.ndarray
    scale: np.ndarray
    pending: np.ndarray
    dependent: np.ndarray
    middle: np.ndarray

    @classmethod
    def of(cls, listed: Sequence[ConstraintEquation], dimension: int, effects: int
           ) -> 'Constraints':
        """Return constraints, those of functions last, with space for a kernel of dimension D."""
        known = [part for part in listed if part.function is None]
        n = max((part.first.size for part in known), default=0)
        first, second = np.full((2, len(known), n), -1)
        anchor, normal = np.zeros((2, len(known), n))
        for k, part in enumerate(known):
            for target, values in zip((first, second, anchor, normal), (
                    part.first, part.second, part.anchor, part.normal), strict=True):
                target[k, :values.size] = values
        old, new, response = np.zeros((3, len(listed), dimension))
        right, defect, scale = np.zeros((3, len(listed)))
        sizes = np.array([part.first.size for part in known], int)
        lengths = np.array([part.length for part in known], float)
        return cls(first, second, anchor, normal, sizes, np.asarray(normal.any(axis=1)), lengths,
                   old, new, response, np.zeros((4, dimension)),
                   np.zeros((len(listed), len(listed))), right, defect, scale,
                   np.zeros(effects), np.zeros(1, dtype=np.int64), np.zeros((2, dimension)))


@cache
def evaluator(functions: tuple[Callable[..., float], ...]) -> Callable[..., float]:
    """
    Return what fills g and its gradient: of distances and planes, and of these functions.

    ``evaluate(constraints, q, gradient)`` fills ``constraints.defect`` and the gradient, shape
    (K, D), and returns the largest distance that q is away from g = 0 [m], NaN included.
    """
    fill_others = _chain(functions)

    @called
    def evaluate(constraints: Constraints, q: np.ndarray, gradient: np.ndarray) -> float:
        gradient[:] = 0.0
        count = constraints.lengths.size
        for k in range(count):
            n = constraints.sizes[k]
            first, second = constraints.first[k, :n], constraints.second[k, :n]
            anchor = constraints.anchor[k, :n]
            if constraints.planes[k]:
                constraints.defect[k] = 0.0
                for j in range(n):
                    gradient[k, first[j]] = constraints.normal[k, j]
                    constraints.defect[k] += constraints.normal[k, j] * separation(
                        first, second, anchor, q, j)
            else:
                r = distance(first, second, anchor, q)
                constraints.defect[k] = r - constraints.lengths[k]
                for j in range(n):
                    along = separation(first, second, anchor, q, j)
                    add_along(first, second, j, along / r if r != 0.0 else 0.0, gradient[k])
        fill_others(q, count, constraints.defect, gradient)
        worst = 0.0
        for k in range(constraints.defect.size):
            slope = 0.0
            for i in range(q.size):
                slope = max(slope, abs(gradient[k, i]))
            away = abs(constraints.defect[k]) / slope if slope > 0.0 else np.nan
            # Written so that NaN is kept.
            worst = worst if worst >= away or worst != worst else away
        return worst
    return evaluate


_jitable = cache(inlined)


@cache
def _chain(functions: tuple[Callable[..., float], ...]) -> Callable[..., None]:
    """Return what evaluates functions of the user's, one after another."""
    if not functions:
        return _evaluate_none
    function, rest = _jitable(functions[0]), _chain(functions[1:])

    @inlined
    def fill(q: np.ndarray, k: int, defect: np.ndarray, gradient: np.ndarray) -> None:
        defect[k] = function(q, gradient[k])
        rest(q, k + 1, defect, gradient)
    return fill


@inlined
def _evaluate_none(q: np.ndarray, k: int, defect: np.ndarray, gradient: np.ndarray) -> None:
    """End the chain of functions."""
