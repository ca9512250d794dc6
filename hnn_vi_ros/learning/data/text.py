# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read motions from text files with one row of numbers per sample."""

from array import array
import codecs
from collections.abc import Sequence
from contextlib import suppress
import csv
from itertools import islice
import os
from pathlib import Path
import re
from typing import Any, ClassVar, Literal, NamedTuple

from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.files import (
    limited, LONGEST_LINE, no_file, plain_number, sha256_of, StrictModel, text_lines)
from hnn_vi_ros.learning.data.dataset import (
    Derivatives, mass_matrix, Names, StateOptions, time_blocks)
from hnn_vi_ros.learning.data.faults import times_text
from hnn_vi_ros.learning.data.motions import Motion, MotionData, Recording
from hnn_vi_ros.learning.data.units import conversion, parsed, split_unit
import numpy as np
from pydantic import Field, model_validator

MAX_BYTES = 256 << 20
MAX_VALUE = 1e100  # its square is still finite
# Maximum number of columns, and length of a line with quoted fields.
_MOST_COLUMNS, _MOST_QUOTED = 1000, 100_000
# Maximum number of lines before the first row of numbers, and of rows that show the delimiter.
_MOST_HEAD, _ROWS = 200, 10
# Number of blocks of neighbouring rows in a trial differentiated with one spline.
BLOCKS = 20

# Names of columns without a header.
COLUMN = 'column {}'

# Nanoseconds of a stamp of ROS, such as header.stamp.nanosec.
_NANOSECONDS = re.compile(r'(|.*[^a-z])(?:nanosec|nsec)s?', re.IGNORECASE)
_DATE = re.compile(r'\d+[-/:.]\d+[-/:.]\d.*')
_COMMA = re.compile(r'[+-]?\d*,\d+(e[+-]?\d+)?', re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d*)?")
# Whitespace comes last because it also splits at the space after a comma.
_SEPARATORS: dict[str, str | None] = {
    'comma': ',', 'semicolon': ';', 'tab': '\t', 'whitespace': None}
_MISSING = frozenset({'', 'nan', '-nan', 'na', 'n/a', '#n/a', 'null', 'none', '-', '--', '?'})
# Values with which loggers say that there is none: nines, and the ends of integers.
_SENTINELS = np.array([*(sign * (10.0**k - 1.0) for k in (3, 4, 5, 6) for sign in (1.0, -1.0)),
                       -999.25, 32767.0, -32768.0, 65535.0, 2.0**31 - 1.0, -2.0**31, 2.0**32 - 1.0,
                       *(sign * 10.0**k for k in (30, 36, 37, 38) for sign in (1.0, -1.0))])


class LogFormat(StrictModel):
    """Format of a log, a text file with one row of numbers per sample."""

    path: str = Field('', max_length=4096, description='log file; --data FILE overrides it')
    delimiter: Literal['whitespace', 'comma', 'semicolon', 'tab'] | None = Field(
        None, description='delimiter; default: the one that splits the rows into most numbers')
    comment: str = Field('#', min_length=1, description=(
        'prefix of comment lines, which are skipped'))
    columns: Names | None = Field(None, min_length=2, description=(
        'names of all columns, in order; default: those in the header of the log'))

    @property
    def used(self) -> list[str]:
        """Return the names of the columns in use; empty for all that there are."""
        return []


class LogColumns(LogFormat):
    """
    Columns of a log; units in their names, such as ``x [mm]`` or ``theta_deg``, are converted.

    The units are s, rad and those of the coordinates; a unit of something else is refused.
    """

    # Configuration key of the columns of each channel of a motion.
    keys: ClassVar[dict[str, str]]

    trial: str | None = Field(None, description='column with the number of the recording')
    time: str = Field(description='column of the times')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    degrees: Names | None = Field(None, description=(
        'columns of angles and their rates in degrees; default: those whose names say so'))

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
                raise ValueError(f'column {name} must be listed once in columns and used once')
        for name in self.degrees or ():
            if name not in self.used:
                raise ValueError(f'degrees: column {name} is not used'
                                 f'{did_you_mean(name, self.used)}; valid: {listed(self.used)}')


