# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read motions from text files with one row of numbers per sample."""

from array import array
from collections.abc import Iterator, Sequence
from contextlib import suppress
import csv
from datetime import date
from functools import lru_cache
from itertools import chain, islice, pairwise, zip_longest
import os
from pathlib import Path
import re
from typing import Any, ClassVar, Literal, NamedTuple

from hnn_vi_ros.errors import counted, DataError, did_you_mean, listed
from hnn_vi_ros.files import (
    limited, LONGEST_LINE, no_file, plain_number, sha256_of, StrictModel, text_lines)
from hnn_vi_ros.learning.data.dataset import (
    BLOCKS, Derivatives, mass_matrix, Names, StateOptions, time_blocks)
from hnn_vi_ros.learning.data.faults import times_text
from hnn_vi_ros.learning.data.motions import (
    MAX_VALUE, Motion, MotionData, Recording, with_commands)
from hnn_vi_ros.learning.data.tables import table_text
from hnn_vi_ros.learning.data.units import conversion, parse_unit, split_unit
import numpy as np
from pydantic import Field

MAX_BYTES = 256 << 20
# Maximum number of columns, and length of a line with quoted fields.
_MOST_COLUMNS, _MOST_QUOTED = 1000, 100_000
# Maximum number of lines before the first row of numbers, and of rows that show the delimiter.
_MOST_HEAD, _ROWS = 200, 10

# Parsed logs that are kept: those of one fit.
_MOST_LOGS = 100

# Names of columns without a header.
COLUMN = 'column {}'

# Fractions next to whole seconds, such as header.stamp.nanosec; days next to times of day.
_PART = re.compile(r'(|.*[^a-z])(nano|n|micro|u|milli|m)sec(?:ond)?s?', re.IGNORECASE)
_SIZES = {'n': 1e-9, 'u': 1e-6, 'micro': 1e-6, 'm': 1e-3, 'milli': 1e-3, 'nano': 1e-9}
_DAYS, _CLOCKS = ('date', 'datum', 'fecha', 'data', 'day'), (
    'time', 'zeit', 'uhrzeit', 'heure', 'hora', 'ora', 'tijd')
_DATE = re.compile(
    r'(?:(?P<a>\d{1,4})(?P<mark>[-/.])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{1,4}))?[T ]*'
    r'(?:(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d+)?) ?(?P<half>[ap]m)?)? ?'
    r'(?:Z|UTC|[-+]\d\d:?\d\d)?', re.IGNORECASE)
