# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/accuracy-and-cost.md, computed from the rows."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.models import interval_text
from studies.explore_page import write_explorer
from studies.measuring import cheapest, StudyRow
from studies.pages import render
from studies.results import read_results, Results, unwritable
from studies.work_precision_figure import draw, draw_fronts

PAGE, FOLDER, PICTURE = 'accuracy-and-cost.md', 'accuracy', 'fronts.png'
_PAPER, _CLASSIC = 'variational_euler', 'rk4'
_ANSWERS = (1e-2, 1e-4, 1e-6, 1e-9)
_CHOICES = (1e-2, 1e-4, 1e-6, 1e-9)
# Errors at which our methods are compared with peers.
_COMPARED = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10)
# Longest horizon in the table of all scenes [s].
_LONGEST = 2000.0
# The page opens with it.
_EXAMPLE = 'pendulum'
_Results = Mapping[str, Results]


def write_pages(docs: Path) -> list[Path]:
    """
    Write the page, the pictures of each scene, and the page to explore.

    Parameters
    ----------
    docs : Path
        Folder of the page and of the results in ``FOLDER``.

    Raises
    ------
    ParameterError
        The results cannot be read, or a file cannot be written.

    """
    folder, results = docs / FOLDER, results_of(docs)
    try:
        (docs / PAGE).write_text(as_page(results), encoding='utf-8')
        entry = results[_example(results)]
        first = entry.shown[0]
        written = [docs / PAGE, draw_fronts(
            folder / PICTURE, f'Scene {_example(results)}, {first:g} s: smallest error of each '
            'group in a given time; lower left is better', entry.of(first), _answers(results),
            _own_error(entry, first))]
        for scene, entry in results.items():
            written += draw_pictures(folder, scene, entry)
        return [*written, write_explorer(folder)]
    except OSError as problem:
        raise unwritable(docs, problem) from problem


def results_of(docs: Path) -> dict[str, Results]:
    """Return the results of each scene of the page; see ``read_results``."""
    # The results of turning_costs are on another page.
    return {scene: entry for scene, entry in read_results(docs / FOLDER).items()
            if set(entry.identity) != {'machine'}}


def draw_pictures(folder: Path, scene: str, results: Results) -> list[Path]:
    """Draw the picture of each horizon that is shown of a scene; return the files."""
    return [draw(folder / picture_name(scene, horizon),
                 f'{scene}: accuracy and cost over {horizon:g} s', results.of(horizon),
                 results.floors[horizon]) for horizon in results.shown]


def picture_name(scene: str, horizon: float) -> str:
    """Return the file name of the picture of a scene and horizon [s]."""
    return f'{scene}_{horizon:g}s.png'.replace('+', '')


def as_page(results: _Results) -> str:
    """Return the page, from the results of each scene."""
    parts: dict[str, Callable[[_Results], Any]] = {
        'own_errors': _own_errors, 'choices': _choices, 'slower': _slower,
        'left_out': _left_out, 'first_order': _first_order, 'drifting': _drifting,
        'references': _references}
    name = _example(results)
    machines = dict.fromkeys(entry.identity['machine'] for entry in results.values())
    made = {name: part(results) for name, part in parts.items()}
    first = results[name].shown[0]
    return render(PAGE, machine=' and '.join(machines), example=name, picture=PICTURE,
                  horizon=first, own_error=_own_error(results[name], first),
                  choice_errors=_CHOICES, **{
                      name: list(part) if isinstance(part, Iterator) else part
                      for name, part in made.items()})


def _cheapest_pair(rows: Sequence[StudyRow], error: float
                   ) -> tuple[StudyRow | None, StudyRow | None]:
    """Return our fastest row and the fastest peer; in chaotic motion the error is of energy."""
    column = 'path_error' if _has_paths(rows) else 'energy_band'
    return cheapest(_ours(rows), error, column), cheapest(
        (row for row in rows if row.is_peer), error, column)


def _ratio(row: StudyRow, other: StudyRow) -> float:
    """Return the time of a row over that of another."""
    return row.seconds_per_simulated_second / other.seconds_per_simulated_second


def _ours(rows: Iterable[StudyRow]) -> list[StudyRow]:
    """Return the rows of our methods, solved to round-off, in double precision."""
    return [row for row in rows if row.is_ours]


