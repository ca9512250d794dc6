# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Page docs/accuracy-and-cost.md: what it says of the methods is computed from the rows."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
from studies.explore_page import read_cards, rows_of, write_cards, write_explorer
from studies.measuring import StudyRow
from studies.pages import render
from studies.results import Results, write_rows
from studies.work_precision_figure import draw
from studies.work_precision_report import (
    cheapest, conditions, drift, has_paths, none_of, ours, peers, picture_name, ratio)

PAGE, FOLDER = 'accuracy-and-cost.md', 'accuracy'
_PAPER, _CLASSIC = 'variational_euler', 'rk4'
_PEER_ERRORS = tuple(10.0 ** -k for k in range(3, 11))
_CHOICES = (1e-2, 1e-4, 1e-6, 1e-9)
# Step sizes of each variant that are shown.
_DRIFT_STEPS = 3
_Results = Mapping[str, Results]


def keep_results(docs: Path, results: _Results) -> None:
    """
    Keep results for the page; results of other scenes stay.

    Parameters
    ----------
    docs : Path
        Of the page.
    results : mapping of str to Results
        By scene.

    Raises
    ------
    ParameterError
        A file cannot be written, or what is there is damaged.

    """
    folder = docs / FOLDER
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for scene, entry in results.items():
            write_rows(folder / f'{scene}.csv', entry.rows)
        write_cards(folder, {scene: entry.card for scene, entry in results.items()})
    except OSError as problem:
        raise _unwritable(docs, problem) from problem


def write_pages(docs: Path) -> list[Path]:
    """
    Write the page, a page and pictures for each scene, and the page to explore.

    Parameters
    ----------
    docs : Path
        Holds what ``keep_results`` wrote.

    Raises
    ------
    ParameterError
        The rows cannot be read, or a file cannot be written.

    """
    folder = docs / FOLDER
    cards = read_cards(folder)
    found = {scene: Results.read(card, rows_of(folder, scene)) for scene, card in cards.items()}
    # Those of turning_costs are on another page.
    results = {scene: entry for scene, entry in found.items()
               if 'number of --runs' in entry.identity}
    try:
        (docs / PAGE).write_text(as_page(results), encoding='utf-8')
        written = [docs / PAGE]
        for scene, entry in results.items():
            page = folder / f'{scene}.md'
            page.write_text(scene_page(scene, entry), encoding='utf-8')
            written += [page, *draw_pictures(folder, scene, entry)]
        return [*written, write_explorer(folder)]
    except OSError as problem:
        raise _unwritable(docs, problem) from problem


def draw_pictures(folder: Path, scene: str, results: Results) -> list[Path]:
    """Draw the picture of each horizon that is shown of a scene; return the files."""
    return [draw(folder / picture_name(scene, horizon),
                 f'{scene}: what accuracy costs over {horizon:g} s', results.of(horizon),
                 results.floors[horizon]) for horizon in results.shown]


def _unwritable(docs: Path, problem: OSError) -> ParameterError:
    return ParameterError(f'--docs {docs}: cannot be written ({problem.strerror}); '
                          'give a folder that can be written')


def scene_page(name: str, results: Results) -> str:
    """Return the page of one scene."""
    return render('accuracy_scene.md', name=name, drift=drift(results, _DRIFT_STEPS), horizons=[
        conditions(results, horizon, picture_name(name, horizon)) for horizon in results.shown])


def as_page(results: _Results) -> str:
    """Return the page, from the results of each scene."""
    parts: dict[str, Callable[[_Results], Any]] = {
        'measured': _measured, 'choice': _choice, 'choices': _choices, 'left_out': _left_out,
        'first_order': _first_order, 'first_order_wins': _first_order_wins,
        'first_order_energy': _first_order_energy, 'drifting': _drifting, 'peers': _peers,
        'learned': _learned, 'scenes': _scenes}
    machines = dict.fromkeys(entry.identity['machine'] for entry in results.values())
    made = {name: part(results) for name, part in parts.items()}
    return render(PAGE, machine=' and '.join(machines), **{
        name: list(part) if isinstance(part, Iterator) else part for name, part in made.items()})


def _measured(results: _Results) -> dict[str, list[str]]:
    """Return the commits that were measured, with the scenes of each."""
    found: dict[str, list[str]] = {}
    for name, entry in results.items():
        found.setdefault(' and '.join(entry.commits), []).append(name)
    return found


def _left_out(results: _Results) -> dict[float, list[str]]:
    """Return the horizons that are not shown."""
    found: dict[float, list[str]] = {}
    for name, entry in results.items():
        for horizon in entry.horizons:
            if horizon not in entry.shown:
                found.setdefault(horizon, []).append(name)
    return found


def _cases(results: _Results) -> Iterator[tuple[str, float, list[StudyRow]]]:
    for name, entry in results.items():
        for horizon in entry.shown:
            yield name, horizon, entry.of(horizon)