class MeasuredData(LogColumns, StateOptions):
    """States of a log with one or several recordings, and their rates."""

    keys = {'q': 'q', 'p': 'p', 'v': 'dq_dt', 'dp_dt': 'dp_dt'}

    kind: Literal['measured']
    source: str = Field('', max_length=1000, description=(
        'origin of the log, for users who need to get it'))
    p: Names | None = Field(None, min_length=1, description=(
        'columns of the momenta, or of the velocities; none: mass times dq/dt'))
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
        if self.derivatives is None and not (self.p and self.dq_dt and self.dp_dt):
            raise ValueError('derivatives is missing but required, since the log lacks p, dq_dt '
                             'or dp_dt; for example derivatives: {kind: savitzky_golay, '
                             'window: 0.3}')
        return self

    @property
    def least(self) -> int:
        """Return the minimum number of rows: 5 for a spline, 1 if rates are measured."""
        return 1 if self.method(1.0) is None else 5

    def method(self, spacing: float) -> Derivatives | None:
        """Return the differentiation method; None if the log has momenta and both rates."""
        return None if self.p and self.dq_dt and self.dp_dt else self.derivatives

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
        'columns of dq/dt; none: estimated from q'))
    a: Names | None = Field(None, description=(
        'columns of the accelerations; none: estimated'))
    tau: Names | None = Field(None, description='columns of the motor forces; none: no forces')

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


def read_text(path: Path, data: LogColumns, units: Sequence[str] = ()) -> Recording:
    """
    Read the motions of a log, one per recording.

    Parameters
    ----------
    path : Path
        Text file of at most 256 MiB; an empty field or ``nan`` is a missing number.
    data : LogColumns
        Columns of the log.
    units : sequence of str
        Units of the coordinates; without them lengths keep the unit that they have.

    Raises
    ------
    DataError
        The file or a row cannot be read; the message names file and line.

    """
    table = read_log(path, data)
    column = dict(zip(table.names, table.numbers.T, strict=True))
    factors, notes = _factors(path, data, units), list(table.notes)
    t = factors.get(data.time, 1.0) * column[data.time]
    column |= {name: factors.get(name, 1.0) * lacking(column[name], t, name, notes)
               for name in data.used}
    numbers = column[data.trial] if data.trial else np.zeros(len(t))
    unnumbered = np.flatnonzero(~np.isfinite(numbers))
    if unnumbered.size:
        raise DataError(f'{path}:{table.lines[unnumbered[0]]}: column {data.trial}: the number '
                        'of the run is missing; add it, or remove the row')
    channels: dict[str, Any] = {name: np.stack([column[one] for one in group], axis=-1)
                                for name, group in data.channels.items()}
    if 'p' in channels:
        channels['p'] = channels['p'] @ mass_matrix(getattr(data, 'mass', None), len(data.q))
    motions = []
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero(numbers == number)
        name = f'{number:.15g}' if data.trial else path.stem
        motions.append(Motion(
            name, f'{path}: {name}', column[data.time][rows], notes=tuple(notes),
            **{key: values[rows] for key, values in channels.items()}))
    return Recording(motions, path.name, table.digest[:16])


def lacking(values: np.ndarray, t: np.ndarray, name: str, notes: list[str]) -> np.ndarray:
    """Return a column with NaN for each value that stands for none, which is far from others."""
    for value in np.unique(values[np.isin(values, _SENTINELS)]):
        others = values[np.isfinite(values) & ~np.isin(values, _SENTINELS)]
        if not others.size or (np.abs(others - value) > np.ptp(others)).all():
            found = np.flatnonzero(values == value)
            notes.append(f'{name} is {value:g} in {len(found)} samples{times_text(t[found])}')
            values = np.where(values == value, np.nan, values)
    return values


# Rates of the channels in q_unit; a momentum may be a velocity, and none need be what it says.
_RATES = {'q': '', 'v': '/s', 'a': '/s2', 'p': '/s', 'dp_dt': '/s2'}


def _factors(path: Path, data: LogColumns, units: Sequence[str]) -> dict[str, float]:
    """Return the conversion factors of the columns; DataError if units contradict."""
    factors = {data.time: _factor(path, data.time, 's')}
    for channel, names in data.channels.items():
        for k, name in enumerate(names):
            unit = split_unit(name)[1]
            known = parsed(unit)
            if known is None or channel == 'tau':
                factors[name] = 1.0 if known is None else known[0]
                continue
            angular = known[1] in ({}, {'s': -1}, {'s': -2})
            own = units[k] if units and parsed(units[k]) and units[k] != '1' else 'rad' * angular
            if not own or (angular and data.degrees is not None):
                factors[name] = 1.0
            elif channel in ('p', 'dp_dt'):
                factors[name] = conversion(unit, own + _RATES[channel]) or 1.0
            else:
                factors[name] = _factor(path, name, own + _RATES[channel])
    return factors | dict.fromkeys(data.degrees or (), np.pi / 180.0)