def _has_paths(rows: Iterable[StudyRow]) -> bool:
    """Return whether any path could be followed."""
    return any(not math.isnan(row.path_error) for row in rows)


def _microseconds(row: StudyRow) -> str:
    """Return the time of a simulated second [us]."""
    value = row.us_per_simulated_second
    return f'{value:.0f}' if value >= 100.0 else f'{value:.3g}'


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


def _answers(results: _Results) -> list[StudyRow]:
    """Return our cheapest row in the example for each error wanted."""
    entry = results[_example(results)]
    rows = entry.of(entry.shown[0])
    found = (cheapest(_ours(rows), error) for error in _ANSWERS)
    return [best for best in found if best is not None]


def _own_error(entry: Results, horizon: float) -> float:
    """Return the error that the learned H causes by itself; NaN for an exact H."""
    model = entry.floors[horizon].model
    if model is None:
        return math.nan
    return model.path if _has_paths(entry.of(horizon)) else model.energy


def _own_errors(results: _Results) -> Iterator[list[str]]:
    """Yield a row for each learned scene and horizon: the cheapest method for its own error."""
    for name, horizon, rows in _cases(results):
        error = _own_error(results[name], horizon)
        best, other = _cheapest_pair(rows, error)
        if best is not None and other is not None:
            yield [name, f'{horizon:g}', f'{error:.2g}{"" if _has_paths(rows) else " J"}',
                   f'`{best.family}`, {best.setting("{:g} s")}', _microseconds(best),
                   f'{_ratio(best, other):.2f} ({other.family})']


def _cheapest_text(rows: list[StudyRow], error: float) -> str:
    """Return our cheapest method, its step, its microseconds, and its share of a peer's time."""
    best, other = _cheapest_pair(rows, error)
    if best is None:
        return 'none'
    text = f'{best.family} {best.setting("h={:.3g}")}: {_microseconds(best)}'
    return f'{text} ({_ratio(best, other):.2g})' if other else text


def _choices(results: _Results) -> list[list[str]]:
    return [[name, f'{horizon:g}{"" if _has_paths(rows) else ", chaotic"}',
             *(_cheapest_text(rows, error) for error in _CHOICES)]
            for name, horizon, rows in _cases(results) if horizon <= _LONGEST]


def _slower(results: _Results) -> dict[str, tuple[float, float, float]]:
    """Return the scenes in which a peer is faster: by how much at most, T and the error there."""
    found: dict[str, tuple[float, float, float]] = {}
    for name, horizon, rows in _cases(results):
        for error in (*_COMPARED, _own_error(results[name], horizon)):
            best, other = _cheapest_pair(rows, error)
            if best is not None and other is not None and _ratio(best, other) > 1.0:
                found[name] = max(found.get(name, (0.0,)), (_ratio(best, other), horizon, error))
    return found


def _first_order(results: _Results) -> list[dict[str, float]]:
    """Return for each scene the best path error of the paper's method, and an equal method."""
    found = []
    for name, horizon, rows in _cases(results):
        own = [row for row in rows if row.method == _PAPER and not math.isnan(row.path_error)]
        if horizon != results[name].horizons[0] or not own:
            continue
        best = min(own, key=lambda row: row.path_error)
        other = cheapest((row for row in _ours(rows) if row.method != _PAPER), best.path_error)
        if other is not None:
            found.append({'error': best.path_error, 'share': _ratio(other, best),
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


def _references(results: _Results) -> Iterator[list[str]]:
    """Yield for each scene and horizon its picture, the reference, and the errors of H."""
    for name, entry in results.items():
        for horizon in entry.shown:
            floor = entry.floors[horizon]
            reference = (f'{floor.how.partition(",")[0]}, {floor.accuracy:.1e}' if floor.verified
                         else 'none: chaotic')
            path, energy, box = '', '', ''
            if (model := floor.model) is not None:
                path = '' if math.isnan(model.path) else f'{model.path:.2g}'
                energy = f'{model.energy:.2g}'
                if model.box is not None:
                    box = (f'{model.box.rms:.2g} ({interval_text(model.box.rms_interval)}), '
                           f'{model.box.sup:.2g}')
            yield [f'[{name}]({FOLDER}/{picture_name(name, horizon)})', f'{horizon:g}', reference,
                   path, energy, box]
