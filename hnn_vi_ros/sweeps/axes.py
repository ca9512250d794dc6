# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of a sweep: keys of a scene, and their values at any position of an axis."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
import math
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.files import (
    in_plain_words, one_line, parse_json, plain_number, read_limited, sha256_of, text_lines)
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.sweeps.definition import (
    AxisChoice, BoxChoice, FileChoice, GridChoice, MAX_COUNT, PosteriorChoice, RepeatsChoice,
    SobolChoice, ValuesChoice)
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

_MAX_POSTERIOR_SIZE = 2**25
# Tolerance for rounding errors of a covariance, relative to the standard deviations: for its
# asymmetry and for negative eigenvalues.
_COVARIANCE_TOLERANCE = 1e-8
_REMEDY = 'give a file that identify --posterior wrote'


class Posterior(NamedTuple):
    """
    Normal distribution of the values of some keys.

    Parameters
    ----------
    keys : list of str
        Keys of the scene.
    mean : np.ndarray, shape (n,)
        Identified values.
    root : np.ndarray, shape (n, n)
        Matrix R with R R^T equal to the covariance.
    digest : str
        Digest of the file.

    """

    keys: list[str]
    mean: np.ndarray
    root: np.ndarray
    digest: str


class _Parameter(BaseModel):
    model_config = ConfigDict(extra='ignore', strict=True, allow_inf_nan=False)
    value: float
    place: str | None = None


class _Covariance(BaseModel):
    model_config = ConfigDict(extra='forbid', strict=True, allow_inf_nan=False)
    names: list[str] = Field(min_length=1, max_length=1000)
    matrix: list[list[float]]


class _File(BaseModel):
    model_config = ConfigDict(extra='ignore')
    parameters: dict[str, _Parameter]
    covariance: _Covariance


def read_posterior(path: Path, place: str, keys: Mapping[str, str] | None = None) -> Posterior:
    """
    Read the result file of an identification.

    It is JSON: ``{"parameters": {NAME: {"value": ..., "place": KEY}}, "covariance": {"names":
    [NAME, ...], "matrix": [[...]]}}``; other content is ignored.

    Parameters
    ----------
    path : Path
        The file.
    place : str
        Place of the reference to the file, for error messages.
    keys : mapping of str to str, optional
        Key of the scene for each requested name; by default the place of each, or its name.

    Raises
    ------
    DataError
        The file cannot be read, or has the wrong content; one line.

    """
    where = f'{place}: {path}'
    try:
        raw = read_limited(path, _MAX_POSTERIOR_SIZE)
        found = _File.model_validate(parse_json(raw))
    except OSError as problem:
        raise DataError(f'{where}: {problem.strerror or problem}; {_REMEDY}') from problem
    except ValidationError as problem:
        raise DataError(f'{where}: {in_plain_words(problem)}; {_REMEDY}') from problem
    except ValueError as problem:
        raise DataError(f'{where}: {one_line(problem)}; {_REMEDY}') from problem
    names, n = found.covariance.names, len(found.covariance.names)
    if any(len(row) != n for row in found.covariance.matrix) or len(
            found.covariance.matrix) != n or len(set(names)) != n:
        raise DataError(f'{where}: covariance: {n} names need as many rows and columns, each name '
                        f'once; {_REMEDY}')
    wanted = dict(keys or {name: getattr(found.parameters.get(name), 'place', None) or name
                           for name in names})
    whole = [name for name in names if name in found.parameters]
    for name in wanted:
        if name not in whole:
            raise DataError(one_line(
                f'{where}: no {name!r} in its parameters and covariance'
                f'{did_you_mean(name, whole)}; both have: {listed(whole) or "nothing"}'))
    chosen = [names.index(name) for name in wanted]
    covariance = np.array(found.covariance.matrix)[np.ix_(chosen, chosen)]
    return Posterior([*wanted.values()],
                     np.array([found.parameters[name].value for name in wanted]),
                     _root(covariance, where), sha256(raw).hexdigest())


def _root(covariance: np.ndarray, where: str) -> np.ndarray:
    """Return R with R R^T equal to the covariance, which may be singular."""
    spread = np.sqrt(np.abs(np.diag(covariance)))
    units = np.where(spread > 0.0, spread, 1.0)
    correlation = covariance / units / units[:, None]
    if not np.abs(correlation - correlation.T).max() <= _COVARIANCE_TOLERANCE:
        raise DataError(f'{where}: covariance: the matrix is not symmetric; {_REMEDY}')
    squares, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    if not squares[0] >= -_COVARIANCE_TOLERANCE * len(squares):
        raise DataError(f'{where}: covariance: the matrix is not positive semidefinite; {_REMEDY}')
    # Eigenvectors are determined up to sign; fixing it makes draws the same everywhere.
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(squares))])
    return units[:, None] * vectors * signs * np.sqrt(np.maximum(squares, 0.0))


