# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read measured logs: rows of numbers in a text file, derivatives estimated where missing."""

from array import array
import os
from pathlib import Path
import re
from typing import Literal, Protocol

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files.limits import plain_number, sha256_of, text_lines
from hnn_vi_ros.files.regular_file import no_file
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.learning.dataset import (
    Block, Dataset, Mass, mass_matrix, Names, time_blocks, UNEVENNESS)
from hnn_vi_ros.learning.derivatives import differentiate, SavitzkyGolay, SmoothingSpline
import numpy as np
from pydantic import Field, model_validator

MAX_BYTES = 256 << 20
MAX_VALUE = 1e100  # whose square is still a number
# Blocks of neighbouring rows in a trial whose derivatives come from one spline through all rows.
BLOCKS = 20

_COMMA = re.compile(r'[+-]?\d*,\d+(e[+-]?\d+)?', re.IGNORECASE)
_SEPARATORS = {'whitespace': None, 'comma': ',', 'semicolon': ';', 'tab': '\t'}


class Columns(Protocol):
    """Columns of a log, and how its rows are read."""

    columns: Names
    delimiter: str
    comment: str


class MeasuredData(StrictModel):
    """A measured log: a text file with one row of numbers for each instant."""

    kind: Literal['measured']
    path: str = Field('', max_length=4096, description='the log; --data FILE overrides it')
    source: str = Field('', max_length=1000, description=(
        'where the log comes from, for those who lack it'))
    delimiter: Literal['whitespace', 'comma', 'semicolon', 'tab'] = 'whitespace'
    comment: str = Field('#', min_length=1, description='prefix of lines to skip')
    columns: Names = Field(min_length=3, description='names of all columns, in order')
    trial: str | None = Field(None, description='column that numbers separate recordings')
    time: str = Field(description='column of time [s]')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    p: Names = Field(min_length=1, description='columns of the momenta, or of the velocities')
    mass: Mass | None = Field(None, description=(
        'p = mass * columns: one for each coordinate, or a matrix by rows; default 1'))
    dq_dt: Names | None = Field(None, description='columns of dq/dt, if the log has them')
    dp_dt: Names | None = Field(None, description='columns of dp/dt, if the log has them')
    derivatives: SavitzkyGolay | SmoothingSpline | None = Field(
        None, discriminator='kind', description='how missing derivatives are estimated')
    block: Block = None

    @model_validator(mode='after')
    def _check(self) -> 'MeasuredData':
        groups = {'q': self.q, 'p': self.p, 'dq_dt': self.dq_dt, 'dp_dt': self.dp_dt}
        for key, group in groups.items():
            if group is not None and len(group) != len(self.q):
                raise ValueError(f'{key} has {len(group)} entries, expected {len(self.q)}, '
                                 'one for each coordinate')
        mass_matrix(self.mass, len(self.q))
        used = [self.time, *self.q, *self.p, *(self.dq_dt or []), *(self.dp_dt or [])]
        used += [] if self.trial is None else [self.trial]
        for name in used:
            if self.columns.count(name) != 1 or used.count(name) != 1:
                raise ValueError(f'column {name} must stand once in columns and be used once')
        if self.derivatives is None and not (self.dq_dt and self.dp_dt):
            raise ValueError('derivatives is missing, since the log lacks dq_dt or dp_dt; '
                             'for example derivatives: {kind: savitzky_golay, window: 0.3}')
        return self


def read_measured_log(path: Path, data: MeasuredData) -> Dataset:
    """
    Read a log and estimate the derivatives that it lacks.

    Where a derivative is estimated, the value that belongs to it is replaced by the smoothed
    one, and rows too close to an end of their trial for a whole window are left out.

    Parameters
    ----------
    path : Path
        A text file of at most 256 MiB.
    data : MeasuredData
        Its columns and how to differentiate.

    Raises
    ------
    DataError
        The file is missing or a row cannot be used; names file, line, column and what is
        expected.

    """
    table, lines, digest = read_log(path, data)
    column = {name: table[:, i] for i, name in enumerate(data.columns)}
    trials = column[data.trial] if data.trial else np.zeros(len(table))
    parts, start = [], 0
    for number, trial in enumerate(np.unique(trials)):
        rows = np.flatnonzero(trials == trial)
        *arrays, block = _trial({name: values[rows] for name, values in column.items()},
                                data, path, lines[rows])
        parts.append((*arrays, block + start, np.full(len(block), number)))
        start += block.max(initial=0) + 1
    *states, t, block, trajectory = (np.concatenate(arrays) for arrays in zip(
        *parts, strict=True))
    description = f'{path.name} ({len(table)} rows, sha256 {digest[:16]})'
    return Dataset(*states, block, description, t, trajectory).checked()