_DIGITS = re.compile(r"[+-]?\d*[,.' ]\d[\d,.' ]*(e[+-]?\d+)?", re.IGNORECASE)
_SWAPPED = str.maketrans('.,', ',.')
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
    encoding: Literal['utf-8', 'utf-16', 'cp1252'] = Field(
        'utf-8', description='encoding of the text')
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

    The units are s, rad and the coordinates' units; a unit of something else is refused.
    """

    # Configuration key of the columns of each channel of a motion.
    keys: ClassVar[dict[str, str]]

    trial: str | None = Field(None, description='column with the number of the recording')
    time: str = Field(description='column of the times')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    degrees: Names | None = Field(None, description=(
        'columns of angles and their rates in degrees; default: those whose names say so'))
    counts: float | None = Field(None, gt=0.0, description=(
        'counts per turn of a coordinate in counts: those of the encoder times the gear ratio'))
    torque_constant: float | None = Field(None, gt=0.0, description=(
        'force per current [N m/A]: that of the motor times the gear ratio'))

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

    def _check(self) -> None:
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

    keys = {'q': 'q', 'v': 'v', 'a': 'a', 'tau': 'tau', 'command': 'command', 'enabled': 'enabled'}

    kind: Literal['log'] = 'log'
    v: Names | None = Field(None, description='columns of dq/dt; none: estimated from q')
    a: Names | None = Field(None, description='columns of the accelerations; none: estimated')
    tau: Names | None = Field(None, description='columns of the motor forces; none: no forces')
    command: Names | None = Field(None, description=(
        'columns of positions commanded to servos, for identify; none: no commands'))
    enabled: Names | None = Field(None, description=(
        'columns that are 0 while the motors are off, one for all or one for each command'))

    def _check(self) -> None:
        for key in ('v', 'a', 'tau', 'command', 'enabled'):
            group = getattr(self, key)
            # There may be fewer motors than joints.
            if group is not None and (len(group) > len(self.q) or (
                    key in ('v', 'a') and len(group) < len(self.q))):
                raise ValueError(f'{key} has {counted(len(group), "column")}, q has {len(self.q)}')
        self.check_columns()


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
    notes += [f'{x:g} {unit}' for x, unit in ((data.counts, 'counts per turn'), (
        data.torque_constant, 'N m/A')) if x]
    t = factors.get(data.time, 1.0) * column[data.time]
    column |= {name: factors.get(name, 1.0) * without_sentinels(column[name], t, name, notes)
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
        own = {key: values[rows] for key, values in channels.items()}
        command, enabled = own.pop('command', None), own.pop('enabled', None)
        motions.append(with_commands(Motion(
            name, f'{path}: {name}', column[data.time][rows], notes=tuple(notes),
            names=(*data.q, *(data.channels.get('v') or ())), **own), command, enabled))
    return Recording(motions, path.name, table.digest[:16])


def without_sentinels(values: np.ndarray, t: np.ndarray, name: str, notes: list[str]
                      ) -> np.ndarray:
    """Return a column with NaN for placeholders of missing values, which are far from others."""
    for value in np.unique(values[np.isin(values, _SENTINELS)]):
        others = values[np.isfinite(values) & ~np.isin(values, _SENTINELS)]
        if not others.size or (np.abs(others - value) > np.ptp(others)).all():
            found = np.flatnonzero(values == value)
            notes.append(f'{name} is {value:g} in {counted(len(found), "sample")}'
                         + times_text(t[found]))
            values = np.where(values == value, np.nan, values)
    return values


# Rates of the channels in q_unit; a momentum may be a velocity, and none need be what it says.
_RATES = {'q': '', 'command': '', 'v': '/s', 'a': '/s2', 'p': '/s', 'dp_dt': '/s2'}


def _factors(path: Path, data: LogColumns, units: Sequence[str]) -> dict[str, float]:
    """Return the conversion factors of the columns; DataError if units contradict."""
    factors = {data.time: _factor(path, data.time, 's')}
    for channel, names in data.channels.items():
        for k, name in enumerate(names):
            unit = split_unit(name)[1]
            known = parse_unit(unit)
            if known is not None and data.counts and known[1].get('count') == 1:
                factors[name] = 2.0 * np.pi / data.counts * known[0]
                continue
            if known is not None and data.torque_constant and known[1] == {'A': 1}:
                factors[name] = data.torque_constant * known[0]
                continue
            if known is None or channel in ('tau', 'enabled'):
                factors[name] = 1.0 if known is None else known[0]
                continue
            angular = known[1] in ({}, {'s': -1}, {'s': -2})
            own = units[k] if units and units[k] != '1' and parse_unit(units[k]) else \
                'rad' * angular
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
    above : list of str
        Lines above the names.
    notes : list of str
        Notes for the model card.

    """

    numbers: np.ndarray
    lines: np.ndarray
    digest: str
    names: Names
    above: list[str]
    notes: list[str]


class Layout(NamedTuple):
    """Form of a log, found in its first lines."""

    delimiter: str | None  # None for white space
    decimal: str  # mark of the decimals, point or comma
    head: int  # line of the names
    names: Names  # those of all columns; none without a header
    width: int  # number of columns
    first: int  # line of the first row
    above: list[tuple[int, str]]  # lines before it