_STATE = 'initial_state'


def find_key(scene: Scene, key: str, names: Mapping[str, Sequence[str]], place: str
             ) -> tuple[str | int, ...]:
    """
    Return the path of a key, such as ``('effects', 0, 'rate')``.

    Parameters
    ----------
    scene : Scene
        Scene that contains the key.
    key : str
        Key with dots. In the initial state, names of coordinates are keys as well.
    names : mapping of sequence of str
        Column names of q and of p, under the keys 'q' and 'p'.
    place : str
        Place of the key, for error messages.

    Raises
    ------
    DataError
        The key does not exist; the message names the valid ones.

    """
    if scene.initial_state.v and key.startswith(f'{_STATE}.'):
        raise DataError(f'{place}: {key!r}: the scene starts at velocities v, which determine p; '
                        'vary the initial state of a scene with q and p')
    value: Any = scene.model_dump()
    parts: list[str | int] = []
    for part in key.split('.'):
        if isinstance(value, Mapping):
            valid = list(value)
        elif isinstance(value, list):
            valid = [str(k) for k in range(len(value))]
            own = names[str(parts[1])] if len(parts) == 2 and parts[0] == _STATE else []
            valid += own
        else:
            raise DataError(f'{place}: {key!r}: {".".join(map(str, parts))} is a value, which '
                            'has no further keys')
        if part not in valid:
            raise DataError(f'{place}: {key!r}: unknown key {part!r}'
                            f'{did_you_mean(part, valid)}; valid keys: {listed(valid) or "none"}')
        if isinstance(value, list):
            parts.append(own.index(part) if part in own else int(part))
        else:
            parts.append(part)
        value = value[parts[-1]]
    if parts[0] in ('description', 'mechanism', 'uncertainty'):
        raise DataError(f'{place}: {key!r} does not affect trajectories')
    return tuple(parts)


# Number of positions that share a seed: one random state per position would be slow.
_SEED_BLOCK = 32
_MAX_TABLE_SIZE = 2**28
# Values of a key.
Column = Sequence[Any] | np.ndarray
# Function that returns the seed sequence of some numbers, such as a position.
_Seeds = Callable[..., np.random.SeedSequence]


@dataclass(frozen=True, eq=False)
class Axis:
    """
    An axis of the sweep.

    Parameters
    ----------
    keys : list of str
        Keys of the scene.
    count : int
        Number of positions.
    values : callable
        Function of positions, an ascending int array of shape (n,) from 0 to the count; it returns
        n values of each key, in the order of the keys.
    kind : type
        Type of the values; str, for JSON, if there are several types.
    digest : str, optional
        Digest of the file the axis is read from.

    """

    keys: list[str]
    count: int
    values: Callable[[np.ndarray], list[Column]]
    kind: type = float
    digest: str | None = None


def _type_of(values: Sequence[Any]) -> type:
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return float
    return kinds.pop() if len(kinds) == 1 and list not in kinds else str


def _grid(axis: GridChoice, places: np.ndarray) -> list[Column]:
    """Return the values of a grid; the last key varies fastest."""
    along = np.unravel_index(places, axis.counts)
    return [low + (high - low) * (k / max(count - 1, 1)) for low, high, k, count in zip(
        axis.low, axis.high, along, axis.counts, strict=True)]


def _in_box(axis: BoxChoice | SobolChoice, shares: np.ndarray) -> list[Column]:
    """Map points of the unit cube, shape (n, keys), to a box."""
    low, high = np.array(axis.low), np.array(axis.high)
    return list((low + (high - low) * shares).T)


