# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One row of the benchmark: interleaved timing, and a ratio with its quartiles."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import gc
import math
import time
from typing import Any

import numpy as np
import numpy.typing as npt

# Longer runs than this are repeated less often [s].
LONG_RUN = 5.0
_FEWEST = 3
# Most processors that a contestant of one thread keeps busy.
_MOST_BUSY = 1.3

# Called before each run, untimed; returns the run.
Contestant = Callable[[], Callable[[], object]]


@dataclass(frozen=True)
class Row:
    """
    One line of the table.

    Parameters
    ----------
    name : str
        Name of the measured quantity; unique.
    ours, peer : str
        The two sides, each with its unit.
    ratio : float
        The figure that the target bounds, in ``unit``; NaN if it cannot be judged.
    quartiles : tuple of float
        Lower and upper quartile of the repetitions' ratios.
    target : float or None
        Largest ratio that is good enough; None for a row that only informs.
    repetitions : int
        Timed runs of each side.
    unit : str
        Unit of the ratio; empty for a ratio of two times.
    note : str
        Details of the measurement, for the text below the table.
    miss : str
        Why the target is missed, shown if it is.

    """

    name: str
    ours: str
    peer: str
    ratio: float
    quartiles: tuple[float, float]
    target: float | None
    repetitions: int
    unit: str = ''
    note: str = ''
    miss: str = ''

    @property
    def met(self) -> bool | None:
        """Return True if the target is met, None without a target or a judgement."""
        return None if self.target is None or math.isnan(self.ratio) else self.ratio <= self.target


@dataclass(frozen=True)
class Settings:
    """
    Amount of measurements.

    Parameters
    ----------
    repetitions : int
        Timed runs of each contestant.
    quick : bool
        Shorten the runs to test that everything works.
    say : callable
        Tells the user what is being done.

    """

    repetitions: int
    quick: bool
    say: Callable[[str], None]


def interleave(contestants: Sequence[Contestant], repetitions: int, *, warm_up: bool = True,
               one_thread: bool = True, of_processor: bool = False) -> np.ndarray:
    """
    Time the contestants in turns, so that other load on the machine affects all of them.

    Parameters
    ----------
    contestants : sequence of callable
        Each returns the run that is timed.
    repetitions : int
        Turns; at most 3 if a warm-up takes longer than LONG_RUN.
    warm_up : bool, optional
        Run each contestant once before, untimed.
    one_thread : bool, optional
        Do not judge a contestant that uses more than one processor.
    of_processor : bool, optional
        Return processor times, which waiting for a shared processor does not change.

    Returns
    -------
    np.ndarray, shape (turns, contestants)
        Wall or processor times [s]; NaN for a contestant that is not judged.

    """
    if warm_up and max(_seconds(contestant)[0] for contestant in contestants) > LONG_RUN:
        repetitions = min(repetitions, _FEWEST)
    wall, processor = np.empty((2, repetitions, len(contestants)))
    for turn in range(repetitions):
        # Reverse the order in every other turn, so that no contestant is always first.
        order = range(len(contestants))
        for i in order if turn % 2 == 0 else reversed(order):
            wall[turn, i], processor[turn, i] = _seconds(contestants[i])
    busy = np.median(processor / wall, axis=0)
    times = processor if of_processor else wall
    for i in np.flatnonzero(busy > _MOST_BUSY) if one_thread else ():
        print(f'  contestant {i} keeps {busy[i]:.1f} processors busy; each is to use one')
        times[:, i] = np.nan
    return times


def summarise(name: str, ours: str, peer: str, ratios: npt.ArrayLike, target: float | None,
              **more: str) -> Row:
    """Return the row of the median of some ratios, or of a single one; for the rest see Row."""
    low, median, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    return Row(name, ours, peer, float(median), (float(low), float(high)), target,
               np.size(ratios), **more)


def compare(name: str, ours: np.ndarray, peer: np.ndarray, *, target: float | None,
            scale: float = 1.0, unit: str = 'us', peer_name: str = '', note: str = '',
            miss: str = '') -> Row:
    """
    Return the row of two contestants' times.

    Parameters
    ----------
    name, target, note, miss
        See Row.
    ours, peer : np.ndarray, shape (turns,)
        Times of the same turns.
    scale : float, optional
        Factor from the times to the values of the table, in ``unit``.
    unit : str, optional
        Unit of the two sides.
    peer_name : str, optional
        Name of the peer.

    """
    return summarise(
        name, f'{scale * np.median(ours):.3g} {unit}',
        f'{peer_name} {scale * np.median(peer):.3g} {unit}'.strip(), ours / peer, target,
        note=note, miss=miss)


def race(name: str, ours: Mapping[str, Contestant], peers: Mapping[str, Contestant],
         settings: Settings, *, scale: float, unit: str = 'us', copies: int = 1, note: str = '',
         of_processor: bool = False, **row: Any) -> Row:
    """
    Time several ways of each side in turns; return the row of the fastest of each.

    The fastest has the least median: a single least time is as much the machine's as the method's.

    Parameters
    ----------
    name, scale, unit, note, row
        See ``compare``.
    ours, peers : mapping
        Contestants by name, at least one each.
    settings : Settings
        Number of repetitions.
    copies : int, optional
        Results of a peer's run, by which its time is divided.
    of_processor : bool, optional
        See ``interleave``.

    """
    names = [*ours, *peers]
    times = interleave([*ours.values(), *peers.values()], settings.repetitions,
                       of_processor=of_processor)
    times[:, len(ours):] /= copies
    medians = np.median(times, axis=0)
    mine, other = int(np.argmin(medians[:len(ours)])), len(ours) + int(
        np.argmin(medians[len(ours):]))
    told = [f'{label}: {scale * median:.3g} {unit}'
            for label, median in zip(names, medians, strict=True)]
    return compare(name, times[:, mine], times[:, other], scale=scale, unit=unit,
                   peer_name=names[other], note='; '.join(
                       [*told, *['processor times'] * of_processor, *filter(None, [note])]),
                   **row)


def assert_close(what: str, ours: np.ndarray, theirs: np.ndarray, tolerance: float) -> None:
    """
    Check that ours and a peer compute the same thing.

    Raises
    ------
    RuntimeError
        They differ by more than the tolerance.

    """
    difference = float(np.max(np.abs(np.asarray(ours) - np.asarray(theirs))))
    if not difference <= tolerance:
        raise RuntimeError(f'{what}: ours and the peer differ by {difference:.3g}, more than '
                           f'{tolerance:.3g}: the times would mean nothing')


def _seconds(contestant: Contestant) -> tuple[float, float]:
    """Return wall and processor time of one run [s]."""
    run = contestant()
    gc.collect()
    gc.disable()
    try:
        processor, wall = time.process_time(), time.perf_counter()
        run()
        return time.perf_counter() - wall, time.process_time() - processor
    finally:
        gc.enable()