def _factor(path: Path, name: str, target: str) -> float:
    """Return the factor from the unit in a name to another, 1 if there is none."""
    unit = split_unit(name)[1]
    factor = conversion(unit, target)
    # One letter at the end of a name need not be a unit: q_m.
    if factor is None and (len(unit) > 1 or f'[{unit}]' in name or f'({unit})' in name):
        raise DataError(f'{path}: column {name!r} is in {unit}, but {target} is expected; correct '
                        'the header, or the q_unit of the coordinate')
    return factor or 1.0


class Table(NamedTuple):
    """
    Numbers of a log.

    Parameters
    ----------
    numbers : np.ndarray, shape (N, columns)
        Numbers; NaN where one is missing, or in unused columns.
    lines : np.ndarray of int, shape (N,)
        Line of each row.
    digest : str
        SHA-256 of the file.
    names : list of str
        Names of the columns.
    notes : list of str
        Notes for the model card.

    """

    numbers: np.ndarray
    lines: np.ndarray
    digest: str
    names: Names
    notes: list[str]


class Layout(NamedTuple):
    """Encoding and delimiter of a log, its columns, if known, and the line of its first row."""

    encoding: str
    delimiter: str | None
    names: Names | None
    width: int
    first: int


def read_log(path: Path, data: LogFormat) -> Table:
    """
    Read the numbers of a log.

    Parameters
    ----------
    path : Path
        Text file of at most 256 MiB.
    data : LogFormat
        Format of its rows; without named columns, all that hold numbers are read.

    Raises
    ------
    DataError
        The file or a row cannot be read; the message names file and line.

    """
    if not os.path.isfile(path):
        raise DataError(f'{path}: {no_file(path, "no such data file")}; pass the log with '
                        '--data FILE')
    try:
        layout = _layout(path, data)
        table = _read_rows(path, data, layout)
    except OSError as problem:
        raise DataError(f'{path}: cannot be read: {problem.strerror}; use a smaller part of it, '
                        'or another log') from problem
    except ValueError as problem:
        raise DataError(f'{path}:{problem}; give a log of rows of numbers') from problem
    if len(table.lines) < 2:
        raise DataError(f'{path}: {len(table.lines)} rows of data, expected a longer log')
    return table


def _read_rows(path: Path, data: LogFormat, layout: Layout) -> Table:
    # Stored as 8-byte numbers: lists of lists would take ten times the size of the log.
    numbers, lines, notes = array('d'), array('q'), list[str]()
    names = layout.names or [COLUMN.format(k + 1) for k in range(layout.width)]
    stamps = _stamps(names)
    reader = _Reader(path, names, [*(data.used or names), *stamps.values()], layout.delimiter,
                     strict=bool(data.used))
    whole, last, before, decimals = _ends_with_line_break(path), None, MAX_BYTES, 0
    # The last row is read when it is known to be the last: it may be truncated.
    for number, line in text_lines(path, MAX_BYTES, layout.encoding):
        if number < layout.first or not line.strip() or line.lstrip().startswith(data.comment):
            continue
        if last is not None:
            numbers.extend(reader.row(*last))
            lines.append(last[0])
            before = min(before, decimals)
        last, decimals = (number, line), 0 if whole else _decimals(line, layout.delimiter)
    if last is not None:
        try:
            row = reader.row(*last)
        except DataError:
            if whole or not lines:
                raise
            row = []
        if row and (whole or decimals >= before):
            numbers.extend(row)
            lines.append(last[0])
        else:
            notes.append(f'line {last[0]}, the last one, is truncated')
    table = np.array(numbers).reshape(len(lines), -1)
    for whole_seconds, parts in stamps.items():
        table[:, names.index(whole_seconds)] += 1e-9 * table[:, names.index(parts)]
    return Table(table, np.array(lines), sha256_of(path, MAX_BYTES), names, notes)


