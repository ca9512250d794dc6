# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compare the path error that each run tells with its true one, from right to wrong steps.

The errors are the largest distance from the path by DOP853 of scipy at rtol 1e-12, or by a much
smaller step, over the amplitude of the coordinate. A run is wrong above 30 %, right below 1 %. It
is silent if it is wrong, and neither raises the alarm nor tells an error of more than 10 %.
"""

from collections.abc import Iterator, Sequence
import csv
import math
from pathlib import Path
from typing import Any, NamedTuple
import warnings

from hnn_vi_ros import simulate, simulate_many
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.integrators import INTEGRATORS
import numpy as np
from studies.pages import render
from studies.path_error_systems import Judge, SYSTEMS

FILE, PAGE = 'path_error.csv', 'path-error.md'
WRONG, RIGHT, TOLD = 0.3, 0.01, 0.1
STEPS = 24
_MAX_STEPS = 100_000
# Errors below this are those of the reference, and rounding errors.
_LEAST = 1e-6


class Row(NamedTuple):
    """
    One run.

    Parameters
    ----------
    system, method : str
        Key of SYSTEMS, and of INTEGRATORS.
    step_size : float
        [s]; of adaptive methods the tolerance.
    error : float
        True error.
    told : float
        Error that the run tells; NaN if none.
    estimated : bool
        It is an estimate; otherwise a bound.
    until : float
        Time until which it was measured, over the duration.
    alarm : bool
        The run raises the alarm.

    """

    system: str
    method: str
    step_size: float
    error: float
    told: float
    estimated: bool
    until: float
    alarm: bool

    @classmethod
    def read(cls, row: Sequence[str]) -> 'Row':
        """Return a row of the file."""
        return cls(row[0], row[1], float(row[2]), float(row[3]), float(row[4]), row[5] == '1',
                   float(row[6]), row[7] == '1')

    @property
    def written(self) -> list[str]:
        """Return the row as in the file."""
        numbers = (f'{value:.4g}' for value in self[2:5])
        return [self.system, self.method, *numbers, str(int(self.estimated)),
                f'{self.until:.4g}', str(int(self.alarm))]

    @property
    def wrong(self) -> bool:
        """Return whether the run is wrong."""
        return not self.error <= WRONG

    @property
    def right(self) -> bool:
        """Return whether the run is right."""
        return self.error < RIGHT

    @property
    def silent(self) -> bool:
        """Return whether a wrong run does not say so."""
        return self.wrong and not self.alarm and not self.told > TOLD

    @property
    def false(self) -> bool:
        """Return whether a right run raises the alarm."""
        return self.right and self.alarm

    @property
    def broken(self) -> bool:
        """Return whether a bound does not hold."""
        return not self.estimated and self.error > max(self.told, _LEAST)

    @property
    def ratio(self) -> float:
        """Return estimate over error; NaN for a bound, or if the path is lost on the way."""
        whole = self.estimated and self.told < 1.0 and self.error > _LEAST
        return self.told / self.error if whole else math.nan


class Summary(NamedTuple):
    """Counts of a class of runs, and percentiles of estimate over error."""

    kind: str
    runs: int
    wrong: int
    silent: int
    unalarmed: int
    right: int
    false: int
    bounds: int
    broken: int
    ratios: list[float]

    @classmethod
    def of(cls, kind: str, rows: Sequence[Row]) -> 'Summary':
        """Return the summary of some rows."""
        ratios = np.array([row.ratio for row in rows])
        ratios = ratios[np.isfinite(ratios)]
        return cls(kind, len(rows), sum(row.wrong for row in rows),
                   sum(row.silent for row in rows),
                   sum(row.wrong and not row.alarm for row in rows),
                   sum(row.right for row in rows), sum(row.false for row in rows),
                   sum(not row.estimated for row in rows), sum(row.broken for row in rows),
                   [float(part) for part in np.percentile(ratios, [10, 50, 90])]
                   if ratios.size else [math.nan] * 3)

    @property
    def cells(self) -> list[str]:
        """Return the cells of the table."""
        ratios = ['' if math.isnan(ratio) else f'{ratio:.2f}' for ratio in self.ratios]
        return [self.kind, *map(str, self[1:9]), *ratios]


def runs(judge: Judge, name: str, method: str) -> Iterator[Row]:
    """Yield the runs of a method with steps, or tolerances, from right to wrong."""
    duration, hold = judge.system.duration, judge.system.hold
    if method == 'dop853':
        sizes = np.geomspace(1e-7, 0.03, STEPS)
    else:
        wrong = _wrong_step(judge, method)
        order = INTEGRATORS[method]().order
        least = max(wrong / max(5.0, 200.0 ** (1.0 / order)), duration / _MAX_STEPS)
        sizes = np.geomspace(least, min(4.0 * wrong, duration / 4.0), STEPS)
    if math.isfinite(hold):
        sizes = sizes if method == 'dop853' else np.unique(
            hold / np.maximum(np.round(hold / sizes), 1.0))
    for size in sizes:
        try:
            found = run(judge, method, float(size), 'measured')
        except HnnViRosError:
            # It speaks for itself.
            continue
        yield from (Row(name, method, float(size), *row) for row in found)


def _wrong_step(judge: Judge, method: str) -> float:
    """Return a step size, halved from a quarter of the duration, that errs by less than 10 %."""
    duration, size, right = judge.system.duration, min(
        judge.system.duration / 4.0, judge.system.hold), 0
    while size > duration / (0.1 * _MAX_STEPS):
        try:
            error = max(row[0] for row in run(judge, method, size, 'off'))
        except HnnViRosError:
            error = math.inf
        # Few instants of a wrong path may be right by chance.
        right = right + 1 if error < TOLD else 0
        if right == 2:
            return 2.0 * size
        size /= 2.0
    return size


def run(judge: Judge, method: str, size: float, path_error: str) -> list[tuple[Any, ...]]:
    """Return true error, error told, whether estimated, end and alarm of each trajectory."""
    system = judge.system
    adaptive = method == 'dop853'
    how = {'integrator': {'kind': method, 'relative_tolerance': size,
                          'absolute_tolerance': 1e-3 * size} if adaptive else method,
           'step_size': (min(system.hold, system.duration / 500.0) / 4.0
                         if adaptive else size)}
    if system.starts:
        scene = judge.parts.with_overrides(how['step_size'], how['integrator'])
        samples = math.ceil(system.duration / how['step_size'])
        q, p = (np.array([start[k] for start in system.starts]) for k in (0, 1))
        found = simulate_many(scene, q, p, samples * how['step_size'], samples=samples, threads=1,
                              path_error=path_error)
        return [_judged(judge, found.select(k), k) for k in range(len(q))]
    found = simulate(judge.parts, system.duration, commands=system.commands,
                     path_error=path_error, **how)
    return [_judged(judge, found)]


def _judged(judge: Judge, found: Any, row: int = 0) -> tuple[Any, ...]:
    """Return the judgement of a trajectory."""
    told = found.path_error
    return (judge.error(found.t, found.q, row), told.largest, told.estimated,
            float(told.t[-1] / found.t[-1]) if len(told.t) else math.nan,
            'path not resolved' in [alarm.kind for alarm in found.alarms])


def summaries(rows: Sequence[Row], kind: str) -> list[Summary]:
    """Return the summaries by class of systems, or by method, and of all."""
    key = {'class': lambda row: SYSTEMS[row.system].kind, 'system': lambda row: row.system,
           'method': lambda row: row.method}[kind]
    names = dict.fromkeys(map(key, rows))
    return [*(Summary.of(name, [row for row in rows if key(row) == name]) for name in names),
            Summary.of('all', rows)]


def read_rows(folder: Path) -> list[Row]:
    """Return the stored runs, in the order of SYSTEMS."""
    path = folder / FILE
    if not path.exists():
        return []
    with path.open(newline='', encoding='utf-8') as file:
        rows = [Row.read(row) for row in [*csv.reader(file)][1:]]
    names = list(SYSTEMS)
    return sorted((row for row in rows if row.system in SYSTEMS),
                  key=lambda row: names.index(row.system))


def as_page(folder: Path) -> str:
    """Return the page of the stored runs."""
    rows = read_rows(folder)
    return render('path-error.md', rows=rows, systems=len({row.system for row in rows}),
                  methods=len({row.method for row in rows}), total=Summary.of('all', rows),
                  classes=[found.cells for found in summaries(rows, 'class')],
                  silent=[row for row in rows if row.silent],
                  false=[row for row in rows if row.false])


def pairs(systems: Sequence[str], methods: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield systems and methods: all systems with one of their methods, then with another."""
    for round_ in range(max(len(SYSTEMS[name].methods) for name in systems)):
        for k, name in enumerate(systems):
            own = SYSTEMS[name].methods
            if round_ < len(own) and (method := own[(k + round_) % len(own)]) in methods:
                yield name, method