def _choice(results: _Results) -> Iterator[tuple[float, int, list[str]]]:
    """Yield how often each method is the cheapest."""
    for error in _CHOICES:
        best = [cheapest(ours(rows), error) for _, _, rows in _cases(results) if has_paths(rows)]
        counts = Counter(row.method if row else 'none' for row in best)
        yield error, len(best), [f'{method} {count}' for method, count in counts.most_common()]


def _choices(results: _Results) -> dict[str, list]:
    table = []
    for name, horizon, rows in _cases(results):
        cells = [name, f'{horizon:g}']
        for error in _CHOICES:
            row = cheapest(ours(rows), error)
            cells.append('-' if not has_paths(rows) else none_of(ours(rows)) if row is None else
                         f'{row.method} {1e6 * row.seconds_per_simulated_second:.3g}')
        table.append(cells)
    return {'errors': [f'{error:g}' for error in _CHOICES], 'rows': table}


def _first_order(results: _Results) -> Iterator[tuple[str, float, StudyRow, StudyRow, float]]:
    for name, horizon, rows in _cases(results):
        own = [row for row in rows if row.method == _PAPER and not math.isnan(row.path_error)]
        if horizon != results[name].horizons[0] or not own:
            continue
        best = min(own, key=lambda row: row.path_error)
        other = cheapest((row for row in ours(rows) if row.method != _PAPER), best.path_error)
        if other is not None:
            yield name, horizon, best, other, ratio(other, best)


def _first_order_wins(results: _Results) -> Iterator[tuple[str, float, float]]:
    for name, horizon, rows in _cases(results):
        for error in (1e-1, *_CHOICES):
            row = cheapest(ours(rows), error)
            if row is not None and row.method == _PAPER:
                yield name, horizon, error


def _growth(results: Results, method: str) -> tuple[StudyRow, StudyRow] | None:
    """Return the rows of one step at the shortest and the longest horizon it was run to."""
    finished = [row for row in results.rows if row.method == method and row.finished]
    for horizon in reversed(results.horizons[1:]):
        late = [row for row in finished if row.horizon == horizon]
        if late:
            end = min(late, key=lambda row: row.energy_band)
            for row in finished:
                if row.horizon == results.horizons[0] and row.step_size == end.step_size:
                    return row, end
    return None


def _first_order_energy(results: _Results) -> Iterator[tuple[str, StudyRow, StudyRow]]:
    for name, entry in results.items():
        found = _growth(entry, _PAPER)
        if found is not None:
            yield name, *found


def _drifting(results: _Results
              ) -> Iterator[tuple[str, StudyRow, StudyRow, StudyRow | None, float]]:
    """Yield how the energy of RK4 drifts in each scene, and what is as good."""
    for name, entry in results.items():
        pairs = list(_drifts(entry))
        # The largest step, the smallest, and one between them.
        for row, end in [pairs[i] for i in sorted({0, len(pairs) // 2, len(pairs) - 1})
                         if pairs]:
            best = cheapest((other for other in ours(entry.of(end.horizon))
                             if other.method != _CLASSIC), end.energy_band, 'energy_band')
            yield name, row, end, best, math.nan if best is None else ratio(best, end)


def _drifts(results: Results) -> Iterator[tuple[StudyRow, StudyRow]]:
    """Yield rows of RK4 whose energy is ten times as far off, or more, at a longer horizon."""
    for row in results.rows:
        if row.method != _CLASSIC or row.horizon != results.horizons[0] or row.failed:
            continue
        later = [end for end in results.rows if end.method == _CLASSIC and end.finished
                 and end.step_size == row.step_size and end.horizon > row.horizon
                 and end.horizon in results.shown]
        if later and later[-1].energy_band > 10.0 * row.energy_band > 1e-10:
            yield row, later[-1]


def _peers(results: _Results) -> dict[str, list]:
    table = []
    for name, horizon, rows in _cases(results):
        if not peers(rows):
            continue
        # Where no path can be followed, energies are compared.
        column, what = ('path_error', 'path error') if has_paths(rows) else (
            'energy_band', 'energy band [J]')
        cells = [name, f'{horizon:g}', what]
        for error in _PEER_ERRORS:
            best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
            cells.append(f'{ratio(best, other):.2g}' if best and other else '-')
        table.append(cells)
    return {'errors': [f'{error:g}' for error in _PEER_ERRORS], 'rows': table}


def _learned(results: _Results) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, entry in results.items():
        for horizon in entry.shown:
            if entry.floors[horizon].model is not None:
                yield name, conditions(entry, horizon)


def _scenes(results: _Results) -> dict[str, list[str]]:
    return {name: [f'{horizon:g}' for horizon in entry.shown] for name, entry in results.items()}
