# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/published-tables.md: published figures next to the studies' figures."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import json
from pathlib import Path
import time
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from matplotlib.figure import Figure
from studies.pages import render
from studies.published_page import (
    FOLDER, MACHINES, read_results, Result, ResultTable, write_results)
from studies.results import commit, machine

PAGE, CSV = 'published-tables.md', 'known_tables.csv'
BODIES = 'lie_groups.json'
SECONDS = 'seconds'


@dataclass(frozen=True)
class Row:
    """
    A row of the page: a published table, whose figures are better where they are smaller.

    Parameters
    ----------
    table, text : str
        Name of the table in the results, and what the page says of the row.
    claims : tuple of (str, str, float)
        System and measure of our values, and the published figure in its own units.

    """

    table: str
    text: str
    claims: tuple[tuple[str, str, float], ...]


# Own generators, and published data sets.
OWN = (
    Row('energy_drift', 'DART, ten links: energy bands', (
        ('chain', 'variational_euler', 0.39), ('chain', 'gauss4', 0.011))),
    Row('energy_drift', 'Gymnasium, Acrobot: drifts at 0.2, 0.05, 0.01 s', (
        ('acrobot 0.2', 'gauss8', 3.554e-3), ('acrobot 0.05', 'gauss8', 4.189e-6),
        ('acrobot 0.01', 'gauss8', 1.519e-8))),
    Row('two_masses', 'OE-pHNN: NRMS at 0.1, 0.05 s', (
        ('0.1', 'gauss4', 0.0190), ('0.05', 'gauss4', 0.0192))),
    Row('two_masses', 'the same by Euler; by `variational_euler`', (
        ('0.1', 'variational_euler', 0.823), ('0.05', 'variational_euler', 0.0548))),
    Row('symoden', 'SymODEN, tasks 1 to 4', (
        ('pendulum (q, p)', 'formula', 4.31), ('pendulum (cos, sin)', 'formula', 0.0948),
        ('cart-pole', 'formula', 4.16), ('acrobot', 'formula', 0.809))),
    Row('chnn', 'CHNN, 1, 2, 3, 5 links', tuple(
        (f'{links} link{"s" * (links > 1)}', 'rigid bodies', published)
        for links, published in ((1, 5.2e-5), (2, 1.1e-4), (3, 3.3e-4), (5, 9.3e-4)))),
    Row('chnn', 'CHNN, gyroscope, rotor, magnet pendulum', (
        ('gyroscope', 'rigid bodies', 1.7e-5), ('rotor', 'rigid bodies', 5.8e-6),
        ('magnet pendulum', 'rigid bodies', 1.0e-2))))
SAME = Row('silverbox', 'Silverbox [mV]: six, seven numbers', (
    ('test', 'six numbers', 0.24), ('test', 'seven numbers', 0.24)))


def parser_of(name: str, text: str | None, more: str = '') -> Parser:
    """Return the parser of a study of the page, which has --out."""
    found = Parser(name, text, [f'make study NAME={name}{more}'])
    found.add_argument('--out', type=Path, default=Path('docs/evidence'), metavar='DIR',
                       help='folder to write to (default: docs/evidence)')
    return found


def keep(out: Path, table: str, values: Iterable[tuple[str, int, str, float]]) -> Path:
    """
    Replace the results of the measured systems of a table, then write the page; return it.

    Parameters
    ----------
    out : Path
        Folder of the page.
    table : str
        Name of the table.
    values : iterable of (str, int, str, float)
        System, seed, measure and value. The processor time that each took is added.

    """
    (out / FOLDER).mkdir(parents=True, exist_ok=True)
    start, origin, rows = time.process_time(), (commit(), machine()), []
    for system, seed, measure, value in values:
        print(table, system, seed, measure, value, flush=True)
        now = time.process_time()
        rows += [Result(table, system, seed, measure, value, *origin),
                 Result(table, system, seed, f'{measure}, {SECONDS}', now - start, *origin)]
        start = now
    measured = {row.system for row in rows}
    known = read_results(out, CSV) if (out / FOLDER / CSV).is_file() else []
    results = [*(row for row in known if row.table != table or row.system not in measured), *rows]
    write_results(out, results, CSV)
    path = out / PAGE
    path.write_text(as_page(out, results), encoding='utf-8')
    return path