def main(argv: Sequence[str]) -> None:
    """Run what is not stored yet, store it, and write the page."""
    arguments = parser().parse_args(argv)
    rows = read_rows(arguments.docs)
    there = {(row.system, row.method) for row in rows}
    warnings.simplefilter('ignore')
    with (arguments.docs / FILE).open('a', newline='', encoding='utf-8') as file, \
            np.errstate(all='ignore'):
        writer = csv.writer(file, lineterminator='\n')
        if not rows:
            writer.writerow(Row._fields)
        judges = dict[str, Judge]()
        for name, method in pairs(arguments.systems, arguments.methods):
            if (name, method) in there:
                continue
            judge = judges[name] = judges.get(name) or Judge(name)
            found = [*runs(judge, name, method)]
            writer.writerows(row.written for row in found)
            file.flush()
            print(f'{name:30s} {method:20s}', *Summary.of('', found).cells[1:])
    (arguments.docs / PAGE).write_text(as_page(arguments.docs), encoding='utf-8')


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('path_error', __doc__, [
        'make study NAME=path_error', 'make study NAME=path_error ARGS="--systems servo"'])
    methods = sorted({method for system in SYSTEMS.values() for method in system.methods})
    found.add_argument('--systems', nargs='+', default=[*SYSTEMS], choices=[*SYSTEMS],
                       metavar='NAME', help='run only these systems')
    found.add_argument('--methods', nargs='+', default=methods, choices=methods, metavar='NAME',
                       help='run only these methods')
    found.add_argument('--docs', type=Path, default=Path('docs/evidence'), help=(
        f'folder of {FILE} and {PAGE} (default: docs/evidence); stored runs are kept'))
    return found
