# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of a sweep: the values of its keys at any place of an axis, by the place alone."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from hashlib import sha256
from math import prod
import os
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.regular_file import regular
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.sweeps.definition import (
    AxisChoice, BoxChoice, FileChoice, GridChoice, MOST, PosteriorChoice, RepeatsChoice,
    SobolChoice, ValuesChoice)
from hnn_vi_ros.sweeps.posterior import read_posterior
import numpy as np

# What is drawn for so many places has one seed: as many random states as places take long.
_DRAWN = 32
_LARGEST_FILE = 2**28
_MOST_KEYS = 50_000
# Values of a key.
Column = Sequence[Any] | np.ndarray


class Axis(ABC):
    """
    Something that varies.

    Attributes
    ----------
    keys : list of str
        Keys of the scene.
    count : int
        How many places it has.

    """

    keys: list[str]
    count: int

    @property
    def types(self) -> list[type]:
        """Return the type of the values of each key; str for what is of several, as JSON."""
        return [float] * len(self.keys)

    @abstractmethod
    def values(self, places: np.ndarray) -> list[Column]:
        """
        Return the values of each key at some places.

        Parameters
        ----------
        places : np.ndarray of int, shape (n,)
            From 0 to the count; rising.

        Returns
        -------
        list of Column, of length n each
            In the order of the keys.

        """


class ValuesAxis(Axis):
    """See ValuesChoice."""

    def __init__(self, axis: ValuesChoice):
        self.keys, self.count, self._values = [axis.key], len(axis.values), axis.values

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        return [[self._values[place] for place in places]]

    @property
    def types(self) -> list[type]:
        """See Axis."""
        kinds = {type(value) for value in self._values}
        if kinds == {int, float}:
            return [float]
        return [kinds.pop() if len(kinds) == 1 and list not in kinds else str]


class GridAxis(Axis):
    """See GridChoice; the last key is the fastest."""

    def __init__(self, axis: GridChoice):
        self.keys, self.count, self._shape = axis.keys, prod(axis.counts), tuple(axis.counts)
        self._bounds = list(zip(axis.low, axis.high, strict=True))

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        along = np.unravel_index(places, self._shape)
        return [low + (high - low) * (k / max(count - 1, 1)) for (low, high), k, count in zip(
            self._bounds, along, self._shape, strict=True)]


class BoxAxis(Axis):
    """See BoxChoice."""

    def __init__(self, axis: BoxChoice, entropy: int, number: int):
        self.keys, self.count = axis.keys, axis.count
        self._low, self._high = np.array(axis.low), np.array(axis.high)
        self._seed = entropy, number

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        shares = _drawn(places, self, self._seed, lambda rng: rng.random((_DRAWN, len(self.keys))))
        return list((self._low + (self._high - self._low) * shares).T)


