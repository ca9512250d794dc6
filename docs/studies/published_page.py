# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/learning.md, with all numbers of its tables from the results."""

from collections.abc import Iterable, Iterator, Sequence
import csv
from dataclasses import astuple, dataclass, fields
import json
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
import numpy as np
from studies.pages import render

PAGE, FOLDER, CSV = 'learning.md', 'learning', 'published_tables.csv'
PICTURE = 'published.png'
MACHINES = 'machines.json'
MACHINE_MODELS = ('default', 'networks', 'rigid body and networks', 'rigid body', 'plain network')
ROBOTS = 'robots.json'
REAL = 'real_pendulum'
SYSTEMS = {'mass_spring': 'mass-spring', 'pendulum': 'pendulum', 'two_body': 'two-body',
           REAL: 'real pendulum'}
# Numbers of the papers, in their own units: by table, system and measure.
PUBLISHED = {
    ('hnn', 'mass_spring', 'test loss'): 3.59e-2,
    ('hnn', 'mass_spring', 'published energy MSE'): 3.84e-4,
    ('hnn', 'pendulum', 'test loss'): 3.56e-2,
    ('hnn', 'pendulum', 'published energy MSE'): 2.49e-2,
    ('hnn', 'two_body', 'test loss'): 2.82e-6,
    ('hnn', 'two_body', 'published energy MSE'): 3.88e-5,
    ('dgnet', 'mass_spring', 'published energy MSE'): 6.17e-4,
    ('dgnet', 'pendulum', 'published energy MSE'): 1.08e-2,
    ('dgnet', 'two_body', 'published energy MSE'): 8.10e-5,
    ('dgnet', 'real_pendulum', 'published energy MSE'): 4.92e-4,
    ('dissipative_hnn', 'real_pendulum', 'published energy MSE'): 1.07e-3,
}


@dataclass(frozen=True)
class Result:
    """One value that was measured, with which commit and on which machine."""

    table: str
    system: str
    seed: int
    measure: str
    value: float
    commit: str
    machine: str


_COLUMNS = [field.name for field in fields(Result)]


class ResultTable:
    """
    Table of results, to be looked up.

    Parameters
    ----------
    results : sequence of Result
        In any order.

    """

    def __init__(self, results: Sequence[Result]):
        self._results = results

    def values(self, table: str, system: str, measure: str) -> np.ndarray:
        """Return the values of all seeds, in order of the seeds; empty if not measured."""
        found = {result.seed: result.value for result in self._results
                 if (result.table, result.system, result.measure) == (table, system, measure)}
        return np.array([found[seed] for seed in sorted(found)])

    def names(self, field: str) -> str:
        """Return the commits or machines of the results."""
        return ', '.join(dict.fromkeys(getattr(result, field) for result in self._results))

    def systems(self, table: str) -> list[str]:
        """Return the systems of a table, in the order of the page."""
        there = {result.system for result in self._results if result.table == table}
        return [name for name in SYSTEMS if name in there]


def write_results(folder: Path, results: Sequence[Result], name: str = CSV) -> Path:
    """Write the table of every value; return the file."""
    path = folder / FOLDER / name
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(_COLUMNS)
        writer.writerows([f'{part:.6g}' if isinstance(part, float) else part
                          for part in astuple(result)] for result in results)
    return path


def read_results(folder: Path, name: str = CSV) -> list[Result]:
    """
    Read the file of ``write_results``.

    Raises
    ------
    ParameterError
        It is not there, or is something else.

    """
    path = folder / FOLDER / name
    try:
        header, *lines = csv.reader(path.read_text(encoding='utf-8').splitlines())
        if header != _COLUMNS:
            raise ValueError(f'its columns are not {", ".join(_COLUMNS)}')
        return [Result(table, system, int(seed), measure, float(value), commit, machine)
                for table, system, seed, measure, value, commit, machine in lines]
    except (OSError, ValueError) as problem:
        raise ParameterError(f'{path}: cannot be read ({problem}); leave --page, to measure anew'
                             ) from problem


def write_page(folder: Path, results: Sequence[Result], quick: bool) -> Path:
    """Write the page; return the file."""
    path = folder / PAGE
    path.write_text(as_page(folder, results, quick), encoding='utf-8')
    draw(folder / FOLDER / PICTURE, results)
    return path


