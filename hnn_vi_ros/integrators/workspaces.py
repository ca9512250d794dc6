# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Workspaces of steps: named arrays, allocated once.

The memory of a method is a tuple of workspaces, each a NamedTuple of arrays or of groups of them:
one for each implicit equation, and one for a composition of steps, or a wrapper around them,
after the workspaces inside. The group ``kept`` of a workspace holds the values that outlive a
step and are part of a simulation's state; each step fills all else again.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

# Unknowns of an equation up to which Newton's method can have a Jacobian, and up to which it takes
# less time with one than without; and the vectors that it keeps without.
LARGEST_MATRIX, FAST_MATRIX, KRYLOV_DIMENSION = 512, 128, 30
# Earlier evaluations that Anderson's method combines with the last one.
DEPTH = 3


def forget(memory: tuple) -> None:
    """
    Let no equation of a memory start from earlier solutions; nor a watch, from earlier steps.

    Each group ``kept`` counts in ``count`` what it knows of earlier steps. For compiled code see
    compiled_workspaces.
    """
    for workspace in memory:
        kept: Any = getattr(workspace, 'kept', None)
        # Every tuple has a method of this name.
        if 'count' in getattr(kept, '_fields', ()):
            kept.count[0] = 0


def separate(memory: tuple, row: int, width: int) -> None:
    """
    Mark the equations of a memory as belonging to several systems, where they do.

    Parameters
    ----------
    memory : tuple
        Of a method, for as many coordinates as all systems have.
    row, width : int
        How many coordinates that are, and how many of them one system has.

    """
    for workspace in memory:
        solver = getattr(workspace, 'solver', None)
        # A common clock adds an unknown.
        if isinstance(solver, SolverWork) and solver.iterates.scale.size % row == 0:
            solver.iterates.layout[:] = row, width


def arrays_of(name: str, group: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Return all arrays of a group, however deep in it, with their names after that of it."""
    for field, value in group._asdict().items():
        if isinstance(value, tuple):
            yield from arrays_of(f'{name}.{field}', value)
        else:
            yield f'{name}.{field}', value


class MemoryByAddress(NamedTuple):
    """
    The memory of a step that is called by address; for compiled code only.

    Parameters
    ----------
    words : np.ndarray of int64
        Its workspaces as numba lays them out.
    counts : np.ndarray of int64, shape (K,)
        The addresses of the counts in them that ``forget`` takes to zero.

    """

    words: np.ndarray
    counts: np.ndarray


class History(NamedTuple):
    """
    Earlier solutions of an equation of N unknowns.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        How many of them there are.
    increments : np.ndarray, shape (3, N)
        They less their starting points, the newest first.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    increments: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'History':
        """Return the history of an equation of n unknowns before its first solution."""
        return cls(np.zeros(1, dtype=np.int64), np.zeros((3, n), dtype))


class Iterates(NamedTuple):
    """
    Arrays that every solver of N unknowns works on.

    Parameters
    ----------
    scale, own_scale : np.ndarray, shape (N,)
        Sizes to which residuals are relative: of the largest unknown of its kind, and its own.
    accepted : np.ndarray, shape (N,)
        The last iterate that was good enough.
    slow_start : np.ndarray, shape (1,)
        1 if the first iteration of the last solve did not halve its residual, else 0.
    values, residuals : np.ndarray, shape (4, N)
        The last evaluations of the fixed-point map and their relative residuals; Newton's method
        fills the first of them.
    layout : np.ndarray of int, shape (2,)
        Unknowns lie in rows of the first number; in each row systems that do not depend on each
        other follow one another, with the second number of unknowns each. Both are N for one.

    """

    scale: np.ndarray
    own_scale: np.ndarray
    accepted: np.ndarray
    slow_start: np.ndarray
    values: np.ndarray
    residuals: np.ndarray
    layout: np.ndarray


class AndersonWork(NamedTuple):
    """
    The small least-squares problem of Anderson's method.

    Parameters
    ----------
    basis : np.ndarray, shape (3, N)
        The changes of the residual, orthogonalised.
    triangle : np.ndarray, shape (3, 4)
        The changes in that basis, and in the last column the residual, then the solution.

    """

    basis: np.ndarray
    triangle: np.ndarray


class NewtonWork(NamedTuple):
    """
    Arrays of Newton's method for N unknowns: with a Jacobian, or without one in m directions.

    Parameters
    ----------
    direction, product : np.ndarray, shape (N,)
        A unit vector, a direction of the Krylov space or a Newton step; and G' times it.
    matrix : np.ndarray, shape (N, N) or (0, 0)
        The Jacobian, then its factors; empty where N is too large for one.
    pivots : np.ndarray, shape (N,) or (0,)
        The rows that were exchanged to factorise it.
    known : np.ndarray, shape (N,)
        To eps times this G is known at best.
    solved : np.ndarray, shape (N,)
        The last point that was solved on the way from h = 0, by continuation.
    directions : np.ndarray, shape (m + 1, N) or (0, 0)
        The Krylov space; empty where N is small.
    hessenberg : np.ndarray, shape (m + 1, m)
        The matrix in that space, kept triangular by rotations.
    rotations : np.ndarray, shape (3, m + 1)
        Their cosines and sines, and the right-hand side.
    weights : np.ndarray, shape (N,)
        The sizes of unknowns, in which lengths in that space are measured.

    """

    direction: np.ndarray
    product: np.ndarray
    matrix: np.ndarray
    pivots: np.ndarray
    known: np.ndarray
    solved: np.ndarray
    directions: np.ndarray
    hessenberg: np.ndarray
    rotations: np.ndarray
    weights: np.ndarray


class SolverWork(NamedTuple):
    """
    Arrays of all solvers of one equation: a step may take one after another.

    Parameters
    ----------
    iterates : Iterates
        Of every solver.
    anderson, newton
        Of Anderson's method, and of Newton's, with a Jacobian or without.

    """

    iterates: Iterates
    anderson: AndersonWork
    newton: NewtonWork

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64, largest_matrix: int = LARGEST_MATRIX
              ) -> 'SolverWork':
        """Return the working space for n unknowns, which have a Jacobian up to the largest."""
        def zeros(*shape: int) -> np.ndarray:
            return np.zeros(shape, dtype)

        side = n if n <= largest_matrix else 0
        m = KRYLOV_DIMENSION if n > min(FAST_MATRIX, largest_matrix) else 0
        rows = (m + 1, n) if m else (0, 0)
        return cls(
            Iterates(zeros(n), zeros(n), zeros(n), np.zeros(1, dtype=np.int64),
                     zeros(DEPTH + 1, n), zeros(DEPTH + 1, n), np.full(2, n, dtype=np.int64)),
            AndersonWork(zeros(DEPTH, n), zeros(DEPTH, DEPTH + 1)),
            NewtonWork(zeros(n), zeros(n), zeros(side, side), np.zeros(side, dtype=np.int64),
                       zeros(n), zeros(n), zeros(*rows), zeros(m + 1, m), zeros(3, m + 1),
                       zeros(n)))