class _Rows(NamedTuple):
    """All numbers of a log, and what is none: rows of another width, and words in columns."""

    layout: Layout
    numbers: np.ndarray
    lines: np.ndarray
    digest: str
    notes: list[str]
    width: tuple[int, int] | None  # line and columns of the first row of another width
    words: dict[int, tuple[int, str]]  # line and text of the first word in a column


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
        state = path.stat()
        rows = _rows(path, data.encoding, data.delimiter, data.comment, state.st_mtime_ns,
                     state.st_size)
    except OSError as problem:
        raise DataError(f'{path}: cannot be read: {problem.strerror}; use a smaller part of it, '
                        'or another log') from problem
    except ValueError as problem:
        encoded = ', and its encoding, as in data: {kind: log, encoding: cp1252}'
        raise DataError(f'{path}:{problem}; give a log of rows of numbers'
                        + encoded * isinstance(problem.__cause__, UnicodeError)) from problem
    names = _names(path, data, rows.layout)
    _check_rows(path, data, rows, names)
    if len(rows.lines) < 2:
        raise DataError(f'{path}: {counted(len(rows.lines), "row")} of data, expected a longer '
                        'log')
    return Table(_with_stamps(rows.numbers, names), rows.lines, rows.digest, names,
                 [text for _, text in rows.layout.above], rows.notes)


def _check_rows(path: Path, data: LogFormat, rows: _Rows, names: Names) -> None:
    """Raise DataError for the first row of another width, or word in a column in use."""
    used, width = {*(data.used or names)}, rows.width
    used |= {part for part, _ in _stamps(names).values()}
    if width is None and len(names) != rows.layout.width:
        width = rows.layout.first, rows.layout.width
    flaws = [(line, k, field) for k, (line, field) in rows.words.items() if k < len(names)
             and names[k] in used and (data.used or _DIGITS.fullmatch(field))]
    line, k, field = min(flaws, default=(np.inf, 0, ''))
    if width is not None and width[0] <= line:
        more = ' or more' * (width[1] > _MOST_COLUMNS)
        raise DataError(f'{path}:{width[0]}: {counted(width[1], "column")}{more}, expected '
                        f'{len(names)}: {listed(names)}')
    if flaws:
        remedy = 'remove separators of thousands, and use one decimal mark' if \
            _DIGITS.fullmatch(field) else 'remove the row'
        raise DataError(f'{path}:{line}: column {k + 1} ({names[k]}): expected a finite number, '
                        f'found {field[:40]!r}; {remedy}')


# The roles of columns and the motions are found in turn: a log is parsed once for both.
@lru_cache(maxsize=_MOST_LOGS)
def _rows(path: Path, encoding: str, delimiter: str | None, comment: str, *_: int) -> _Rows:
    """Return the numbers of a log in all columns, NaN for words."""
    encoding = 'utf-8-sig' if encoding == 'utf-8' else encoding
    text = table_text(path, MAX_BYTES, encoding)

    def content() -> Iterator[tuple[int, str]]:
        return text_lines(path, MAX_BYTES, encoding) if text is None else iter(
            enumerate(text.splitlines(), 1))
    layout = _layout(path, content(), delimiter, comment)
    # Stored as 8-byte numbers: lists of lists would take ten times the size of the log.
    numbers, lines, notes = array('d'), array('q'), list[str]()
    found = (row for row in content() if row[0] >= layout.first
             and row[1].strip() and not row[1].lstrip().startswith(comment))
    closed = _ends_with_line_break(path) if text is None else text.endswith('\n')
    width: tuple[int, int] | None = None
    words, least = dict[int, tuple[int, str]](), MAX_BYTES
    for (number, line), following in pairwise(chain(found, [(0, '')])):
        complete = closed or following[0] > 0 or not lines
        fields = _trimmed(_fields(line, layout.delimiter), layout.width)
        row = [_number_or_none(field, layout.decimal) for field in fields]
        new = {k: (number, field) for k, (field, x) in enumerate(zip(fields, row, strict=True))
               if x is None and k not in words}
        # A truncated row lacks columns, or digits of its last number.
        decimals = 0 if closed else len(line.rsplit(layout.delimiter, 1)[-1].rstrip('"').partition(
            layout.decimal)[2])
        if not complete and (len(row) != layout.width or new or decimals < least):
            notes.append(f'line {number}, the last one, is truncated')
            continue
        if len(row) != layout.width:
            width = number, len(row)
            break
        words |= new
        numbers.extend(np.nan if x is None else x for x in row)
        lines.append(number)
        least = min(least, decimals)
    table = np.array(numbers).reshape(len(lines), layout.width)
    table.setflags(write=False)
    return _Rows(layout, table, np.array(lines), sha256_of(path, MAX_BYTES), notes, width, words)


