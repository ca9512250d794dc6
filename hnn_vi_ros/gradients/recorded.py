# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Record of a run, from which its steps can be taken again for its derivatives."""

from collections.abc import Iterator
import math
from typing import NamedTuple

from hnn_vi_ros.gradients.checkpoints import Checkpoints
from hnn_vi_ros.trajectory.simulate import BLOCK
import numpy as np

# Steps that are differentiated at a time, at least.
_PIECE = 64


class Segment(NamedTuple):
    """Steps that follow one another."""

    first: int
    count: int

    @property
    def steps(self) -> np.ndarray:
        """Return them, each by the number of steps before it, shape (K,)."""
        return self.first + np.arange(self.count)


class Block(NamedTuple):
    """
    Trajectories that step together.

    Parameters
    ----------
    rows : slice
        Which of all.
    kept : Checkpoints
        Snapshots at the starts of segments, before the last segment.
    last : np.ndarray, shape (K + 1, m, 2 d)
        The states before and after the steps of the last segment, which may have no step.

    """

    rows: slice
    kept: Checkpoints
    last: np.ndarray


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
    blocks : list of Block
        All trajectories.

    """

    z: np.ndarray
    every: int
    first: np.ndarray
    commands: np.ndarray | None
    segments: list[Segment]
    blocks: list[Block]

    @property
    def samples(self) -> int:
        """Return how many there are after the initial states."""
        return sum(segment.count for segment in self.segments) // self.every

    def together(self) -> Iterator[slice]:
        """Yield the trajectories that step together; each alone where each has its commands."""
        alone, a = self.commands is not None and self.commands.ndim == 3, 0
        while a < len(self.z):
            same = self.first[a:a + (1 if alone else BLOCK)] == self.first[a]
            b = a + (len(same) if same.all() else int(same.argmin()))
            yield slice(a, b)
            a = b

    def samples_in(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        """Return which of the states of a segment are samples after it, and which samples."""
        after = segment.steps + 1
        inside = np.flatnonzero(after % self.every == 0)
        return 1 + inside, after[inside] // self.every


def segments_of(steps: int) -> list[Segment]:
    """Return steps in pieces of sqrt(steps), at least of 64."""
    stride = max(_PIECE, math.isqrt(steps))
    return [Segment(a, min(stride, steps - a)) for a in range(0, steps, stride)]