def _draw_rows(places: np.ndarray, keys: int, seeds: _Seeds,
               draw: Callable[[np.random.Generator, tuple[int, int]], np.ndarray]) -> np.ndarray:
    """Return a row of draws for each position; each block of _SEED_BLOCK rows has its own seed."""
    rows = np.empty((len(places), keys))
    for block in np.unique(places // _SEED_BLOCK):
        own = places // _SEED_BLOCK == block
        rng = np.random.default_rng(seeds(int(block)))
        rows[own] = draw(rng, (_SEED_BLOCK, keys))[places[own] % _SEED_BLOCK]
    return rows


def _sobol(places: np.ndarray, keys: int, seeds: _Seeds) -> np.ndarray:
    # Imported lazily: it takes half a second, and other sweeps do not need it.
    from scipy.stats import qmc
    wanted, back = np.unique(places, return_inverse=True)
    parts = []
    for run in np.split(wanted, np.flatnonzero(np.diff(wanted) > 1) + 1):
        # The sequence has 2^30 points; all versions of scipy accept the argument `seed`.
        points = qmc.Sobol(keys, scramble=True, seed=np.random.default_rng(seeds()))
        if run[0]:
            points.fast_forward(int(run[0]))
        # First a single point: scipy warns if the length of the first draw is not a power of two.
        first = points.random(1)
        parts += [first, points.random(len(run) - 1)] if len(run) > 1 else [first]
    return np.vstack(parts)[back]


def _posterior(axis: PosteriorChoice, seeds: _Seeds, path: Path, place: str) -> Axis:
    found = read_posterior(path, place, axis.keys)

    def values(places: np.ndarray) -> list[Column]:
        normal = _draw_rows(places, len(found.keys), seeds, np.random.Generator.standard_normal)
        # Sum term by term: in a matrix product the summation order depends on the number of rows.
        drawn = np.tile(found.mean, (len(places), 1))
        for k, column in enumerate(found.root.T):
            drawn += normal[:, k, None] * column
        return list(drawn.T)
    return Axis(found.keys, axis.count, values, digest=found.digest)


def file_axis(path: Path, place: str) -> Axis:
    """
    Return an axis from the rows of a table of numbers.

    Parameters
    ----------
    path : Path
        The file.
    place : str
        Place of the reference to the file, for error messages.

    Raises
    ------
    DataError
        The file cannot be read, or is not a table; one line.

    """
    # Stored compactly as 8-byte numbers.
    numbers, keys, rows = array('d'), list[str](), 0
    try:
        for line, text in text_lines(path, _MAX_TABLE_SIZE):
            if not keys:
                keys = [name.strip() for name in text.split(',')]
            elif text.strip():
                numbers.extend(_row(f'{path}:{line}', text, keys))
                rows += 1
        digest = sha256_of(path, _MAX_TABLE_SIZE)
    except OSError as problem:
        raise DataError(f'{place}: {path}: {problem.strerror or problem}; give a table of '
                        'numbers, or split it into several sweeps') from problem
    except ValueError as problem:
        raise DataError(f'{place}: {path}:{problem}') from problem
    except DataError as problem:
        raise DataError(f'{place}: {problem}') from problem
    if not rows:
        raise DataError(f'{place}: {path} has no row of numbers; its first line must name keys of '
                        'the scene, and each further line contain a number per key')
    table = np.array(numbers).reshape(rows, -1)
    return Axis(keys, rows, lambda places: list(table[places].T), digest=digest)


def _row(place: str, line: str, keys: Sequence[str]) -> list[float]:
    words = line.split(',')
    if len(words) != len(keys):
        raise DataError(f'{place}: {len(words)} values, expected {len(keys)}')
    row = []
    for key, word in zip(keys, words, strict=True):
        row.append(plain_number(word))
        if not math.isfinite(row[-1]):
            raise DataError(f'{place}: {one_line(key)}: {word.strip()[:40]!r} is not a finite '
                            'number')
    return row


def make_axis(axis: AxisChoice, entropy: int, number: int, folder: Path, place: str) -> Axis:
    """
    Return the axis of a definition.

    Parameters
    ----------
    axis : AxisChoice
        Definition of the axis.
    entropy : int
        Seed of the sweep.
    number : int
        Number of the axis, which selects its random stream.
    folder : Path
        Folder file paths are relative to.
    place : str
        Place of the definition, for error messages.

    Raises
    ------
    DataError
        A file cannot be used, or the axis has too many positions.

    """
    def seeds(*numbers: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(entropy, spawn_key=(number, *numbers))

    match axis:
        case ValuesChoice(key=key, values=values):
            made = Axis([key], len(values), lambda places: [[values[k] for k in places]],
                        _type_of(values))
        case GridChoice():
            made = Axis(axis.keys, math.prod(axis.counts), partial(_grid, axis))
        case BoxChoice(keys=keys):
            made = Axis(keys, axis.count, lambda places: _in_box(axis, _draw_rows(
                places, len(keys), seeds, np.random.Generator.random)))
        case SobolChoice(keys=keys):
            made = Axis(keys, axis.count, lambda places: _in_box(axis, _sobol(
                places, len(keys), seeds)))
        case FileChoice():
            made = file_axis(folder / axis.path, place)
        case PosteriorChoice():
            made = _posterior(axis, seeds, folder / axis.path, place)
        case RepeatsChoice(key=None):
            made = Axis([], axis.count, lambda places: [])
        case RepeatsChoice(key=str(key)):
            made = Axis([key], axis.count, lambda places: [[
                int(seeds(int(k)).generate_state(1)[0]) for k in places]], int)
    if made.count > MAX_COUNT:
        raise DataError(f'{place}: {made.count:.3g} points, more than {MAX_COUNT}; use fewer')
    return made
