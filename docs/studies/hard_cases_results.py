# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the hard cases: stored, compared with the committed expectations, written as CSV."""

from collections.abc import Callable, Iterable, Sequence
import csv
from dataclasses import asdict, dataclass, replace
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.simulation.guards.steps import RescueGuard
from studies.hard_cases_gates import failed_gates, limit_of, Measured, verdict
from studies.hard_cases_plan import Job

LINES, CSV = 'hard_cases.jsonl', 'hard_cases.csv'
QUICK, FULL = 'quick', 'full'
STABLE = 'stable'
# Points of a row's picture.
_POINTS = 100
_EPS = 2.0 ** -52
# Fields that the table for other programs leaves out.
_UNWRITTEN: dict[str, Any] = {'digest': '', 't': (), 'error': (), 'other': ()}
# A measure that is reported, not limited: nothing is gained or lost by a longer one.
_REPORTED = ('Lyapunov time', 'left', RescueGuard.kind)

Key = tuple[int, str, str, str]


@dataclass(frozen=True)
class CaseRow:
    """
    One line of the table.

    Parameters
    ----------
    case : int
        Its number.
    set_up, hamiltonian, method : str
        Name of the set-up, 'exact' or 'learned', label of the method.
    steps : int
        Number of requested steps.
    verdict : str
        See ``hard_cases_gates.verdict``.
    alarm : str
        Alarms with their steps, in order of time.
    failed : str
        Gates and claims of the case that do not hold.
    band, slope, modified_band, residual, reversal, symplectic : float
        See Measured.
    rounding : float
        Below which an energy says nothing [J].
    measures : dict of str to float
        Other measures of the case.
    seconds : float
        Wall time of the row, compilation included [s].
    digest : str
        Checksum of the job; see ``Job.digest``.
    t, error, other : tuple of float
        For the picture; see Measured.

    """

    case: int
    set_up: str
    hamiltonian: str
    method: str
    steps: int
    verdict: str
    alarm: str
    failed: str
    band: float
    slope: float
    modified_band: float
    residual: float
    reversal: float
    symplectic: float
    rounding: float
    measures: dict[str, float]
    seconds: float
    digest: str
    t: tuple[float, ...]
    error: tuple[float, ...]
    other: tuple[float, ...]

    @property
    def key(self) -> Key:
        """Return the key of the row, unique within a run."""
        return self.case, self.set_up, self.hamiltonian, self.method

    @property
    def first_alarm(self) -> str:
        """Return the first alarm, without its step."""
        return self.alarm.partition(';')[0].partition(' at step')[0]

    @property
    def limited(self) -> dict[str, float]:
        """Return the limited values of a stable run: its band and all measures."""
        values = {'band': self.band, 'modified band': self.modified_band} | {
            name: value for name, value in self.measures.items() if name not in _REPORTED}
        return {name: value for name, value in values.items() if not math.isnan(value)}


class Expectation(NamedTuple):
    """Expectation of one row: its verdict, its first alarm, limits by name."""

    verdict: str
    alarm: str
    measured: dict[str, float]
    limits: dict[str, float]


