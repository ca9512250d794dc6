# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/learning.md: every number in its tables comes from the results."""

from collections.abc import Iterator, Sequence
import csv
from dataclasses import astuple, dataclass, fields
import json
from pathlib import Path

from hnn_vi_ros.errors import ParameterError
import numpy as np
from studies.published_text import PAGE_TEXT, QUICK_TEXT

PAGE, FOLDER, CSV = 'learning.md', 'learning', 'published_tables.csv'
MACHINES = 'machines.json'
ROBOTS = 'robots.json'
REAL = 'real_pendulum'
SYSTEMS = {'mass_spring': 'mass-spring', 'pendulum': 'pendulum', 'two_body': 'two-body',
           REAL: 'real pendulum'}
# What the papers report, in their own units: by table, system and measure.
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


def write_results(folder: Path, results: Sequence[Result]) -> Path:
    """Write the table of every value; return the file."""
    path = folder / FOLDER / CSV
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(_COLUMNS)
        writer.writerows([f'{part:.6g}' if isinstance(part, float) else part
                          for part in astuple(result)] for result in results)
    return path


def read_results(folder: Path) -> list[Result]:
    """
    Read what ``write_results`` wrote.

    Raises
    ------
    ParameterError
        It is not there, or is something else.

    """
    path = folder / FOLDER / CSV
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
    machines = '\n'.join(_machines_table(folder / FOLDER / MACHINES))
    robots = '\n'.join(_robots_table(folder / FOLDER / ROBOTS))
    path.write_text(as_page(ResultTable(results), quick, machines, robots), encoding='utf-8')
    return path


def as_page(results: ResultTable, quick: bool, machines: str, robots: str) -> str:
    """Return the page."""
    return PAGE_TEXT.format(
        quick=QUICK_TEXT if quick else '', csv=f'{FOLDER}/{CSV}', machines=machines,
        robots=robots, machine=results.names('machine'), commit=results.names('commit'),
        summary=_summary(results),
        hnn_published='\n'.join(_published_table(results, 'hnn')),
        hnn_noise='\n'.join(_noise_table(results)),
        hnn_physics='\n'.join(_physics_table(results, 'hnn')),
        dgnet_published='\n'.join(_published_table(results, 'dgnet')),
        dgnet_physics='\n'.join(_physics_table(results, 'dgnet')),
        dissipative_published='\n'.join(_published_table(results, 'dissipative_hnn')),
        real_physics='\n'.join(_real_table(results)))


def _summary(results: ResultTable) -> str:
    """Say how many published numbers are reached."""
    found = [(results.values(*key), published) for key, published in PUBLISHED.items()]
    reached = [is_reached(values, published) for values, published in found if len(values)]
    first, mean = (sum(part) for part in zip(*reached, strict=True)) if reached else (0, 0)
    return (f'{len(reached)} of {len(PUBLISHED)} published errors are reproduced here: on the '
            f'published data ours are at or below {first} of them, in the mean over seeds {mean}.')


def _published_table(results: ResultTable, table: str) -> Iterator[str]:
    """Yield the published measures, ours beside them."""
    yield ('| system | measure | published | ours, the published data (seed 0) | '
           'ours, mean ± spread | seeds | at or below |')
    yield '|---' * 7 + '|'
    for (name, system, measure), published in PUBLISHED.items():
        values = results.values(name, system, measure)
        if name != table:
            continue
        if not len(values):
            yield f'| {SYSTEMS[system]} | {measure} | {published:.2e} | not measured | | | |'
            continue
        yield (f'| {SYSTEMS[system]} | {measure} | {published:.2e} | {values[0]:.2e} | '
               f'{spread(values)} | {len(values)} | {verdict(values, published)} |')


def _noise_table(results: ResultTable) -> Iterator[str]:
    """Yield what a test loss on noisy states can be at all."""
    yield ('| system | data | ours | the true H | the best function of a noisy state |')
    yield '|---' * 5 + '|'
    for system in results.systems('hnn'):
        rows = [results.values('hnn', system, measure) for measure in (
            'test loss', 'test loss of the true H', 'least test loss')]
        if all(len(values) for values in rows):
            for name, cells in (('seed 0', [f'{values[0]:.3e}' for values in rows]),
                                (f'{len(rows[0])} seeds', [spread(values) for values in rows])):
                yield f'| {SYSTEMS[system]} | {name} | {" | ".join(cells)} |'