def as_page(folder: Path, results: Sequence[Result] | None = None) -> str:
    """Return the page, from the results of all studies."""
    results = read_results(folder, CSV) if results is None else results
    found = ResultTable(results)
    rows = [_cells(found, row, _minutes(results, row.table)) for row in (*OWN, SAME)]
    rows += _other_pages(folder)
    own, same = ([row.texts for row in part] for part in (rows[:len(OWN)], rows[len(OWN):]))
    return render(PAGE, own=own, same=same, reached=sum(row.reached for row in rows),
                  all=sum(row.count for row in rows), gymnasium=_gymnasium(found),
                  double=_mean(found, 'two_masses', '0.2', 'gauss4'),
                  machine=found.names('machine'), commit=found.names('commit'))


class Cells(NamedTuple):
    """Cells of a row, and how many of its published figures are reached."""

    reached: int
    count: int
    texts: list[str]


def _cells(found: ResultTable, row: Row, minutes: str) -> Cells:
    cells, reached, seeds = [], 0, []
    for system, measure, published in row.claims:
        values = found.values(row.table, system, measure)
        if not len(values):
            cells.append('not measured')
            continue
        met = float(f'{values.mean():.2e}') <= published
        cells.append(f'{values.mean():.2g}' if met else f'**{values.mean():.3g}**')
        reached += met
        seeds.append(str(len(values)))
    published = ', '.join(f'{one:.3g}' for _, _, one in row.claims)
    return Cells(reached, len(cells), [
        row.text, published, ', '.join(cells), ', '.join(
            seeds if len(set(seeds)) > 1 else seeds[:1]), minutes])


def _gymnasium(found: ResultTable) -> str:
    """Return the drifts of Gymnasium's steps from our starts."""
    drifts = (found.values('energy_drift', f'acrobot {dt}', 'Gymnasium rk4')
              for dt in ('0.2', '0.05', '0.01'))
    return ', '.join(f'{values.mean():.1e}' for values in drifts if len(values))


def _mean(found: ResultTable, table: str, system: str, measure: str) -> str:
    values = found.values(table, system, measure)
    return f'{values.mean():.3g}' if len(values) else 'not measured'


def _minutes(results: Sequence[Result], table: str) -> str:
    seconds = sum(row.value for row in results
                  if row.table == table and row.measure.endswith(SECONDS))
    return f'{seconds / 60.0:.2g}' if seconds else ''


def _other_pages(folder: Path) -> Iterator[Cells]:
    """Yield the rows of published data sets that other pages describe."""
    rows = {(row['case'], row['measure'], row['model']): row
            for row in _json(folder / FOLDER / MACHINES)}
    for text, keys in _MACHINES.items():
        there = [rows[key] for key in keys]
        yield Cells(sum(row['met'] for row in there), len(there), [
            text, *('; '.join(_numbers(row[name]) for row in there)
                    for name in ('reference', 'ours')), str(len(there[0]['seeds'])), ''])
    losses = [_json(folder / FOLDER / BODIES)['test_loss'][name] for name in _BODIES]
    yield Cells(sum(loss['met'] for loss in losses), len(losses), [
        'LieGroupHamDL, pendulum, quadrotor',
        *(', '.join(f'{loss[name]:.1e}' for loss in losses) for name in ('published', 'ours')),
        '1', ''])
    # From the table of docs/evidence/fits.md.
    yield Cells(0, 1, ['EMPS [mm]', '2.64', '**2.77**', '1', '2'])


_MACHINES = {
    'letters [s], larger is better': [
        ('two-link arm that writes letters', 'valid prediction time [s], e and v', 'networks')],
    'C.1 after 0.1, 0.5 s [rad]': [
        ('real actuated double pendulum', f'RMS error [rad] after {horizon} s, test', 'default')
        for horizon in ('0.1', '0.5')]}
_BODIES = 'turning_pendulum', 'flying_quadrotor'


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except OSError as problem:
        raise ParameterError(f'{path}: cannot be read ({problem.strerror}); give a copy of '
                             'docs/evidence as --out') from problem


def _numbers(values: Sequence[float]) -> str:
    return ', '.join(f'{value:.3g}' for value in values)


def save(figure: Figure, out: Path, name: str) -> None:
    """Write a picture next to the results."""
    figure.savefig(out / FOLDER / f'{name}.png', dpi=110)