def _drawn(places: np.ndarray, axis: 'BoxAxis | PosteriorAxis', seed: tuple[int, int],
           draw: Callable[[np.random.Generator], np.ndarray]) -> np.ndarray:
    """Return what is drawn for each place: _DRAWN rows have a seed of their own."""
    rows, (entropy, number) = np.empty((len(places), len(axis.keys))), seed
    for block in np.unique(places // _DRAWN):
        seeds = np.random.SeedSequence(entropy, spawn_key=(number, int(block)))
        own = places // _DRAWN == block
        rows[own] = draw(np.random.default_rng(seeds))[places[own] % _DRAWN]
    return rows


class PosteriorAxis(Axis):
    """See PosteriorChoice."""

    def __init__(self, axis: PosteriorChoice, entropy: int, number: int, folder: Path, place: str):
        posterior = read_posterior(folder / axis.path, place, axis.keys)
        self.keys, self.count, self.digest = posterior.keys, axis.count, posterior.digest
        self._mean, self._root, self._seed = posterior.mean, posterior.root, (entropy, number)

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        normal = _drawn(places, self, self._seed, lambda rng: rng.standard_normal(
            (_DRAWN, len(self.keys))))
        # Term by term: in a matrix product the order of a sum depends on how many rows there are.
        drawn = np.tile(self._mean, (len(places), 1))
        for k, column in enumerate(self._root.T):
            drawn += normal[:, k, None] * column
        return list(drawn.T)


class SobolAxis(Axis):
    """See SobolChoice."""

    def __init__(self, axis: SobolChoice, entropy: int, number: int):
        self.keys, self.count = axis.keys, axis.count
        self._low, self._high = np.array(axis.low), np.array(axis.high)
        self._entropy, self._number = entropy, number

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        # Imported here: it takes half a second, which other sweeps need not wait.
        from scipy.stats import qmc
        wanted, back = np.unique(places, return_inverse=True)
        parts = []
        for run in np.split(wanted, np.flatnonzero(np.diff(wanted) > 1) + 1):
            seeds = np.random.SeedSequence(self._entropy, spawn_key=(self._number,))
            # Of 2^30 points; named as in all versions of scipy.
            points = qmc.Sobol(len(self.keys), scramble=True, seed=np.random.default_rng(seeds))
            if run[0]:
                points.fast_forward(int(run[0]))
            # One by one: only of a first draw of another length than a power of two it warns.
            first = points.random(1)
            parts += [first, points.random(len(run) - 1)] if len(run) > 1 else [first]
        shares = np.vstack(parts)[back]
        return list((self._low + (self._high - self._low) * shares).T)


class FileAxis(Axis):
    """See FileChoice."""

    def __init__(self, axis: FileChoice, folder: Path, place: str):
        path = folder / axis.path
        try:
            if os.path.getsize(path) > _LARGEST_FILE:
                raise DataError(f'{place}: {path} is larger than {_LARGEST_FILE} bytes; cut it '
                                'into several sweeps')
            raw = regular(path).read_bytes()
            text = raw.decode('utf-8')
        except (OSError, UnicodeDecodeError) as problem:
            raise DataError(f'{place}: {path}: {one_line(problem)}') from problem
        head, *lines = text.splitlines() if text else ['']
        lines = [line for line in lines if line.strip()]
        if not lines:
            raise DataError(f'{place}: {path} has no row of numbers; its first line names keys '
                            'of the scene, and each further one has a number for each')
        # Counted before they are split: a line may be as long as the file.
        keys, *counts = (line.count(',') + 1 for line in (head, *lines))
        if keys > _MOST_KEYS:
            raise DataError(f'{place}: {path}: its first line names {keys} keys, more than '
                            f'{_MOST_KEYS}, which no scene has')
        for number, count in enumerate(counts, 2):
            if count != keys:
                raise DataError(f'{place}: {path}: row {number} has {count} values, expected '
                                f'{keys}')
        self.keys = [name.strip() for name in head.split(',')]
        rows = [line.split(',') for line in lines]
        try:
            self._table = np.array(rows, dtype=np.float64)
        except ValueError as problem:
            raise DataError(f'{place}: {path}: {one_line(problem)}') from problem
        bad = np.argwhere(~np.isfinite(self._table))
        if bad.size:
            raise DataError(f'{place}: {path}: row {bad[0, 0] + 2}, {self.keys[bad[0, 1]]}: '
                            f'{self._table[tuple(bad[0])]} is not finite')
        self.count, self.digest = len(rows), sha256(raw).hexdigest()

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        return list(self._table[places].T)


class RepeatsAxis(Axis):
    """See RepeatsChoice."""

    def __init__(self, axis: RepeatsChoice, entropy: int, number: int):
        self.keys, self.count = [] if axis.key is None else [axis.key], axis.count
        self._entropy, self._number = entropy, number

    def values(self, places: np.ndarray) -> list[Column]:
        """See Axis."""
        if not self.keys:
            return []
        return [[int(np.random.SeedSequence(
            self._entropy, spawn_key=(self._number, int(place))).generate_state(1)[0])
            for place in places]]

    @property
    def types(self) -> list[type]:
        """See Axis."""
        return [int] * len(self.keys)


def make_axis(axis: AxisChoice, entropy: int, number: int, folder: Path, place: str) -> Axis:
    """
    Return what gives the values of an axis.

    Parameters
    ----------
    axis : AxisChoice
        As it is defined.
    entropy : int
        The seed of the sweep.
    number : int
        Of the axis, which has a stream of its own.
    folder : Path
        Where a file is looked for.
    place : str
        Where it is defined, for errors.

    Raises
    ------
    DataError
        A file that cannot be used, or too many places.

    """
    made: Axis
    match axis:
        case ValuesChoice():
            made = ValuesAxis(axis)
        case GridChoice():
            made = GridAxis(axis)
        case BoxChoice():
            made = BoxAxis(axis, entropy, number)
        case SobolChoice():
            made = SobolAxis(axis, entropy, number)
        case FileChoice():
            made = FileAxis(axis, folder, place)
        case PosteriorChoice():
            made = PosteriorAxis(axis, entropy, number, folder, place)
        case RepeatsChoice():
            made = RepeatsAxis(axis, entropy, number)
    if made.count > MOST:
        raise DataError(f'{place}: {made.count:.3g} points, more than {MOST}; take fewer')
    return made