def make_row(job: Job, measured: Measured, seconds: float) -> CaseRow:
    """Return the row of a job, before the comparison with its expectation."""
    failed = failed_gates(measured, job.case.gates)
    said = [f'{alarm.kind} at step {alarm.step}' for alarm in measured.alarms]
    if measured.failure is not None:
        failure = measured.failure
        said.append(f'{failure.reason} at step {round(failure.t / failure.h)}')
    stride = max(1, measured.t.size // _POINTS)
    number, name, kind, method = job.key
    return CaseRow(number, name, kind, method, job.steps, verdict(measured, failed),
                   '; '.join(said), ', '.join(failed),
                   measured.band, measured.slope, measured.modified_band,
                   measured.residual, measured.reversal, measured.symplectic, measured.rounding,
                   measured.measures, seconds, job.digest, tuple(measured.t[::stride].tolist()),
                   tuple(measured.error[::stride].tolist()),
                   tuple(measured.other[::stride].tolist()))


def judge(row: CaseRow, expectation: Expectation | None) -> CaseRow:
    """Judge a row by its limits: one that exceeds a limit is not stable."""
    if expectation is None or row.verdict != STABLE:
        return row
    exceeded = []
    for name, limit in expectation.limits.items():
        value = row.limited.get(name, math.nan)
        # Values at round-off level are not a property of the method.
        floor = row.rounding if 'band' in name else 2.0 * _EPS * math.sqrt(row.steps)
        if not value <= max(limit, floor):
            exceeded.append(f'{name} > {limit:g}')
    if not exceeded:
        return row
    return replace(row, verdict='unstable',
                   failed=', '.join(([row.failed] if row.failed else []) + exceeded))


def differences(rows: Iterable[CaseRow], expected: dict[Key, Expectation]) -> list[str]:
    """Return a line for each row whose verdict, or first alarm, is not the committed one."""
    lines = []
    for row in rows:
        name = f'case {", ".join(str(part) for part in row.key if part != "")}'
        found = expected.get(row.key)
        if found is None:
            lines.append(f'{name}: no verdict is committed, it is {row.verdict}')
        elif (row.verdict, row.first_alarm) != (found.verdict, found.alarm):
            why = ', '.join(part for part in (row.alarm, row.failed) if part)
            lines.append(f'{name}: {row.verdict}{f" ({why})" if why else ""}, expected '
                         f'{found.verdict}{f" ({found.alarm})" if found.alarm else ""}')
    return lines


def expectations_file() -> Path:
    """Return the file of the committed expectations."""
    return Path(__file__).with_name('hard_cases_expected.csv')


def load_expectations(path: Path, run: str) -> dict[Key, Expectation]:
    """
    Read the expectations of a 'quick' or 'full' run; none if there is no file.

    Raises
    ------
    ParameterError
        The file is damaged.

    """
    if not path.is_file():
        return {}
    expected = {}
    try:
        with path.open(newline='', encoding='utf-8') as file:
            for line in csv.DictReader(file):
                if line['run'] == run:
                    key = int(line['case']), line['set_up'], line['hamiltonian'], line['method']
                    expected[key] = Expectation(
                        line['verdict'], line['alarm'], parse_values(line['measured']),
                        parse_values(line['limits']))
    except (KeyError, ValueError) as problem:
        raise ParameterError(f'{path}: not a table of expectations ({problem}); restore it from '
                             'the repository') from problem
    return expected


def write_expectations(path: Path, run: str, rows: Sequence[CaseRow]) -> None:
    """Write rows as new expectations; keep the expectations of other rows."""
    table = {(kind, *key): entry for kind in (QUICK, FULL)
             for key, entry in load_expectations(path, kind).items()}
    for row in rows:
        values = row.limited if row.verdict == STABLE else {}
        measured = {name: float(f'{value:.3g}') for name, value in values.items()}
        table[(run, *row.key)] = Expectation(
            row.verdict, row.first_alarm, measured,
            {name: limit_of(value) for name, value in measured.items()})
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(['run', 'case', 'set_up', 'hamiltonian', 'method', 'verdict', 'alarm',
                         'measured', 'limits'])
        for key, entry in sorted(table.items(), key=lambda item: item[0]):
            writer.writerow([*key, entry.verdict, entry.alarm, format_values(entry.measured),
                             format_values(entry.limits)])


def format_values(values: dict[str, float]) -> str:
    """Return values by name as text, such as 'band=0.0025; rise=0'."""
    return '; '.join(f'{name}={value:g}' for name, value in values.items())


def parse_values(text: str) -> dict[str, float]:
    """Parse the text of ``format_values``; raise ValueError if it is invalid."""
    pairs = [item.partition('=') for item in text.split('; ') if item]
    return {name: float(value) for name, _, value in pairs}


def write_csv(path: Path, rows: Sequence[CaseRow]) -> Path:
    """Write rows as a table for other programs; return its path."""
    names = [name for name in CaseRow.__dataclass_fields__ if name not in _UNWRITTEN]
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(names)
        for row in rows:
            cells = [getattr(row, name) for name in names]
            writer.writerow([
                format_values(cell) if isinstance(cell, dict) else '' if cell != cell
                else f'{cell:g}' if isinstance(cell, float) else cell for cell in cells])
    return path


def read_csv(path: Path) -> list[CaseRow]:
    """Return the rows of ``write_csv``, without the data of the pictures."""
    kinds: dict[str, Callable[[str], Any]] = {
        'int': int, 'str': str, 'float': lambda text: float(text or math.nan)}
    with path.open(encoding='utf-8') as file:
        lines = list(csv.DictReader(file))
    return [CaseRow(**{
        name: parse_values(text) if name == 'measures'
        else kinds[CaseRow.__annotations__[name].__name__](text)
        for name, text in line.items()}, **_UNWRITTEN) for line in lines]


class Folder:
    """
    The rows of a run on disk, written one by one, so that an interrupted run can continue.

    Parameters
    ----------
    path : Path
        Made if it is not there.
    identity : dict of str to str
        Values that are equal for all rows of a run.

    Raises
    ------
    ParameterError
        It cannot be written, or holds another run.

    """

    def __init__(self, path: Path, identity: dict[str, str]):
        self.path, self.identity, self.rows = path, identity, list[CaseRow]()
        try:
            path.mkdir(parents=True, exist_ok=True)
            lines = (path / LINES).read_text(encoding='utf-8').splitlines() \
                if (path / LINES).is_file() else []
            if lines:
                self._load(lines, identity)
            else:
                (path / LINES).write_text(json.dumps(identity) + '\n', encoding='utf-8')
        except OSError as problem:
            raise ParameterError(f'--out {path}: cannot be written ({problem.strerror}); give a '
                                 'folder that can be written') from problem

    def _load(self, lines: list[str], identity: dict[str, str]) -> None:
        if json.loads(lines[0]) != identity:
            raise ParameterError(f'{self.path}: holds another run (quick or full, or of another '
                                 'machine or version); give another --out, or remove it to run '
                                 'anew')
        for line in lines[1:]:
            entry = json.loads(line)
            entry |= {name: tuple(entry[name]) for name in ('t', 'error', 'other')}
            self.rows.append(CaseRow(**entry))

    def add(self, row: CaseRow) -> None:
        """Keep a row."""
        self.rows.append(row)
        with (self.path / LINES).open('a', encoding='utf-8') as file:
            file.write(json.dumps(asdict(row)) + '\n')
