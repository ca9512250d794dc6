# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps among stamps that come evenly."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# Stamps are rounded to nanoseconds, and so are their differences.
_ROUNDING = 2
# Fewer differences, or fewer of them alike, are no grid.
_LEAST, _SHARE = 3, 0.5


class Missing(NamedTuple):
    """
    A gap in an even grid.

    Parameters
    ----------
    after, before : int
        The stamps around it [ns].
    count : int
        How many stamps are missing in between.

    """

    after: int
    before: int
    count: int  # type: ignore[assignment]  # not tuple.count


def missing_stamps(stamps: Sequence[int] | np.ndarray, spacing: int | None = None
                   ) -> list[Missing]:
    """
    Return the gaps in a grid, whose spacing is the most frequent difference if none is given.

    Stamps in between, as of single steps in a pause, are not asked for and no harm. Stamps of
    which less than half are evenly spaced have no gaps.

    Parameters
    ----------
    stamps : sequence of int
        In any order [ns].
    spacing : int, optional
        What lies between two of them at most [ns].

    """
    t = np.unique(np.asarray(stamps, dtype=np.uint64))
    differences = np.diff(t).astype(np.float64)
    usual = spacing or _frequent(differences)
    if usual is None:
        return []
    return [Missing(int(t[i]), int(t[i + 1]), round(differences[i] / usual) - 1)
            for i in np.flatnonzero(differences > 1.5 * usual)]


def _frequent(differences: np.ndarray) -> float | None:
    """Return the most frequent difference; None where less than half are that."""
    if len(differences) < _LEAST:
        return None
    values, counts = np.unique(differences, return_counts=True)
    spacing = float(values[np.argmax(counts)])
    even = np.abs(differences - spacing) <= _ROUNDING
    return spacing if even.sum() >= max(_LEAST, _SHARE * len(differences)) else None


def missing_in_all(topics: Sequence[Sequence[int]]) -> list[Missing]:
    """
    Return the gaps in the grid of a recording.

    Only topics that come about as often as the most frequent one count, and a gap is one only if
    none of them tells anything in it: commands, alarms and diagnostics come when they like.

    Parameters
    ----------
    topics : sequence of sequence of int
        The stamps of each topic [ns].

    """
    most = max(map(len, topics), default=0)
    frequent = [np.asarray(stamps, dtype=np.uint64) for stamps in topics
                if 2 * len(stamps) >= most]
    found = max(map(missing_stamps, frequent), default=[],
                key=lambda gaps: sum(gap.count for gap in gaps))
    if not found:
        return []
    every = np.unique(np.concatenate(frequent))
    return [gap for gap in found
            if np.searchsorted(every, gap.after, 'right') == np.searchsorted(every, gap.before)]
