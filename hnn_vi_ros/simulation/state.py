# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Complete state of a simulation: all arrays that its next steps depend on."""

from collections.abc import Mapping

from hnn_vi_ros.integrators import PhasePoint
import numpy as np
from numpy.typing import ArrayLike

# Length of the head of a row: initial energy, number of steps so far, active method (-1: the
# first, and H' of the point is not evaluated yet).
HEAD = 3


class State:
    """
    Arrays that the next steps depend on, by name, and as one row of R numbers.

    A row consists of the initial energy, the number of steps so far, and the active method (-1:
    the first, and H' of the point is not evaluated yet); then the arrays, as 64-bit numbers of any
    type, viewed as float64.

    Parameters
    ----------
    named : mapping of str to np.ndarray
        The arrays before the first step; the point's come first.
    point : Point
        The point that some of the arrays belong to.

    Attributes
    ----------
    size : int
        Number of coordinates of the point.

    """

    def __init__(self, named: Mapping[str, np.ndarray], point: PhasePoint):
        self.named = named
        # Views of the same memory.
        self.flat = tuple(array.reshape(-1).view(np.float64) for array in named.values())
        self._fresh = self.row(np.nan, 0, -1)
        self._counts = HEAD + np.flatnonzero(np.concatenate([
            np.full(part.size, name.endswith('.count'))
            for name, part in zip(named, self.flat, strict=True)]))
        self.size = point.q.size
        # The clock follows the point.
        self._clock = HEAD + sum(array.size for array in point)

    def column(self, name: str) -> int:
        """Return the first column of an array in rows."""
        before = list(self.named).index(name)
        return HEAD + sum(part.size for part in self.flat[:before])

    def row(self, energy0: float, steps: int, active: int) -> np.ndarray:
        """Return the current row, shape (R,)."""
        return np.concatenate([[energy0, steps, active], *self.flat])

    def put(self, row: np.ndarray) -> None:
        """Copy a row into the arrays."""
        place = HEAD
        for part in self.flat:
            part[:] = row[place:place + part.size]
            place += part.size

    def row_of(self, snapshot: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the row of a snapshot; see ``Simulation.snapshot``."""
        head = [snapshot['energy0'], snapshot['steps'], snapshot['way']]
        return np.concatenate([head, *(
            np.ascontiguousarray(snapshot[name]).reshape(-1).view(np.float64)
            for name in self.named)])

    def fresh(self, z: np.ndarray, d: int, time: ArrayLike, step: ArrayLike) -> np.ndarray:
        """Return rows, (m, R), of states (q, p), (m, 2 d), after `step` steps, at `time` [s]."""
        rows = np.tile(self._fresh, (len(z), 1))
        rows[:, 1], rows[:, HEAD:HEAD + d] = step, z[:, :d]
        rows[:, HEAD + self.size:HEAD + self.size + z.shape[1] - d] = z[:, d:]
        rows[:, self._clock] = time
        return rows

    def without_counts(self, row: np.ndarray) -> np.ndarray:
        """Return a copy of a row without earlier solutions for initial guesses."""
        row = row.copy()
        row[..., self._counts] = 0.0
        return row
