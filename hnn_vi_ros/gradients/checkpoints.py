# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Snapshots kept to go through a run backwards, chosen when memory is for a few alone."""

from collections.abc import Callable, Iterator
import math
from typing import NamedTuple

from hnn_vi_ros.trajectory.simulate import BLOCK
import numpy as np

Snapshot = dict[str, np.ndarray]


class Checkpoints:
    """
    Snapshots at the starts of pieces of a run, at most so many kept at a time.

    Pieces whose snapshot is not kept are taken again from the last one that is: of n pieces and s
    snapshots, n <= C(s + t, s) are reached by taking none more than t times (binomial
    checkpoints). No other order takes fewer pieces again.

    Parameters
    ----------
    count : int
        n pieces.
    most : int
        s >= 1 snapshots, that of the start among them.

    Attributes
    ----------
    kept : dict of int to dict
        Snapshots by the piece that begins there.
    highest : int
        Most of them at any time so far.
    repeated : int
        Pieces that were taken again so far, only to reach others.

    References
    ----------
    A. Griewank, A. Walther, Algorithm 799: revolve, ACM Transactions on Mathematical Software 26
    (2000).

    """

    def __init__(self, count: int, most: int):
        self.count, self.most = count, most
        self.kept: dict[int, Snapshot] = {}
        self.highest = self.repeated = 0
        # Those that are met first on the way back.
        self._on_the_way, first, free = set(range(min(count, 1))), 0, most
        while free > 1 and count - first > 1:
            first, free = first + split(count - first, free), free - 1
            self._on_the_way.add(first)

    def pass_by(self, piece: int, snapshot: Callable[[], Snapshot]) -> None:
        """Keep a snapshot at the start of a piece, on the first way through, if it is wanted."""
        if piece in self._on_the_way:
            self._keep(piece, snapshot)

    def backwards(self, restore: Callable[[Snapshot], None], advance: Callable[[int], object],
                  snapshot: Callable[[], Snapshot]) -> Iterator[int]:
        """
        Yield the pieces from the last one on, each when the run stands at its start.

        Parameters
        ----------
        restore : callable
            Puts the run back to a snapshot.
        advance : callable
            Takes it through a piece, at whose start it stands.
        snapshot : callable
            Returns one of where it stands.

        """
        # Each entry is a range of pieces whose first snapshot is kept, with how many may be.
        waiting = [(0, self.count, self.most)] if self.count else []
        while waiting:
            first, last, free = waiting.pop()
            if last - first <= 1:
                restore(self.kept[first])
                yield first
                self._drop(first)
                continue
            middle = first + split(last - first, free)
            waiting.append((first, middle, free))
            if middle not in self.kept:
                restore(self.kept[first])
                for piece in range(first, middle):
                    advance(piece)
                self.repeated += middle - first
            if free > 1:
                if middle not in self.kept:
                    self._keep(middle, snapshot)
                waiting.append((middle, last, free - 1))
            else:
                yield middle

    def _keep(self, piece: int, snapshot: Callable[[], Snapshot]) -> None:
        self.kept[piece] = snapshot()
        self.highest = max(self.highest, len(self.kept))

    def _drop(self, piece: int) -> None:
        # The start stays: the way back may be asked for again.
        if piece and self.count > self.most:
            del self.kept[piece]


def split(count: int, most: int) -> int:
    """Return after how many of so many pieces the next snapshot is best kept."""
    if most == 1:
        return count - 1
    times = 1
    while math.comb(most + times, most) < count:
        times += 1
    return min(math.comb(most + times - 1, most), count - math.comb(most + times - 2, most - 1))


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
        return sum(segment.length for segment in self.segments) // self.every

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
