# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on a work-precision study, as Markdown and pictures."""

from collections.abc import Iterable, Iterator, Sequence
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
from studies.measuring import StudyRow
from studies.pages import render
from studies.results import CSV, Results, ResultsFolder
from studies.work_precision_figure import draw

MARKDOWN = 'work_precision.md'
# For which the cheapest method is named.
ERRORS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10)


def write_report(results: ResultsFolder, name: str) -> list[Path]:
    """
    Write everything that is drawn and said of the rows; return the files.

    Parameters
    ----------
    results : ResultsFolder
        Results of one scene; at least one row.
    name : str
        Name of the scene.

    Raises
    ------
    ParameterError
        A file cannot be written.

    """
    folder, found = results.folder, results.horizons
    try:
        (folder / MARKDOWN).write_text(render(
            MARKDOWN, name=name, identity=results.identity, commits=results.commits,
            horizons=[conditions(results, horizon, picture_name('work_precision', horizon))
                      | {'every': list(_every(results.of(horizon)))}
                      for horizon in found], drift=_drift(results)), encoding='utf-8')
        pictures = [
            draw(folder / picture_name('work_precision', horizon),
                 f'{name}: cost of accuracy over {horizon:g} s', results.of(horizon),
                 results.floors[horizon]) for horizon in found]
    except OSError as problem:
        raise ParameterError(f'--out {folder}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem
    return [folder / CSV, folder / MARKDOWN, *pictures]


def picture_name(begin: str, horizon: float) -> str:
    """Return the file name of the picture of a horizon [s]."""
    return f'{begin}_{horizon:g}s.png'.replace('+', '')


def conditions(results: Results, horizon: float, picture: str = '') -> dict[str, Any]:
    """Return the template's values of a horizon: how it was measured, and the cheapest rows."""
    rows, floor = results.of(horizon), results.floors[horizon]
    runs = int(results.identity['number of --runs'])
    longest = {} if floor.model is None else _longest_steps(rows, floor.model.path)
    return {'horizon': horizon, 'picture': picture, 'floor': floor,
            'runs': runs if horizon == results.horizons[0] else min(3, runs),
            'longest': ', '.join(f'{method} {step:g} s' for method, step in longest.items()),
            'compared': 'path error' if has_paths(rows) else 'energy band',
            'peers': bool(peers(rows)), 'best': list(_best(rows))}


def _drift(results: Results) -> dict[str, Any]:
    """Return the energy bands of variants over the horizons, each with the method itself."""
    bands = {row.key: row.energy_band for row in results.rows if row.finished}
    horizons = results.horizons
    rows: list[list[str]] = []
    settings: dict[str, list[float]] = {}
    for row in results.rows:
        steps = settings.setdefault(row.method, []) if '@' in row.method else [row.step_size]
        if row.step_size not in steps:
            steps.append(row.step_size)
    for method, step in [
            (method, step) for method, steps in settings.items() for step in steps]:
        for name in (method, method.partition('@')[0]):
            cells = [_number(bands.get((name, step, horizon), math.nan)) for horizon in horizons]
            entry = [name, f'{step:g}', *cells]
            # Two variants share the method itself.
            if any(cells) and entry not in rows:
                rows.append(entry)
    return {'horizons': horizons, 'rows': rows}


def _longest_steps(rows: Iterable[StudyRow], error: float) -> dict[str, float]:
    """Return for each of our methods the longest step with at most this path error [s]."""
    longest: dict[str, float] = {}
    for row in ours(rows):
        if row.path_error <= error:
            longest[row.method] = max(row.step_size, longest.get(row.method, 0.0))
    return longest


def cheapest(rows: Iterable[StudyRow], error: float, column: str = 'path_error'
             ) -> StudyRow | None:
    """Return the fastest row with at most this error."""
    good = [row for row in rows if row.finished and getattr(row, column) <= error]
    return min(good, key=lambda row: row.seconds_per_simulated_second, default=None)


def ratio(row: StudyRow, other: StudyRow) -> float:
    """Return the time of a row over that of another."""
    return row.seconds_per_simulated_second / other.seconds_per_simulated_second


def ours(rows: Iterable[StudyRow]) -> list[StudyRow]:
    """Return the rows of our methods, solved to round-off, in double precision."""
    return [row for row in rows if row.is_ours]


def peers(rows: Iterable[StudyRow]) -> list[StudyRow]:
    """Return the rows of the peers."""
    return [row for row in rows if row.is_peer]


def has_paths(rows: Iterable[StudyRow]) -> bool:
    """Return whether any path could be followed."""
    return any(not math.isnan(row.path_error) for row in rows)


def _best(rows: Sequence[StudyRow]) -> Iterator[list[str]]:
    """Yield for each error the cheapest of our methods and the cheapest peer."""
    column, unit = ('path_error', '') if has_paths(rows) else ('energy_band', ' J')
    for error in ERRORS:
        best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
        cells = [f'{error:g}{unit}', *(
            [none_of(ours(rows)), '', ''] if best is None else
            [best.method, f'{best.step_size:g}', microseconds(best)])]
        if peers(rows):
            cells += [other.method if other else none_of(peers(rows)), microseconds(other),
                      f'{ratio(best, other):.2g}' if best and other else '']
        yield cells


def none_of(among: Sequence[StudyRow]) -> str:
    """Say that no row is good enough, and how many were not run."""
    left_out = sum(not row.was_run for row in among)
    return f'none ({left_out} not run)' if left_out else 'none'


def microseconds(row: StudyRow | None) -> str:
    """Return the time of a simulated second [us]; nothing without a row."""
    if row is None:
        return ''
    value = row.us_per_simulated_second
    return f'{value:.0f}' if value >= 100.0 else f'{value:.3g}'


def _every(rows: Iterable[StudyRow]) -> Iterator[list[str]]:
    """Yield every row, with those that failed and those that were not run."""
    for row in rows:
        yield [row.method, _number(row.step_size), _number(row.path_error),
               _number(row.energy_band), _number(row.us_per_simulated_second),
               _number(1e6 * row.p95_seconds), _number(row.gradients_per_simulated_second),
               row.status]


def _number(value: float) -> str:
    return '' if math.isnan(value) else f'{value:.3g}'