def draw(path: Path, results: Sequence[Result]) -> Path:
    """Draw our values (each seed and the mean) relative to the published values."""
    from matplotlib.figure import Figure
    table = ResultTable(results)
    figure = Figure(figsize=(8.0, 4.0), layout='constrained')
    axes = figure.subplots()
    names = []
    for (name, system, measure), published in PUBLISHED.items():
        ratios = table.values(name, system, measure) / published
        axes.plot(ratios, [len(names)] * len(ratios), 'o', color='#56b4e9', markersize=4)
        if len(ratios):
            axes.plot(ratios.mean(), len(names), 'D', color='#0072b2')
        names.append(f'{name}, {SYSTEMS[system]}: {measure.removeprefix("published ")}')
    axes.axvline(1.0, color='grey', linestyle=':', label='as accurate as published')
    axes.set(xscale='log', xlabel='our error over the published one: seeds, and their mean',
             yticks=range(len(names)), yticklabels=names)
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    figure.legend(loc='outside upper right', fontsize=9)
    figure.savefig(path, dpi=110)
    return path


def as_page(folder: Path, results: Sequence[Result], quick: bool = False) -> str:
    """Return the page, from results and from the folder's files on machines and robots."""
    table = ResultTable(results)
    return render(
        PAGE, quick=quick, machine=table.names('machine'), commit=table.names('commit'),
        summary=_summary(table), hnn_published=_published_rows(table, 'hnn'),
        dgnet_published=_published_rows(table, 'dgnet'),
        dissipative_published=_published_rows(table, 'dissipative_hnn'),
        machines=_once(machine_rows(folder / FOLDER / MACHINES)),
        robots=_once(robot_rows(folder / FOLDER / ROBOTS), shared=(3,)))


def _once(rows: Iterable[list[str]], shared: Sequence[int] = ()) -> list[list[str]]:
    """
    Return rows by subject and measure, without repeated cells.

    The columns ``shared`` are also blank where they repeat the row above.
    """
    groups: dict[tuple[str, str], list[list[str]]] = {}
    for row in rows:
        groups.setdefault((row[0], row[1]), []).append(row)
    found, subject = [], ''
    for (own, _), group in groups.items():
        before = ['' if own != subject else own, *[''] * len(group[0])]
        for row in group:
            found.append([
                '' if k in (0, 1, *shared) and cell == last else cell
                for k, (cell, last) in enumerate(zip(row, before, strict=False))])
            before = row
        subject = own
    return found


def _summary(results: ResultTable) -> dict[str, int]:
    """Count how many published numbers are reached."""
    found = [(results.values(*key), published) for key, published in PUBLISHED.items()]
    reached = [is_reached(values, published) for values, published in found if len(values)]
    first, mean = (sum(part) for part in zip(*reached, strict=True)) if reached else (0, 0)
    return {'measured': len(reached), 'all': len(PUBLISHED), 'first': first, 'mean': mean}


def _published_rows(results: ResultTable, table: str) -> list[list[str]]:
    """Return the published measures with ours, in bold where ours are larger."""
    rows = []
    for (name, system, measure), published in PUBLISHED.items():
        values = results.values(name, system, measure)
        if name == table:
            cells = ['not measured', '', '']
            if len(values):
                reached = is_reached(values, published)
                cells = [text if met else f'**{text}**' for text, met in zip(
                    (f'{values[0]:.2e}', spread(values)), reached, strict=True)]
                cells.append(str(len(values)))
            rows.append([SYSTEMS[system], measure, f'{published:.2e}', *cells])
    return rows


def machine_rows(path: Path) -> Iterator[list[str]]:
    """Yield a row for each measure of a machine, with targets that are missed in bold."""
    measures: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in _read(path):
        measures.setdefault((row['case'], row['measure']), []).append(row)
    for (case, measure), rows in measures.items():
        cells = {name: _numbers(values) for name, values in rows[0]['baselines'].items()} | {
            row['model']: _numbers(row['ours']) if row['met'] else f'**{_numbers(row["ours"])}**'
            for row in rows}
        yield [case, measure, _numbers(rows[0]['reference']),
               *(cells.get(name, '') for name in MACHINE_MODELS)]


def robot_rows(path: Path) -> Iterator[list[str]]:
    """Yield the rows of identified robots, with the chosen networks in bold."""
    for row in _read(path):
        model = f'`{row["model"]}`'
        yield [row['robot'], row['measure'], f'**{model}**' if row['chosen'] else model,
               _numbers(row['reference']), _numbers(row['ours'])]


def _read(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file, or none if it does not exist."""
    return json.loads(path.read_text(encoding='utf-8')) if path.is_file() else []


def _numbers(values: list[float]) -> str:
    return ', '.join(f'{value:.3g}' for value in values)


def spread(values: np.ndarray) -> str:
    """Return mean and standard deviation, of one value itself."""
    if len(values) == 1:
        return f'{values[0]:.2e}'
    return f'{np.mean(values):.2e} ± {np.std(values, ddof=1):.1e}'


def is_reached(values: np.ndarray, published: float) -> tuple[bool, bool]:
    """Return whether the value of seed 0 and the mean are at or below a number, to its digits."""
    return tuple(float(f'{value:.2e}') <= published for value in (values[0], np.mean(values)))