def _physics_table(results: ResultTable, table: str) -> Iterator[str]:
    """Yield what a user of a model would ask for."""
    yield ('| system | field error without noise, RMS | energy error of H, RMS | '
           'path error, RMS | time [s] |')
    yield '|---' * 5 + '|'
    for system in results.systems(table):
        if system != REAL:
            cells = [spread(np.sqrt(results.values(table, system, 'field error'))),
                     spread(np.sqrt(results.values(table, system, 'true energy MSE'))),
                     spread(results.values(table, system, 'path error')),
                     f'{np.mean(results.values(table, system, "seconds")):.0f}']
            yield f'| {SYSTEMS[system]} | {" | ".join(cells)} |'


def _real_table(results: ResultTable) -> Iterator[str]:
    """Yield what the real pendulum's measure can be, and how far the path is off."""
    yield '| family | energy MSE | of a parabola fitted to the test | path error, RMS |'
    yield '|---' * 4 + '|'
    for table in ('dgnet', 'dissipative_hnn'):
        rows = [results.values(table, REAL, measure) for measure in (
            'published energy MSE', 'least energy MSE', 'path error')]
        if len(rows[0]):
            yield (f'| {table} | {spread(rows[0])} | {rows[1][0]:.2e} | {spread(rows[2])} |')


def _machines_table(path: Path) -> Iterator[str]:
    """Yield what was measured on machines."""
    if not path.is_file():
        yield 'Not measured.'
        return
    yield ('| machine | measure | model | others | target | ours, mean (worst of seeds) '
           '| baselines | met |')
    yield '|---' * 8 + '|'
    for row in json.loads(path.read_text(encoding='utf-8')):
        baselines = '; '.join(
            f'{name} {_numbers(values)}{_seeds(row["baseline_seeds"].get(name))}'
            for name, values in row['baselines'].items())
        count = len(row['seeds'])
        worst = f' ({_numbers(row["worst"])} of {count})' if count > 1 else _seeds(1)
        yield (f'| {row["case"]} | {row["measure"]} | {row["model"]} '
               f'| {_numbers(row["reference"])} | {_numbers(row["goal"])} '
               f'| {_numbers(row["ours"])}{worst} '
               f'| {baselines} | {"yes" if row["met"] else "**no**"} |')


def _robots_table(path: Path) -> Iterator[str]:
    """Yield what was identified of robots, and which networks the choice takes."""
    if not path.is_file():
        yield 'Not measured.'
        return
    yield '| robot | measure | model | others | ours | error in the choice | chosen |'
    yield '|---' * 7 + '|'
    for row in json.loads(path.read_text(encoding='utf-8')):
        choice = '' if row['choice'] is None else f'{row["choice"]:.3g}'
        yield (f'| {row["robot"]} | {row["measure"]} | `{row["model"]}` '
               f'| {_numbers(row["reference"])} | {_numbers(row["ours"])} | {choice} '
               f'| {"yes" if row["chosen"] else ""} |')


def _seeds(count: int | None) -> str:
    """Say how many seeds a mean is of, empty where there are none."""
    return '' if count is None else ' (one seed)' if count == 1 else f' ({count} seeds)'


def _numbers(values: list[float]) -> str:
    return ' '.join(f'{value:.3g}' for value in values)


def spread(values: np.ndarray) -> str:
    """Return mean and standard deviation, of one value itself."""
    if len(values) == 1:
        return f'{values[0]:.2e}'
    return f'{np.mean(values):.2e} ± {np.std(values, ddof=1):.1e}'


def is_reached(values: np.ndarray, published: float) -> tuple[bool, bool]:
    """Return whether the value of seed 0 and the mean are at or below a number, to its digits."""
    return tuple(float(f'{value:.2e}') <= published for value in (values[0], np.mean(values)))


def verdict(values: np.ndarray, published: float) -> str:
    """Say whether the value on the published data and the mean are at or below a number."""
    return {(True, True): 'yes', (True, False): 'on the published data only',
            (False, True): 'in the mean only', (False, False): '**no**',
            }[is_reached(values, published)]
