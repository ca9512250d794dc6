# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/published-tables.md: published figures beside those of the studies."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import json
from pathlib import Path
import time
from typing import Any

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files.command_line import Parser
from matplotlib.figure import Figure
from studies.pages import render
from studies.published_page import (
    FOLDER, MACHINES, read_results, Result, ResultTable, spread, write_results)
from studies.results import commit, machine

PAGE, CSV = 'published-tables.md', 'known_tables.csv'
BODIES = 'lie_groups.json'
SECONDS = 'seconds'


@dataclass(frozen=True)
class Claim:
    """
    A published figure, and ours that stands beside it; smaller is better.

    Parameters
    ----------
    table, system, measure : str
        Key of our values in the results.
    published : float
        In the units of the publication.
    text : str
        Subject of the row.
    published_text, ours : str
        Method of the published figure, and of ours.
    same : bool
        True if both are of one published data set.

    """

    table: str
    system: str
    measure: str
    published: float
    text: str
    published_text: str
    ours: str
    same: bool = False


CLAIMS = (
    Claim('energy_drift', 'chain', 'variational_euler', 0.39,
          'ten links, 1e5 steps of 1 ms: energy band', 'DART, semi-implicit Euler',
          '`variational_euler`'),
    Claim('energy_drift', 'chain', 'gauss4', 0.011, '', 'DART, variational', '`gauss4`'),
    Claim('energy_drift', 'acrobot 0.2', 'gauss8', 3.554e-3,
          'Acrobot, 100 s: energy drift, dt = 0.2 s', 'Gymnasium', '`gauss8`, h = 0.1 s'),
    Claim('energy_drift', 'acrobot 0.05', 'gauss8', 4.189e-6, 'dt = 0.05 s', 'Gymnasium',
          '`gauss8`, h = 0.1 s'),
    Claim('energy_drift', 'acrobot 0.01', 'gauss8', 1.519e-8, 'dt = 0.01 s', 'Gymnasium',
          '`gauss8`, h = 0.05 s'),
    Claim('two_masses', '0.1', 'gauss4', 0.0190, 'two masses, noise: NRMS of a test record',
          'OE-pHNN, its method and step', '`identify`, `gauss4`, h = 0.1 s'),
    Claim('two_masses', '0.05', 'gauss4', 0.0192, 'half the step', 'OE-pHNN', 'the same'),
    Claim('two_masses', '0.1', 'variational_euler', 0.823, 'another method',
          'OE-pHNN, Euler', '`variational_euler`'),
    Claim('two_masses', '0.05', 'variational_euler', 0.0548, 'both',
          'OE-pHNN, Euler', '`variational_euler`'),
    *(Claim('symoden', system, 'formula', published, text, 'SymODEN', '`identify`, formula')
      for system, published, text in (
          ('pendulum (q, p)', 4.31, 'SymODEN, task 1: pendulum, error of prediction'),
          ('pendulum (cos, sin)', 0.0948, 'task 2: pendulum by its sine and cosine'),
          ('cart-pole', 4.16, 'task 3: cart-pole'), ('acrobot', 0.809, 'task 4: Acrobot'))),
    *(Claim('chnn', system, 'rigid bodies', published, text, 'CHNN or CLNN', f'`identify`, {ours}')
      for system, published, text, ours in (
          ('1 links', 5.2e-5, 'CHNN, chain of 1 link: relative error of a run', 'URDF'),
          ('2 links', 1.1e-4, '2 links', 'URDF'), ('3 links', 3.3e-4, '3 links', 'URDF'),
          ('5 links', 9.3e-4, '5 links', 'URDF'), ('gyroscope', 1.7e-5, 'gyroscope', 'formula'),
          ('rotor', 5.8e-6, 'rotor', 'formula'),
          ('magnet pendulum', 1.0e-2, 'magnet pendulum', 'formula'))),
    Claim('silverbox', 'test', 'six numbers', 0.24, 'Silverbox, test record: error [mV]',
          'best', '`identify`, six numbers', True),
    Claim('silverbox', 'test', 'seven numbers', 0.24, '', 'best', 'and quadratic drag', True),
)


def parser_of(name: str, text: str | None, more: str = '') -> Parser:
    """Return the parser of a study of the page, which has --out."""
    found = Parser(name, text, [f'make study NAME={name}{more}'])
    found.add_argument('--out', type=Path, default=Path('docs/evidence'), metavar='DIR',
                       help='folder to write to (default: docs/evidence)')
    return found