def _stamps(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of whole seconds of ROS stamps, and those of their nanoseconds."""
    return {name: part for name in names for part in names
            if (match := _NANOSECONDS.fullmatch(part)) and name.lower() in (
                f'{match[1]}sec'.lower(), f'{match[1]}secs'.lower())}


def _ends_with_line_break(path: Path) -> bool:
    with limited(path, MAX_BYTES) as stream:
        stream.seek(max(os.fstat(stream.fileno()).st_size - 2, 0))
        return stream.read().rstrip(b'\0')[-1:] in (b'\n', b'\r')  # UTF-16 has zeros after them


def _decimals(line: str, mark: str | None) -> int:
    """Return the number of decimals of the last number in a line."""
    return len(re.split('[.,]', line.rsplit(mark, 1)[-1] + '.', maxsplit=1)[1].rstrip('."'))


def _encoding(path: Path) -> str:
    """Return the encoding of a text file: UTF-8, or UTF-16 or cp1252 of other systems."""
    decoder = codecs.getincrementaldecoder('utf-8')()
    with limited(path, MAX_BYTES) as stream:
        part = stream.read(1 << 20)
        if part[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return 'utf-16'
        if b'\0' in part[:2]:
            return 'utf-16-be' if part[:1] == b'\0' else 'utf-16-le'
        try:
            while part:
                decoder.decode(part)
                part = stream.read(1 << 20)
        except UnicodeDecodeError:
            return 'cp1252'
    return 'utf-8-sig'


def _fields(line: str, mark: str | None) -> list[str]:
    # Limit the splits: a line may be as long as the file.
    fields = line.split(mark, _MOST_COLUMNS)
    if '"' in line and len(line) < _MOST_QUOTED:
        with suppress(csv.Error):
            fields = next(csv.reader([line.strip()] if mark is None else [line],
                                     delimiter=mark or ' ', skipinitialspace=True))
    return [field.strip().strip('"\'') for field in fields]


def _is_number(field: str) -> bool:
    return abs(plain_number(field)) <= MAX_VALUE or bool(_COMMA.fullmatch(field))


def _layout(path: Path, data: LogFormat) -> Layout:
    """Find out how a log is written, from its first lines."""
    encoding, head, size = _encoding(path), list[tuple[int, str]](), 0
    for number, line in islice(text_lines(path, MAX_BYTES, encoding), _MOST_HEAD):
        head += [(number, line)] * bool(line.strip())
        size += len(line)
        if size > LONGEST_LINE:
            break
    rows = [line for _, line in head if not line.lstrip().startswith(data.comment)][-_ROWS:]

    def split(line: str, mark: str | None) -> list[bool | None]:
        return [None if field.lower() in _MISSING else _is_number(field)
                for field in _fields(line, mark)]

    def score(name: str) -> tuple[bool, int, int]:
        found = [split(line, _SEPARATORS[name]) for line in rows]
        numbers = [sum(map(bool, row)) for row in found]
        return (sum(numbers) >= 2 * sum(map(bool, numbers)) > 0,
                -sum(row.count(False) for row in found), sum(numbers))
    best = max(_SEPARATORS, key=score)
    mark = _SEPARATORS[data.delimiter or best]
    sample = [row for line in rows if any(row := split(line, mark))]
    first = next((at for at, (_, line) in enumerate(head) if not line.lstrip().startswith(
        data.comment) and any(row := split(line, mark)) and (
            row[0] is not False or sample[-1][0] is False)), None)
    if first is None:
        split_by = f', split by {data.delimiter}; set data.delimiter: {best}' \
            if data.delimiter and score(best)[0] else ''
        raise DataError(f'{path}: no rows of numbers{split_by or "; give one for each sample"}')
    width = len(_trimmed(_fields(head[first][1], mark)))
    above = list[tuple[int, list[str]]]()
    for number, line in head[:first]:
        text = _uncommented(line, data.comment)
        # Programs write comments with spaces above rows with other delimiters.
        spaced = text != line.strip() and len(text.split()) == width
        above.append((number, text.split() if spaced else _fields(text, mark)))
    return Layout(encoding, mark, _header(path, data, above, width, mark), width,
                  head[first][0])


def _uncommented(line: str, comment: str) -> str:
    """Return a line without the prefix of a comment."""
    line = line.strip()
    return line.removeprefix(comment if line.startswith(comment) else '% ').strip()


def _trimmed(fields: list[str], least: int = 0) -> list[str]:
    """Return fields without empty ones at the end, which separators there make."""
    while len(fields) > least and not fields[-1]:
        fields = fields[:-1]
    return fields


def _header(path: Path, data: LogFormat, above: list[tuple[int, list[str]]], width: int,
            mark: str | None) -> Names | None:
    """Return the names of the columns, given the lines above the rows; None if there are none."""
    lines = [(number, names) for number, fields in above
             if len(names := _trimmed(fields)) >= max(2, width)
             or (mark == ',' and 2 * len(names) == width > 2)
             or (data.used and {*data.used} <= {*names})]
    units = lines[-1][1] if len(lines) > 1 and all(
        parsed(field.strip('[]()')) for field in lines[-1][1] if field) else []
    number, names = lines[-2 if units else -1] if lines else (1, [])
    if units:
        units += (len(names) - len(units)) * ['']
        names = [f'{name} [{unit.strip("[]()")}]' if unit and not split_unit(name)[1] else name
                 for name, unit in zip(names, units, strict=True)]
    if data.columns is not None:
        moved = [name for k, name in enumerate(names) if name in data.columns
                 and data.columns.index(name) != k and len(names) == len(data.columns)]
        if moved:
            raise DataError(f'{path}:{number}: data.columns has {moved[0]} at another place than '
                            f'the header: {listed(names)}; correct one of them')
        return data.columns
    for name in data.used:
        if names.count(name) == 1:
            continue
        if not names:
            raise DataError(f'{path}: has no header; name its columns in data.columns')
        if name in names:
            places = [str(k + 1) for k, other in enumerate(names) if other == name]
            raise DataError(f'{path}:{number}: columns {" and ".join(places)} are both called '
                            f'{name!r}; rename one, or name all in data.columns')
        raise DataError(f'{path}:{number}: no column {name!r}{did_you_mean(name, names)} in the '
                        f'header: {listed(names)}; name the columns in data.columns, or set '
                        'data.delimiter')
    return names or None


class _Reader:
    """Reader of the rows of a log; `strict` if words in used columns are errors."""

    def __init__(self, path: Path, names: Names, used: Sequence[str], mark: str | None,
                 strict: bool):
        self._path, self._names, self._used, self._mark = path, names, {*used}, mark
        self._strict, self._decimal = strict, ''

    def row(self, number: int, line: str) -> list[float]:
        """Return the numbers of a line; raise DataError for fields that are none."""
        names = self._names
        fields = _trimmed(_fields(line, self._mark), len(names))
        if len(fields) != len(names):
            more = ' or more' * (len(fields) > _MOST_COLUMNS)
            comma = '; are decimals written with commas? Write points, or separate columns by ' \
                'semicolons' if self._mark == ',' and len(fields) == 2 * len(names) else ''
            raise DataError(f'{self._path}:{number}: {len(fields)} columns{more}, expected '
                            f'{len(names)}: {listed(names)}{comma}')
        # Unused columns may hold anything.
        return [np.nan if name not in self._used or field.lower() in _MISSING else
                self._number(number, i, field)
                for i, (field, name) in enumerate(zip(fields, names, strict=True))]

    def _number(self, number: int, index: int, field: str) -> float:
        value, decimal = plain_number(field), '.' if '.' in field else ''
        if abs(value) <= MAX_VALUE and decimal == self._decimal:
            return value
        if _COMMA.fullmatch(field):
            value, decimal = plain_number(field.replace(',', '.')), ','
        thousands = _THOUSANDS.fullmatch(field)
        if not abs(value) <= MAX_VALUE and not self._strict and not thousands:
            return np.nan
        remedy = 'remove the row'
        if decimal and self._decimal and decimal != self._decimal:
            value, remedy = np.nan, 'other numbers have another decimal mark; use one of them'
        self._decimal = self._decimal or decimal
        if not abs(value) <= MAX_VALUE:
            if _DATE.fullmatch(field):
                remedy = 'convert times to seconds from the start'
            elif thousands:
                remedy = 'remove the separators of thousands'
            raise DataError(
                f'{self._path}:{number}: column {index + 1} ({self._names[index]}): expected a '
                f'finite number, found {field[:40]!r}; {remedy}')
        return value
