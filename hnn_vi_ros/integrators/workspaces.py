# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Workspaces of steps: named arrays, allocated once.

The memory of a method is a tuple of workspaces, each a NamedTuple of arrays or of groups of them:
one for each implicit equation, and one for a composition or a wrapper of steps, which follows the
inner workspaces. The group ``kept`` of a workspace contains the values that persist from step to
step and are part of a simulation's state; each step fills everything else again.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

# Maximum unknowns for which Newton's method can have a Jacobian, maximum for which it is faster
# with one, and the dimension of the Krylov space without one.
LARGEST_MATRIX, FAST_MATRIX, KRYLOV_DIMENSION = 512, 128, 30
# Earlier evaluations that Anderson's method combines with the last one.
DEPTH = 3


def discard_history(memory: tuple) -> None:
    """
    Discard the earlier solutions of all equations in a memory, and the history of watches.

    Each group ``kept`` counts its entries in ``count``. For compiled code see compiled_workspaces.
    """
    for workspace in memory:
        kept: Any = getattr(workspace, 'kept', None)
        # Every tuple has a method of this name.
        if 'count' in getattr(kept, '_fields', ()):
            kept.count[0] = 0


def mark_independent(memory: tuple, row: int, width: int, end: int) -> None:
    """
    Mark the equations of a memory as consisting of independent systems, if they do.

    Parameters
    ----------
    memory : tuple
        Memory of a method, for the coordinates of all systems.
    row, width : int
        Number of coordinates of all systems, and of one system.
    end : int
        End of the systems among these coordinates. Nothing depends on those that follow.

    """
    for workspace in memory:
        solver = getattr(workspace, 'solver', None)
        # A common clock adds an unknown.
        if isinstance(solver, SolverWork) and solver.iterates.scale.size % row == 0:
            solver.iterates.layout[:] = row, width, end


def mark_commanded(memory: tuple) -> None:
    """Mark the internal steps of a memory, if any, as ending where commands change forces."""
    for workspace in memory:
        if 'ends_at_clock' in getattr(workspace, '_fields', ()):
            workspace.ends_at_clock[0] = 1


def arrays_of(name: str, group: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield all arrays of a group, at any depth, with dotted names that begin with its name."""
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
        Its workspaces in numba's layout.
    counts : np.ndarray of int64, shape (K,)
        Addresses of the counts in them that ``discard_history`` sets to zero.

    """

    words: np.ndarray
    counts: np.ndarray


class History(NamedTuple):
    """
    Earlier solutions of an equation of N unknowns.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        Number of earlier solutions.
    increments : np.ndarray, shape (3, N)
        The solutions minus their starting points, the newest first.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    increments: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'History':
        """Return the history of an equation of n unknowns before its first solution."""
        return cls(np.zeros(1, dtype=np.int64), np.zeros((3, n), dtype))


class Iterates(NamedTuple):
    """
    Arrays that every solver of N unknowns uses.

    Parameters
    ----------
    scale, own_scale : np.ndarray, shape (N,)
        Scales of relative residuals: of the largest unknown of a kind, and of each unknown.
    accepted : np.ndarray, shape (N,)
        The last accepted iterate.
    held : np.ndarray, shape (N,)
        The variables that the equation holds constant, if it has any.
    first : np.ndarray, shape (2,)
        The residuals of the first two iterates of the last solve.
    values, residuals : np.ndarray, shape (4, N)
        The last evaluations of the fixed-point map and their relative residuals; Newton's method
        uses only the first row.
    layout : np.ndarray of int, shape (3,)
        Unknowns are arranged in rows of the first length. Up to the third number, each row
        consists of independent systems of the second length; nothing depends on the others. All
        are N for a single system.

    """

    scale: np.ndarray
    own_scale: np.ndarray
    accepted: np.ndarray
    held: np.ndarray
    first: np.ndarray
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
        The changes in that basis; the last column contains the residual, then the solution.

    """

    basis: np.ndarray
    triangle: np.ndarray


class NewtonWork(NamedTuple):
    """
    Arrays of Newton's method for N unknowns, with a Jacobian or with m Krylov directions.

    Parameters
    ----------
    direction, product : np.ndarray, shape (N,)
        A unit vector, a Krylov direction or a Newton step; and G' times it.
    matrix : np.ndarray, shape (N, N) or (0, 0)
        The Jacobian, then its factors; empty if N is too large.
    pivots : np.ndarray, shape (N,) or (0,)
        Row exchanges of the factorisation.
    known : np.ndarray, shape (N,)
        Bound on the accuracy of G, in units of eps.
    solved : np.ndarray, shape (N,)
        The last solved point on the way from h = 0, used by continuation.
    directions : np.ndarray, shape (m + 1, N) or (0, 0)
        Basis of the Krylov space; empty if N is small.
    hessenberg : np.ndarray, shape (m + 1, m)
        The matrix in that space, kept triangular by rotations.
    rotations : np.ndarray, shape (3, m + 1)
        Cosines and sines of the rotations, and the right-hand side.
    weights : np.ndarray, shape (N,)
        Sizes of the unknowns, which weight the norm of that space.

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
    Arrays of all solvers of one equation, since a step may use several of them in turn.

    Parameters
    ----------
    iterates : Iterates
        Arrays of every solver.
    anderson, newton
        Arrays of Anderson's method, and of Newton's method.

    """

    iterates: Iterates
    anderson: AndersonWork
    newton: NewtonWork

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64, largest_matrix: int = LARGEST_MATRIX
              ) -> 'SolverWork':
        """Return the workspace for n unknowns, with a Jacobian up to ``largest_matrix``."""
        def zeros(*shape: int) -> np.ndarray:
            return np.zeros(shape, dtype)

        side = n if n <= largest_matrix else 0
        m = KRYLOV_DIMENSION if n > min(FAST_MATRIX, largest_matrix) else 0
        rows = (m + 1, n) if m else (0, 0)
        return cls(
            Iterates(zeros(n), zeros(n), zeros(n), zeros(n), np.zeros(2),
                     zeros(DEPTH + 1, n), zeros(DEPTH + 1, n), np.full(3, n, dtype=np.int64)),
            AndersonWork(zeros(DEPTH, n), zeros(DEPTH, DEPTH + 1)),
            NewtonWork(zeros(n), zeros(n), zeros(side, side), np.zeros(side, dtype=np.int64),
                       zeros(n), zeros(n), zeros(*rows), zeros(m + 1, m), zeros(3, m + 1),
                       zeros(n)))