def keep(out: Path, table: str, values: Iterable[tuple[str, int, str, float]]) -> Path:
    """
    Replace the results of one table, then write the page; return it.

    Parameters
    ----------
    out : Path
        Folder of the page.
    table : str
        Name of the table.
    values : iterable of (str, int, str, float)
        System, seed, measure and value. The processor time of the table is added.

    """
    (out / FOLDER).mkdir(parents=True, exist_ok=True)
    start, origin = time.process_time(), (commit(), machine())
    rows = [Result(table, *row, *origin) for row in values]
    rows.append(Result(table, '', 0, SECONDS, time.process_time() - start, *origin))
    known = read_results(out, CSV) if (out / FOLDER / CSV).is_file() else []
    results = [*(row for row in known if row.table != table), *rows]
    write_results(out, results, CSV)
    path = out / PAGE
    path.write_text(as_page(out, results), encoding='utf-8')
    return path


def as_page(folder: Path, results: Sequence[Result] | None = None) -> str:
    """Return the page, from the results of all studies."""
    found = ResultTable(read_results(folder, CSV) if results is None else results)
    rows: dict[bool, list[list[str]]] = {False: [], True: []}
    reached, last = 0, ''
    for claim in CLAIMS:
        values = found.values(claim.table, claim.system, claim.measure)
        ours, met = 'not measured', False
        if len(values):
            met = float(f'{values.mean():.2e}') <= claim.published
            ours = spread(values) if met else f'**{spread(values)}**'
        reached += met
        minutes = '' if claim.table == last else _minutes(found, claim.table)
        rows[claim.same].append([claim.text, f'{claim.published:.3g}', claim.published_text, ours,
                                 claim.ours, str(len(values)), minutes])
        last = claim.table
    others = list(_other_pages(folder))
    reached += sum(met for met, _ in others)
    return render(PAGE, own=rows[False], same=[*rows[True], *(row for _, row in others)],
                  reached=reached, all=len(CLAIMS) + len(others), gymnasium=_gymnasium(found),
                  double=_mean(found, 'two_masses', '0.2', 'gauss4'),
                  machine=found.names('machine'), commit=found.names('commit'))


def _gymnasium(found: ResultTable) -> str:
    """Return the drifts of Gymnasium's steps from our starts."""
    drifts = (found.values('energy_drift', f'acrobot {dt}', 'Gymnasium rk4')
              for dt in ('0.2', '0.05', '0.01'))
    return ', '.join(f'{values.mean():.1e}' for values in drifts if len(values))


def _mean(found: ResultTable, table: str, system: str, measure: str) -> str:
    values = found.values(table, system, measure)
    return f'{values.mean():.3g}' if len(values) else 'not measured'


def _minutes(found: ResultTable, table: str) -> str:
    seconds = found.values(table, '', SECONDS)
    return f'{seconds.sum() / 60.0:.2g}' if len(seconds) else ''


def _other_pages(folder: Path) -> Iterator[tuple[bool, list[str]]]:
    """Yield the rows of published data sets on other pages, and whether they are reached."""
    for row in _json(folder / FOLDER / MACHINES):
        key = row['case'], row['measure'], row['model']
        if key in _MACHINES:
            text, by = _MACHINES[key]
            yield row['met'], [text, _numbers(row['reference']), by, _numbers(row['ours']),
                               f'`mechanical`, {row["model"]}', str(len(row['seeds'])), '']
    bodies = _json(folder / FOLDER / BODIES)
    for name, text in _BODIES.items():
        loss, seeds = bodies['test_loss'][name], bodies.get('seeds', {}).get(name, {})
        yield loss['met'], [f'{text}: test loss', f'{loss["published"]:.1e}', 'LieGroupHamDL',
                            f'{loss["ours"]:.1e}', '`lie_group`', str(len(seeds) + 1), '']
    # Not in a file: the table of docs/tutorials/emps_drive.md.
    yield False, ['EMPS, test record: error [mm]', '2.64', 'dynoNet', '**2.77**', '`emps_drive`',
                  '1', '2']


_MACHINES = {
    ('two-link arm that writes letters', 'valid prediction time [s], e and v', 'networks'):
        ('letters: valid prediction time [s], larger is better', 'structured HNN'),
    ('real actuated double pendulum', 'RMS error [rad] after 0.1 s, test', 'default'):
        ('C.1 double pendulum: error [rad] after 0.1 s', '12 parameters'),
    ('real actuated double pendulum', 'RMS error [rad] after 0.5 s, test', 'default'):
        ('error [rad] after 0.5 s', 'authors')}
_BODIES = {'turning_pendulum': 'pendulum as a rotation matrix', 'flying_quadrotor': 'quadrotor'}


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