def _with_stamps(numbers: np.ndarray, names: Names) -> np.ndarray:
    """Add the parts of stamps, such as nanoseconds, to their whole seconds."""
    stamps = _stamps(names)
    table = numbers.copy() if stamps else numbers
    for whole, (part, size) in stamps.items():
        rest = size * table[:, names.index(part)]
        known = rest[np.isfinite(rest)]
        if known.size and ((known % 86400.0 == 0.0) if size == 1.0 else np.abs(known) < 1.0).all():
            table[:, names.index(whole)] += rest
    return table


def _stamps(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return the columns of whole seconds, each with that of a part to add and its size [s]."""
    found, lower = dict[str, tuple[str, float]](), [name.lower() for name in names]
    for part in names:
        match = _PART.fullmatch(part)
        for name in names if match else ():
            if match and name.lower() in {f'{match[1]}{word}'.lower() for word in (
                    'sec', 'secs', 'second', 'seconds')}:
                found[name] = part, _SIZES[match[2].lower()]
    days, clocks = ([names[k] for k, name in enumerate(lower) if name in words]
                    for words in (_DAYS, _CLOCKS))
    return found | dict.fromkeys(clocks[:1], (days[0], 1.0)) if days else found


def _ends_with_line_break(path: Path) -> bool:
    with limited(path, MAX_BYTES) as stream:
        stream.seek(max(os.fstat(stream.fileno()).st_size - 2, 0))
        return stream.read().rstrip(b'\0')[-1:] in (b'\n', b'\r')  # UTF-16 has zeros after them


def _fields(line: str, mark: str | None) -> list[str]:
    # Limit the splits: a line may be as long as the file.
    fields = line.split(mark, _MOST_COLUMNS)
    if '"' in line and len(line) < _MOST_QUOTED:
        with suppress(csv.Error):
            fields = next(csv.reader([line.strip()] if mark is None else [line],
                                     delimiter=mark or ' ', skipinitialspace=True))
    return [field.strip().strip('"\'') for field in fields]


def _trimmed(fields: list[str], least: int = 0) -> list[str]:
    """Return fields without empty ones at the end, which separators there make."""
    while len(fields) > least and not fields[-1]:
        fields = fields[:-1]
    return fields


def _number(field: str, decimal: str) -> float:
    """Return a number with this decimal mark, or a date in s; NaN for words and huge numbers."""
    value = plain_number(field if decimal == '.' else field.translate(_SWAPPED))
    return value if abs(value) <= MAX_VALUE else _seconds(field) if value != value else np.nan


def _seconds(field: str) -> float:
    """Return the time of a date since 1970, or of an hour since midnight [s]; NaN for others."""
    match = _DATE.fullmatch(field) if field[:1].isdigit() else None
    if not match or not (match['a'] or match['h']):
        return np.nan
    day = 0
    if match['a']:
        numbers = [int(match[key]) for key in 'abc']
        # The year has four digits; 1/31/2026 is American, as 31/1/2026 is not.
        numbers = numbers if len(match['a']) == 4 else numbers[::-1]
        if len(match['a']) != 4 and (
                numbers[1] > 12 or (match['mark'] == '/' and numbers[2] <= 12)):
            numbers[1:] = numbers[:0:-1]
        try:
            day = date(*numbers).toordinal() - date(1970, 1, 1).toordinal()
        except ValueError:
            return np.nan
    hours = int(match['h'] or 0)
    if match['half']:
        hours = hours % 12 + 12 * (match['half'].lower() == 'pm')
    return 86400.0 * day + 3600.0 * hours + 60.0 * int(match['m'] or 0) + float(
        (match['s'] or '0').replace(',', '.'))


def _number_or_none(field: str, decimal: str) -> float | None:
    """Return a number, NaN for a missing one, or None for words."""
    if field.lower() in _MISSING:
        return np.nan
    value = _number(field, decimal)
    return value if value == value else None


def _layout(path: Path, lines: Iterator[tuple[int, str]], delimiter: str | None, comment: str
            ) -> Layout:
    """Find out how a log is written, from its first lines."""
    head, size = list[tuple[int, str]](), 0
    for number, line in islice(lines, _MOST_HEAD):
        head += [(number, line)] * bool(line.strip())
        size += len(line)
        if size > LONGEST_LINE:
            break
    rows = [line for _, line in head if not line.lstrip().startswith(comment)][-_ROWS:]

    def is_number(field: str) -> bool | None:
        return None if field.lower() in _MISSING else any(
            _number(field, decimal) == _number(field, decimal) for decimal in '.,')

    def kinds(line: str, mark: str | None) -> list[bool | None]:
        return list(map(is_number, _fields(line, mark)))

    def score(name: str) -> tuple[bool, int, int]:
        found = [kinds(line, _SEPARATORS[name]) for line in rows]
        numbers = [sum(map(bool, row)) for row in found]
        return (sum(numbers) >= 2 * sum(map(bool, numbers)) > 0,
                -sum(row.count(False) for row in found), sum(numbers))
    best = max(_SEPARATORS, key=score)
    mark = _SEPARATORS[delimiter or best]
    sample = [row for line in rows if any(row := kinds(line, mark))]
    first = next((at for at, (_, line) in enumerate(head) if sample
                  and not line.lstrip().startswith(comment) and any(row := kinds(line, mark))
                  and len(row) >= min(len(sample[-1]), 2)
                  and (row[0] is not False or sample[-1][0] is False)), None)
    if first is None:
        split_by = f', split by {delimiter}; set data.delimiter: {best}' \
            if delimiter and score(best)[0] else ''
        raise DataError(f'{path}: no rows of numbers{split_by or "; give one for each sample"}')
    fields = [field for line in rows for field in _fields(line, mark)]
    decimal = max('.,', key=lambda mark: sum(
        mark in field and bool(is_number(field)) and _seconds(field) != _seconds(field)
        for field in fields))
    above = [(number, line.strip().removeprefix(comment).removeprefix('% ').strip())
             for number, line in head[:first]]
    width = len(_trimmed(_fields(head[first][1], mark)))
    number, names = _header(above, mark, width)
    return Layout(mark, decimal, number, names, len(names) or width, head[first][0], above)


def _header(above: list[tuple[int, str]], mark: str | None, width: int) -> tuple[int, Names]:
    """Return the line of the names of the columns, and the names, none without a header."""
    lines = [(number, _trimmed(_fields(text, mark))) for number, text in above]
    lines = [(number, names) for number, names in lines if len(names) >= max(2, width)] or [
        (number, text.split()) for number, text in above if len(text.split()) == width]
    number, names = lines[-1] if lines else (1, [])
    if len(lines) > 1 and all(parse_unit(field.strip('[]()')) for field in names if field):
        units = [unit.strip('[]()') for unit in names]
        number, names = lines[-2]
        names = [f'{name} [{unit}]' if unit and not split_unit(name)[1] else name
                 for name, unit in zip_longest(names, units[:len(names)], fillvalue='')]
    return number, names


def _names(path: Path, data: LogFormat, layout: Layout) -> Names:
    """Return the names of the columns: those given, or those in the header, or numbers."""
    number, names, mark = layout.head, layout.names, layout.delimiter
    half = [at for at, text in layout.above if 2 * len(_fields(text, mark)) == layout.width > 2]
    if mark == ',' and half and not names and data.columns is None:
        raise DataError(f'{path}:{half[-1]}: {layout.width // 2} names for {layout.width} '
                        'columns; are decimals written with commas? Write points, or separate '
                        'columns by semicolons')
    if data.columns is not None:
        moved = [name for k, name in enumerate(names) if name in data.columns
                 and data.columns.index(name) != k and names.count(name) == 1
                 and len(names) == len(data.columns)]
        if moved:
            raise DataError(f'{path}:{number}: data.columns has {moved[0]} at another place than '
                            f'the header: {listed(names)}; correct one of them')
        return data.columns
    if not names and data.used:
        # A header of fewer names than the rows have columns.
        names = next((own for _, text in layout.above
                      if {*data.used} <= {*(own := _trimmed(_fields(text, mark)))}), [])
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
    return names or [COLUMN.format(k + 1) for k in range(layout.width)]
