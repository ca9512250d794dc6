# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/accuracy-and-cost.md, computed from the rows."""

from collections.abc import Callable, Iterator, Mapping
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
from studies.explore_page import read_cards, rows_of, write_cards, write_explorer
from studies.measuring import StudyRow
from studies.pages import render
from studies.results import Results, write_rows
from studies.work_precision_figure import draw, draw_fronts
from studies.work_precision_report import (
    cheapest, conditions, ERRORS, has_paths, microseconds, none_of, ours, peers, picture_name,
    ratio)

PAGE, FOLDER, PICTURE = 'accuracy-and-cost.md', 'accuracy', 'fronts.png'
_PAPER, _CLASSIC = 'variational_euler', 'rk4'
_ANSWERS = (1e-2, 1e-4, 1e-6, 1e-9)
_CHOICES = (1e-2, 1e-6, 1e-9)
# Longest horizon in the table of all scenes [s].
_LONGEST = 1000.0
# The page opens with it.
_EXAMPLE = 'pendulum'
_Results = Mapping[str, Results]


def keep_results(docs: Path, results: _Results) -> None:
    """
    Keep results for the page; results of other scenes stay.

    Parameters
    ----------
    docs : Path
        Folder of the page.
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
    # The results of turning_costs are on another page.
    results = {scene: entry for scene, entry in found.items()
               if 'number of --runs' in entry.identity}
    try:
        (docs / PAGE).write_text(as_page(results), encoding='utf-8')
        entry = results[_example(results)]
        first = entry.shown[0]
        written = [docs / PAGE, draw_fronts(folder / PICTURE, entry.of(first), _answers(results),
                                            _own_error(entry, first))]
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
                 f'{scene}: accuracy and cost over {horizon:g} s', results.of(horizon),
                 results.floors[horizon]) for horizon in results.shown]


def _unwritable(docs: Path, problem: OSError) -> ParameterError:
    return ParameterError(f'--docs {docs}: cannot be written ({problem.strerror}); '
                          'give a folder that can be written')


def scene_page(name: str, results: Results) -> str:
    """Return the page of one scene."""
    horizons = [conditions(results, horizon, picture_name(name, horizon))
                for horizon in results.shown]
    models = (at['floor'].model for at in horizons)
    return render('accuracy_scene.md', name=name, horizons=horizons,
                  box=next((model.box for model in models if model), None))


def as_page(results: _Results) -> str:
    """Return the page, from the results of each scene."""
    parts: dict[str, Callable[[_Results], Any]] = {
        'own_errors': _own_errors, 'choices': _choices, 'slower': _slower, 'left_out': _left_out,
        'first_order': _first_order, 'drifting': _drifting, 'scenes': _scenes}
    name = _example(results)
    machines = dict.fromkeys(entry.identity['machine'] for entry in results.values())
    made = {name: part(results) for name, part in parts.items()}
    first = results[name].shown[0]
    return render(PAGE, machine=' and '.join(machines), example=name, picture=PICTURE,
                  horizon=first, own_error=_own_error(results[name], first),
                  choice_errors=_CHOICES, **{
        name: list(part) if isinstance(part, Iterator) else part for name, part in made.items()})


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


def _example(results: _Results) -> str:
    """Return the scene with which the page opens."""
    return _EXAMPLE if _EXAMPLE in results else next(iter(results))


def _answers(results: _Results) -> list[tuple[float, StudyRow, StudyRow | None]]:
    """Return for each error wanted our cheapest row and the cheapest peer, in the example."""
    entry = results[_example(results)]
    rows = entry.of(entry.shown[0])
    found = [(error, cheapest(ours(rows), error), cheapest(peers(rows), error))
             for error in _ANSWERS]
    return [(error, best, other) for error, best, other in found if best is not None]


def _own_error(entry: Results, horizon: float, column: str = 'path_error') -> float:
    """Return the error that the learned H causes by itself; NaN for an exact H."""
    model = entry.floors[horizon].model
    if model is None:
        return math.nan
    return model.path if column == 'path_error' else model.energy


def _own_errors(results: _Results) -> Iterator[list[str]]:
    """Yield a row for each learned scene and horizon: the cheapest method for its own error."""
    for name, horizon, rows in _cases(results):
        column = 'path_error' if has_paths(rows) else 'energy_band'
        error = _own_error(results[name], horizon, column)
        best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
        if best is not None and other is not None:
            yield [name, f'{horizon:g}', f'{error:.2g}{"" if has_paths(rows) else " J"}',
                   f'`{best.method}`, {best.step_size:g} s', microseconds(best),
                   f'{ratio(best, other):.2f} ({other.method.partition(" tolerance=")[0]})']


def _cheapest_text(rows: list[StudyRow], error: float) -> str:
    """Return our cheapest method, its step, its microseconds, and its share of a peer's time."""
    column = 'path_error' if has_paths(rows) else 'energy_band'
    best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
    if best is None:
        return none_of(ours(rows))
    text = f'{best.method} h={best.step_size:.3g}: {microseconds(best)}'
    return f'{text} ({ratio(best, other):.2g})' if other else text


def _choices(results: _Results) -> list[list[str]]:
    return [[name, f'{horizon:g}{"" if has_paths(rows) else ", chaotic"}',
             *(_cheapest_text(rows, error) for error in _CHOICES)]
            for name, horizon, rows in _cases(results) if horizon <= _LONGEST]


def _slower(results: _Results) -> dict[str, float]:
    """Return the scenes in which a peer is faster, and by how much at most."""
    found: dict[str, float] = {}
    for name, horizon, rows in _cases(results):
        column = 'path_error' if has_paths(rows) else 'energy_band'
        for error in (*ERRORS, _own_error(results[name], horizon, column)):
            best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
            if best is not None and other is not None and ratio(best, other) > 1.0:
                found[name] = max(found.get(name, 0.0), ratio(best, other))
    return found


def _first_order(results: _Results) -> list[dict[str, float]]:
    """Return for each scene the best path error of the paper's method, and an equal method."""
    found = []
    for name, horizon, rows in _cases(results):
        own = [row for row in rows if row.method == _PAPER and not math.isnan(row.path_error)]
        if horizon != results[name].horizons[0] or not own:
            continue
        best = min(own, key=lambda row: row.path_error)
        other = cheapest((row for row in ours(rows) if row.method != _PAPER), best.path_error)
        if other is not None:
            found.append({'error': best.path_error, 'share': ratio(other, best),
                          'growth': _growth(results[name], _PAPER)})
    return found


def _growth(results: Results, method: str) -> float:
    """Return the growth factor of a step size's energy band, up to its longest horizon."""
    finished = [row for row in results.rows if row.method == method and row.finished]
    for horizon in reversed(results.horizons[1:]):
        late = [row for row in finished if row.horizon == horizon]
        if late:
            end = min(late, key=lambda row: row.energy_band)
            for row in finished:
                if row.horizon == results.horizons[0] and row.step_size == end.step_size:
                    return end.energy_band / row.energy_band
    return 1.0


def _drifting(results: _Results) -> list[float]:
    """Return the growth factor of RK4's band in each scene, with its middle step size."""
    pairs = [list(_drifts(entry)) for entry in results.values()]
    return [end.energy_band / row.energy_band
            for some in pairs for row, end in some[len(some) // 2:][:1]]


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


def _scenes(results: _Results) -> dict[str, list[str]]:
    return {name: [f'{horizon:g}' for horizon in entry.shown] for name, entry in results.items()}
