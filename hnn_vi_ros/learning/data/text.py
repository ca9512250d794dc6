# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read motions from text files with one row of numbers per sample."""

from array import array
import os
from pathlib import Path
import re
from typing import Any, ClassVar, Literal

from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.files import no_file, plain_number, sha256_of, StrictModel, text_lines
from hnn_vi_ros.learning.data.dataset import (
    Derivatives, mass_matrix, Names, StateOptions, time_blocks)
from hnn_vi_ros.learning.data.motions import Motion, MotionData, Recording
from hnn_vi_ros.phase_space import IN_DEGREES
import numpy as np
from pydantic import Field, model_validator

MAX_BYTES = 256 << 20
MAX_VALUE = 1e100  # its square is still finite
# Maximum number of columns of a header.
_MOST_COLUMNS = 1000
# Number of blocks of neighbouring rows in a trial differentiated with one spline.
BLOCKS = 20

_DATE = re.compile(r'\d+[-/:.]\d+[-/:.]\d.*')
_COMMA = re.compile(r'[+-]?\d*,\d+(e[+-]?\d+)?', re.IGNORECASE)
# Whitespace comes last because it also splits at the space after a comma.
_SEPARATORS = {'comma': ',', 'semicolon': ';', 'tab': '\t', 'whitespace': None}
_OTHER_TIME = re.compile(
    r'(?<![a-z])([mun]s(ecs?)?|µs|(milli|micro|nano)s\w*|min(utes)?)(?![a-z])', re.IGNORECASE)


class LogColumns(StrictModel):
    """Columns of a log, a text file with one row of numbers per sample."""

    # Configuration key of the columns of each channel of a motion.
    keys: ClassVar[dict[str, str]]

    path: str = Field('', max_length=4096, description='the log; --data FILE overrides it')
    delimiter: Literal['whitespace', 'comma', 'semicolon', 'tab'] | None = Field(
        None, description='default: the one that splits the first line into the columns')
    comment: str = Field('#', min_length=1, description='prefix of lines to skip')
    columns: Names | None = Field(None, min_length=2, description=(
        'names of all columns, in order; default: those in the first line of the log'))
    trial: str | None = Field(None, description='column that numbers separate recordings')
    time: str = Field(description='column of time [s]')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    degrees: Names | None = Field(None, description=(
        'columns of angles and their rates in degrees, which are converted to radians'))

    @property
    def channels(self) -> dict[str, Names]:
        """Return the names of the columns of each channel of a motion."""
        return {channel: group for channel, key in self.keys.items()
                if (group := getattr(self, key)) is not None}

    @property
    def used(self) -> list[str]:
        """Return the names of the columns in use."""
        return [self.time, *([] if self.trial is None else [self.trial]),
                *(name for group in self.channels.values() for name in group)]

    def check_columns(self) -> None:
        """Raise ValueError for a missing column or one that is used twice."""
        for name in self.used:
            if (self.columns or [name]).count(name) != 1 or self.used.count(name) != 1:
                raise ValueError(f'column {name} must stand once in columns and be used once')
        for name in self.degrees or ():
            if name not in self.used:
                raise ValueError(f'degrees: column {name} is not used'
                                 f'{did_you_mean(name, self.used)}; valid: {listed(self.used)}')


