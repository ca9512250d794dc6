# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The record of a run, from which its steps are taken once more, some at a time."""

import math
from typing import NamedTuple

import numpy as np

# Steps that are differentiated at a time, at least.
_PIECE = 64


class Segment(NamedTuple):
    """Steps that follow one another."""

    first: int
    length: int

    @property
    def steps(self) -> np.ndarray:
        """Return them, each by the number of steps before it, shape (K,)."""
        return self.first + np.arange(self.length)


class Recorded(NamedTuple):
    """
    Record of a run.

    Parameters
    ----------
    z : np.ndarray, shape (m, 2 d)
        The initial states.
    every : int
        Steps from one sample to the next.
    first : np.ndarray of int, shape (m,)
        The step at which each trajectory begins.
    commands : np.ndarray or None
        See ``DifferentiableRun.record``.
    segments : list of Segment
        All steps.
    starts : list of np.ndarray, shape (m, R)
        Rows at the start of each; see ``Simulation.follow``.
    last : np.ndarray, shape (K + 1, m, 2 d)
        The states before and after the steps of the last segment, which may have no step.

    """

    z: np.ndarray
    every: int
    first: np.ndarray
    commands: np.ndarray | None
    segments: list[Segment]
    starts: list[np.ndarray]
    last: np.ndarray

    @property
    def samples(self) -> int:
        """Return how many there are after the initial states."""
        return sum(segment.length for segment in self.segments) // self.every

    def samples_in(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        """Return which of the states of a segment are samples after it, and which samples."""
        after = segment.steps + 1
        inside = np.flatnonzero(after % self.every == 0)
        return 1 + inside, after[inside] // self.every

    def commands_in(self, segment: Segment) -> np.ndarray:
        """Return the commands in the steps of a segment, shape (K, m, c), c = 0 without any."""
        if self.commands is None:
            return np.zeros((segment.length, len(self.z), 0))
        rows = self.commands[segment.steps // self.every]
        return rows if rows.ndim == 3 else np.repeat(rows[:, None], len(self.z), axis=1)


def segments_of(steps: int) -> list[Segment]:
    """Return steps in pieces of sqrt(steps), at least of 64."""
    stride = max(_PIECE, math.isqrt(steps))
    return [Segment(a, min(stride, steps - a)) for a in range(0, steps, stride)]