def read_log(path: Path, data: Columns, lacking: bool = False
             ) -> tuple[np.ndarray, np.ndarray, str]:
    """
    Return the numbers of a log, the line of each row, and its SHA-256; or raise DataError.

    Parameters
    ----------
    path : Path
        A text file of at most 256 MiB.
    data : Columns
        How its rows are read.
    lacking : bool
        Whether a field that is empty or ``nan`` is a number that lacks.

    Returns
    -------
    np.ndarray, shape (N, columns), np.ndarray of int, shape (N,), and str
        What is told above.

    """
    if not os.path.isfile(path):
        raise DataError(f'{path}: {no_file(path, "no such data file")}; pass the log with '
                        '--data FILE')
    # As numbers, of eight bytes each: lists of lists would take ten times the log.
    numbers, lines = array('d'), array('q')
    try:
        for number, line in text_lines(path, MAX_BYTES):
            if row := _row(f'{path}:{number}', line, data, lacking, not lines):
                numbers.extend(row)
                lines.append(number)
        digest = sha256_of(path, MAX_BYTES)
    except OSError as problem:
        raise DataError(f'{path}: cannot be read: {problem.strerror}; give a smaller part of it, '
                        'or another log') from problem
    except ValueError as problem:
        raise DataError(f'{path}:{problem}; give a log of rows of numbers') from problem
    if len(lines) < 2:
        raise DataError(f'{path}: {len(lines)} rows of data, expected a longer log')
    return np.array(numbers).reshape(len(lines), -1), np.array(lines), digest


def _row(place: str, line: str, data: Columns, lacking: bool, first: bool) -> list[float]:
    """Return the numbers of a line; none of a comment, or of the header that may come first."""
    if not line.strip() or line.lstrip().startswith(data.comment):
        return []
    # No further than needed: a line may be as long as the file.
    fields = [field.strip() for field in line.split(
        _SEPARATORS[data.delimiter], len(data.columns) + 1)]
    if first and fields == data.columns:
        return []
    if len(fields) != len(data.columns):
        more = ' or more' * (len(fields) > len(data.columns) + 1)
        raise DataError(f'{place}: {len(fields)} columns{more}, expected '
                        f'{len(data.columns)}: {listed(data.columns)}')
    return [np.nan if lacking and field.lower() in ('', 'nan') else
            _number(place, i, field, name)
            for i, (field, name) in enumerate(zip(fields, data.columns, strict=True))]


def _number(place: str, index: int, field: str, name: str) -> float:
    value = plain_number(field)
    if not abs(value) <= MAX_VALUE:
        remedy = 'write decimals with a point' if _COMMA.fullmatch(field) else \
            'name the columns in data.columns, and in data.comment how lines to skip begin'
        raise DataError(f'{place}: column {index + 1} ({name}): expected a finite number, '
                        f'found {field[:40]!r}; {remedy}')
    return value


def _trial(column: dict[str, np.ndarray], data: MeasuredData, path: Path, lines: np.ndarray
           ) -> tuple[np.ndarray, ...]:
    """Return q, p, dq/dt, dp/dt, each (N, d), and time and block of each row, for one trial."""
    t = column[data.time]
    backward = np.flatnonzero(np.diff(t) <= 0.0)
    if backward.size:
        raise DataError(f'{path}:{lines[backward[0] + 1]}: column {data.time}: time must '
                        'increase from row to row; sort the rows, or name the column that '
                        'separates recordings in data.trial')
    mass = mass_matrix(data.mass, len(data.q))
    q = np.stack([column[name] for name in data.q], axis=-1)
    p = np.stack([column[name] for name in data.p], axis=-1) @ mass
    rates = [None if names is None else np.stack([column[name] for name in names], axis=-1)
             for names in (data.dq_dt, data.dp_dt)]
    if rates[0] is not None and rates[1] is not None:
        block = np.arange(len(t)) if data.block is None else time_blocks(t, data.block)
        return q, p, rates[0], rates[1], t, block
    window = _window(t, data.derivatives, path, lines)
    states = [q, p]
    for i, rate in enumerate(rates):
        if rate is None:
            try:
                states[i], rates[i] = differentiate(t, states[i], data.derivatives, window)
            except (ValueError, np.linalg.LinAlgError) as problem:
                raise DataError(f'{path}:{lines[0]}: the derivatives of this trial cannot be '
                                f'estimated ({problem}); look at its times and at '
                                'data.derivatives') from problem
    whole = slice(window // 2, len(t) - window // 2)
    block = np.arange(len(t)) // (window or max(len(t) // BLOCKS, 1))
    if data.block is not None:
        block = time_blocks(t, data.block)
    return tuple(array[whole] for array in (*states, *rates, t, block))


def _window(t: np.ndarray, method: object, path: Path, lines: np.ndarray) -> int:
    """Return the window in rows, an odd number; 0 for a method without one."""
    if not isinstance(method, SavitzkyGolay):
        if len(t) < 5:
            raise DataError(f'{path}:{lines[0]}: {len(t)} rows in this trial, expected at least 5')
        return 0
    spacing = (t[-1] - t[0]) / max(len(t) - 1, 1)
    uneven = np.flatnonzero(np.abs(np.diff(t) - spacing) > UNEVENNESS * spacing)
    if uneven.size:
        at = uneven[0]
        raise DataError(f'{path}:{lines[at + 1]}: {t[at + 1] - t[at]:.6g} s after the row before, '
                        f'but {spacing:.6g} s on average; use derivatives: '
                        '{kind: smoothing_spline}, or data.trial to separate recordings')
    window = 2 * round(0.5 * (min(method.window / spacing, 1e9) - 1.0)) + 1
    if not method.degree + 2 <= window <= len(t) - 1:
        raise DataError(f'{path}:{lines[0]}: derivatives.window of {method.window:g} s holds '
                        f'{window} of the {len(t)} rows of this trial, expected '
                        f'{method.degree + 2} to {len(t) - 1}')
    return window