class MeasuredData(LogColumns, StateOptions):
    """States of a log with one or several recordings, and their rates."""

    keys = {'q': 'q', 'p': 'p', 'v': 'dq_dt', 'dp_dt': 'dp_dt'}

    kind: Literal['measured']
    source: str = Field('', max_length=1000, description=(
        'where the log comes from, for those who lack it'))
    p: Names = Field(min_length=1, description='columns of the momenta, or of the velocities')
    dq_dt: Names | None = Field(None, description='columns of dq/dt, if the log has them')
    dp_dt: Names | None = Field(None, description='columns of dp/dt, if the log has them')

    @model_validator(mode='after')
    def _check(self) -> 'MeasuredData':
        groups = {'q': self.q, 'p': self.p, 'dq_dt': self.dq_dt, 'dp_dt': self.dp_dt}
        for key, group in groups.items():
            if group is not None and len(group) != len(self.q):
                raise ValueError(f'{key} has {len(group)} entries, expected {len(self.q)}, '
                                 'one for each coordinate')
        mass_matrix(self.mass, len(self.q))
        self.check_columns()
        if self.derivatives is None and not (self.dq_dt and self.dp_dt):
            raise ValueError('derivatives is missing, since the log lacks dq_dt or dp_dt; '
                             'for example derivatives: {kind: savitzky_golay, window: 0.3}')
        return self

    @property
    def least(self) -> int:
        """Return the minimum number of rows: 5 for a spline, 1 if rates are measured."""
        return 1 if self.method(1.0) is None else 5

    def method(self, spacing: float) -> Derivatives | None:
        """Return the differentiation method; None if the log has both rates."""
        return None if self.dq_dt and self.dp_dt else self.derivatives

    def blocks(self, t: np.ndarray, window: int) -> np.ndarray:
        """Return blocks of one window each, or of one row if no rate is estimated."""
        if self.block is not None:
            return time_blocks(t, self.block)
        spline = 1 if self.method(1.0) is None else max(len(t) // BLOCKS, 1)
        return np.arange(len(t)) // (window or spline)


class LogMotions(LogColumns, MotionData):
    """Motions of a log with one run, or several numbered by a column."""

    keys = {'q': 'q', 'v': 'v', 'a': 'a', 'tau': 'tau'}

    kind: Literal['log'] = 'log'
    v: Names | None = Field(None, description=(
        'columns of dq/dt; none: they are estimated from q'))
    a: Names | None = Field(None, description=(
        'columns of the accelerations; none: they are estimated'))
    tau: Names | None = Field(None, description='columns of the forces of the motors; none: none')

    @model_validator(mode='after')
    def _check(self) -> 'LogMotions':
        for key in ('v', 'a', 'tau'):
            group = getattr(self, key)
            # There may be fewer motors than joints.
            if group is not None and (len(group) > len(self.q) or (
                    key != 'tau' and len(group) < len(self.q))):
                raise ValueError(f'{key} has {len(group)} columns, q has {len(self.q)}')
        self.check_columns()
        return self


def read_text(path: Path, data: LogColumns) -> Recording:
    """
    Read the motions of a log, one per recording.

    Parameters
    ----------
    path : Path
        Text file of at most 256 MiB; an empty field or ``nan`` is a missing number.
    data : LogColumns
        Columns of the log.

    Raises
    ------
    DataError
        The file or a row cannot be read; the message names file and line.

    """
    table, lines, digest, names = read_log(path, data)
    column = dict(zip(names, table.T, strict=True))
    _check_units(path, data)
    column |= {name: np.radians(column[name]) for name in data.degrees or ()}
    numbers = column[data.trial] if data.trial else np.zeros(len(table))
    unnumbered = np.flatnonzero(~np.isfinite(numbers))
    if unnumbered.size:
        raise DataError(f'{path}:{lines[unnumbered[0]]}: column {data.trial}: no number, which '
                        'tells the run; give one, or leave the row out')
    channels: dict[str, Any] = {name: np.stack([column[one] for one in group], axis=-1)
                                for name, group in data.channels.items()}
    if 'p' in channels:
        channels['p'] = channels['p'] @ mass_matrix(getattr(data, 'mass', None), len(data.q))
    motions = []
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero(numbers == number)
        name = f'{number:.15g}' if data.trial else path.stem
        motions.append(Motion(name, f'{path}: {name}', column[data.time][rows], **{
            key: values[rows] for key, values in channels.items()}))
    return Recording(motions, path.name, digest[:16])


def _check_units(path: Path, data: LogColumns) -> None:
    """Raise DataError for times not in seconds, or degrees without data.degrees."""
    if _OTHER_TIME.search(data.time):
        raise DataError(f'{path}: column {data.time!r}: times must be in seconds; convert the '
                        'column, or rename it if it is in s')
    found = [name for name in data.used if IN_DEGREES.search(name)]
    if found and data.degrees is None:
        raise DataError(f'{path}: degrees in {listed(found)}; to convert them to radians, add '
                        f'data.degrees: {found}, or data.degrees: [] if they are radians')


def read_log(path: Path, data: LogColumns) -> tuple[np.ndarray, np.ndarray, str, Names]:
    """
    Return the numbers of a log, the line of each row, its SHA-256 and its columns, or DataError.

    Parameters
    ----------
    path : Path
        Text file of at most 256 MiB.
    data : LogColumns
        Format of its rows.

    Returns
    -------
    np.ndarray, shape (N, columns), np.ndarray of int, shape (N,), str, and list of str
        Numbers, lines, SHA-256, columns.

    """
    if not os.path.isfile(path):
        raise DataError(f'{path}: {no_file(path, "no such data file")}; pass the log with '
                        '--data FILE')
    # Stored as 8-byte numbers: lists of lists would take ten times the size of the log.
    numbers, lines, names = array('d'), array('q'), data.columns
    try:
        for number, line in text_lines(path, MAX_BYTES):
            if not line.strip() or line.lstrip().startswith(data.comment):
                continue
            data = _delimited(line, data)
            if names is None:
                names = _header(f'{path}:{number}', line, data)
            elif row := _row(f'{path}:{number}', line, data, names, not lines):
                numbers.extend(row)
                lines.append(number)
        digest = sha256_of(path, MAX_BYTES)
    except OSError as problem:
        raise DataError(f'{path}: cannot be read: {problem.strerror}; give a smaller part of it, '
                        'or another log') from problem
    except ValueError as problem:
        raise DataError(f'{path}:{problem}; give a log of rows of numbers, in UTF-8') from problem
    if names is None or len(lines) < 2:
        raise DataError(f'{path}: {len(lines)} rows of data, expected a longer log')
    return np.array(numbers).reshape(len(lines), -1), np.array(lines), digest, names


def _fields(line: str, data: LogColumns, most: int) -> list[str]:
    # Limit the splits: a line may be as long as the file.
    mark = _SEPARATORS[data.delimiter or 'whitespace']
    return [field.strip().strip('"') for field in line.split(mark, most)]


def _delimited(line: str, data: LogColumns, given: bool = True) -> LogColumns:
    """Return `data` with its delimiter, or the one that fits the first line best."""
    if data.delimiter and given:
        return data
    ways = [data.model_copy(update={'delimiter': delimiter}) for delimiter in _SEPARATORS]
    fields = [_fields(line, way, _MOST_COLUMNS) for way in ways]
    # If no delimiter yields all names, take the one that yields most of their letters; on a tie
    # the first, because splitting 't , x' at spaces makes fields of commas too.
    scores = [len(found) == len(data.columns) if data.columns else
              sum(map(len, {*data.used} & {*found})) for found in fields]
    if not any(scores):
        scores = [*map(len, fields)]
    return ways[scores.index(max(scores))]


def _header(place: str, line: str, data: LogColumns) -> Names:
    """Return the names in the first line of a log; it must contain all that are used."""
    names = _fields(line, data, _MOST_COLUMNS)
    other = _delimited(line, data, given=False)
    for name in data.used:
        if names.count(name) != 1:
            problem = 'more than one column' if name in names else 'no column'
            raise DataError(
                f'{place}: {problem} {name!r}{did_you_mean(name, names)} in the header: '
                f'{listed(names)}; ' + (
                    f'set data.delimiter: {other.delimiter}' if other.delimiter != data.delimiter
                    else 'name the columns in data.columns, or set data.delimiter'))
    return names


def _row(place: str, line: str, data: LogColumns, names: Names, first: bool) -> list[float]:
    """Return the numbers of a line, or [] if it is an optional header."""
    fields = _fields(line, data, len(names) + 1)
    if first and fields == names:
        return []
    if len(fields) != len(names):
        more = ' or more' * (len(fields) > len(names) + 1)
        raise DataError(f'{place}: {len(fields)} columns{more}, expected '
                        f'{len(names)}: {listed(names)}')
    # If the header was read from the file, unused columns may hold anything.
    known = names if data.columns is not None else data.used
    return [np.nan if field.lower() in ('', 'nan') or name not in known else
            _number(place, i, field, name)
            for i, (field, name) in enumerate(zip(fields, names, strict=True))]


def _number(place: str, index: int, field: str, name: str) -> float:
    value = plain_number(field)
    if not abs(value) <= MAX_VALUE:
        remedy = ('leave such a row out; of a header, name the columns in data.columns, or in '
                  'data.comment how it begins')
        if _COMMA.fullmatch(field):
            remedy = 'write decimals with a point'
        elif _DATE.fullmatch(field):
            remedy = 'write times as seconds from the start'
        raise DataError(f'{place}: column {index + 1} ({name}): expected a finite number, '
                        f'found {field[:40]!r}; {remedy}')
    return value
