# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Page docs/accuracy-and-cost.md: what it says of the methods is computed from the rows."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
import math
from pathlib import Path
import shutil
from typing import Any

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.models.energy_error import EnergyError
import numpy as np
from studies.accuracy_scenes import picture_name, scene_page, shown, title
from studies.arguments import SCENES
from studies.explore_page import (
    FLOORS, read_floors, rows_of, write_explorer, write_floors)
from studies.measuring import StudyRow
from studies.references import ModelDiscrepancy, Reference
from studies.results import CSV, Results
from studies.work_precision_figure import draw
from studies.work_precision_report import (
    cheapest, circumstances, horizons_of, none_of, of_horizon, ours, peers, ratio)

PAGE, FOLDER = 'accuracy-and-cost.md', 'accuracy'
_PAPER, _CLASSIC = 'variational_euler', 'rk4'
_PEER_ERRORS = tuple(10.0 ** -k for k in range(3, 11))
_CHOICES = (1e-2, 1e-4, 1e-6, 1e-9)
_TEXT = """\
# What accuracy costs in time

Written by `ros2 run hnn_vi_ros work_precision --all`, from measurements on {machine}.
Every number in its sentences is computed from the tables. The same rows can be explored,
with a table of what to take for an error of your own: open [explore.html](accuracy/explore.html)
in a browser; it needs no network.

{measured}

A row is a method at one step size, run from the scene's initial state to a horizon T.

- Its *path error* is the global error: the largest component of (q, p) - reference, in SI units,
  at the instants T/10, ..., T.
- Its *energy band* is the largest abs(H - H0).
- Its time is the wall time per simulated second, on one core, compiled and warm.

The cheapest method at an error is the row that takes the least time among those with at most
that error. Times compare methods on one machine; for another machine read only the ratios. Peers
that choose their own steps are run at tolerances 1e-3 to 1e-13. Of their paths only the end is
compared, which is to their advantage.

## Which method to take

{choice}

{choices}

A cell is the cheapest of our methods and the microseconds it takes for a simulated second. 'none'
is where no row is good enough, of those that were run; '-' where the motion is chaotic and no path
can be followed.

{left_out}

## Where the first-order scheme loses

`variational_euler` is the method of the paper and the default. It is of order 1, and where an
exact path is wanted it pays for that:

{first_order}

What it keeps is the energy, for as long as it runs:

{first_order_energy}

Take it to see the paper's results, and where a bounded energy at few gradients a second is all
that is asked for.

## Where RK4 drifts

RK4 is cheap and of order 4, but neither symplectic nor symmetric: its energy drifts, and a longer
horizon makes that worse, while a symplectic method's band stays what it is:

{rk4}

## Against the peers

{peers}

## How good the learned H is

{learned}

## Scene by scene

Pictures, conditions, the cheapest methods at every error, and the energy of steps that are not
solved to round-off:

{scenes}

```{{toctree}}
:hidden:

{toctree}
```
"""


def write_page(folder: Path, docs: Path) -> list[Path]:
    """
    Write the page, its pictures and its tables.

    Parameters
    ----------
    folder : Path
        Holds the results of each of SCENES, in a folder of its name.
    docs : Path
        Where the page goes; pictures and tables into a folder beside it.

    Raises
    ------
    ParameterError
        A scene is not measured yet, or a file cannot be written.

    """
    results = {}
    for scene in SCENES:
        if not (folder / scene / CSV).is_file():
            raise ParameterError(f'{folder / scene}: no results; measure them with: '
                                 'ros2 run hnn_vi_ros work_precision --all')
        results[scene] = Results(folder / scene)
    try:
        (docs / FOLDER).mkdir(parents=True, exist_ok=True)
        written = [path for scene in SCENES for path in _write_scene(docs / FOLDER, scene,
                                                                     results[scene])]
        (docs / PAGE).write_text(as_page(results), encoding='utf-8')
        floors = write_floors(docs / FOLDER / FLOORS, results, {
            scene: shown(entry) for scene, entry in results.items()})
        return [docs / PAGE, *written, floors, write_explorer(docs / FOLDER)]
    except OSError as problem:
        raise _unwritable(docs, problem) from problem


def draw_again(docs: Path, scenes: Sequence[str] | None = None) -> list[Path]:
    """
    Draw the pictures, and the page to explore, of the rows that are there.

    Parameters
    ----------
    docs : Path
        Holds what ``write_page`` wrote.
    scenes : sequence of str, optional
        Those whose pictures are drawn; all if it is not given.

    Raises
    ------
    ParameterError
        The rows cannot be read, or a file cannot be written.

    """
    folder, written = docs / FOLDER, []
    try:
        for scene, floors in read_floors(folder)['scenes'].items():
            if scenes is not None and scene not in scenes:
                continue
            rows = rows_of(folder, scene)
            for horizon, floor in floors.items():
                written.append(draw(
                    folder / picture_name(scene, float(horizon)), title(scene, float(horizon)),
                    [row for row in rows if row.horizon == float(horizon)], *_levels(floor)))
        return [*written, write_explorer(folder)]
    except OSError as problem:
        raise _unwritable(docs, problem) from problem


def _levels(floor: Mapping[str, Any]) -> tuple[Reference, ModelDiscrepancy | None]:
    accuracy, nothing = floor['reference'], np.empty((0, 2))
    # Of a path that was verified, nothing but its accuracy is drawn.
    reference = Reference(nothing if accuracy is None else np.full((1, 2), math.inf),
                          math.inf if accuracy is None else accuracy, '', nothing)
    if floor['energy'] is None:
        return reference, None
    path, box = floor['path'], floor['box']
    return reference, ModelDiscrepancy(math.nan if path is None else path, floor['energy'],
                                       EnergyError(**box) if box else None)


def _unwritable(docs: Path, problem: OSError) -> ParameterError:
    return ParameterError(f'--docs {docs}: cannot be written ({problem.strerror}); '
                          'give a folder that can be written')


def as_page(results: Mapping[str, Results]) -> str:
    """Return the page; the results are those of each scene."""
    parts: dict[str, Callable] = {
        'measured': _measured, 'choice': _choice, 'choices': _choices, 'left_out': _left_out,
        'first_order': _first_order,
        'first_order_energy': _first_order_energy, 'rk4': _rk4, 'peers': _peers,
        'learned': _learned, 'scenes': _scenes, 'toctree': _toctree}
    machines = dict.fromkeys(entry.identity['machine'] for entry in results.values())
    return _TEXT.format(machine=' and '.join(machines),
                        **{name: '\n'.join(part(results)) for name, part in parts.items()})


def _measured(results: Mapping[str, Results]) -> Iterator[str]:
    """Name the commits that were measured; with the scenes, where these were not all the same."""
    found: dict[str, list[str]] = {}
    for name, entry in results.items():
        found.setdefault(' and '.join(entry.commits), []).append(name)
    if len(found) == 1:
        yield f'Commit: {next(iter(found))}.'
        return
    yield ('Not all scenes were measured at the same commit, nor on the same day: compare '
           'times within a scene and horizon only.')
    yield ''
    for commits, names in found.items():
        yield f'- {commits}: {", ".join(names)}.'


def _write_scene(folder: Path, scene: str, results: Results) -> Iterator[Path]:
    yield Path(shutil.copyfile(results.folder / CSV, folder / f'{scene}.csv'))
    for horizon in shown(results):
        yield draw(folder / picture_name(scene, horizon),
                   title(scene, horizon),
                   of_horizon(results, horizon), results.references[horizon],
                   results.model_errors.get(horizon))
    page = folder / f'{scene}.md'
    page.write_text(scene_page(scene, results), encoding='utf-8')
    yield page


def _left_out(results: Mapping[str, Results]) -> Iterator[str]:
    """Name the horizons that are not shown."""
    found: dict[float, list[str]] = {}
    for name, entry in results.items():
        for horizon in horizons_of(entry):
            if horizon not in shown(entry):
                found.setdefault(horizon, []).append(name)
    for horizon, names in found.items():
        yield (f'Of {", ".join(names)}, T = {horizon:g} s is not shown: most of the rows would '
               'take longer than the limit of the study.')


def _cases(results: Mapping[str, Results]) -> Iterator[tuple[str, float, list[StudyRow]]]:
    for name, entry in results.items():
        for horizon in shown(entry):
            yield name, horizon, of_horizon(entry, horizon)


def _has_paths(rows: list[StudyRow]) -> bool:
    return any(not math.isnan(row.path_error) for row in rows)


def _choice(results: Mapping[str, Results]) -> Iterator[str]:
    """Say how often each method is the cheapest."""
    for error in _CHOICES:
        best = [cheapest(ours(rows), error) for _, _, rows in _cases(results)
                if _has_paths(rows)]
        counts = Counter(row.method if row else 'none' for row in best)
        yield (f'- For a path error of {error:g}, of {len(best)} scenes and horizons: '
               + ', '.join(f'{method} {count}' for method, count in counts.most_common()) + '.')


def _choices(results: Mapping[str, Results]) -> Iterator[str]:
    yield '| scene | T [s] | ' + ' | '.join(f'{error:g}' for error in _CHOICES) + ' |'
    yield '|---' * (2 + len(_CHOICES)) + '|'
    for name, horizon, rows in _cases(results):
        cells = []
        for error in _CHOICES:
            row = cheapest(ours(rows), error)
            cells.append('-' if not _has_paths(rows) else none_of(ours(rows)) if row is None else
                         f'{row.method} {1e6 * row.seconds_per_simulated_second:.3g}')
        yield f'| {name} | {horizon:g} | {" | ".join(cells)} |'


def _first_order(results: Mapping[str, Results]) -> Iterator[str]:
    for name, horizon, rows in _cases(results):
        own = [row for row in rows if row.method == _PAPER and not math.isnan(row.path_error)]
        if horizon != horizons_of(results[name])[0] or not own:
            continue
        best = min(own, key=lambda row: row.path_error)
        other = cheapest((row for row in ours(rows) if row.method != _PAPER), best.path_error)
        if other is not None:
            yield (f'- {name}, T = {horizon:g} s: its best path error is {best.path_error:.2g}, '
                   f'with h = {best.step_size:.3g} s; {other.method} is as good with h = '
                   f'{other.step_size:.3g} s in {ratio(other, best):.2g} of the time.')
    wins = [f'{name} (T = {horizon:g} s, error {error:g})'
            for name, horizon, rows in _cases(results) for error in (1e-1, *_CHOICES)
            if (row := cheapest(ours(rows), error)) is not None and row.method == _PAPER]
    yield ('- It is the cheapest for ' + ', '.join(wins) + '.' if wins else
           '- It is the cheapest nowhere in these tables.')


def _growth(results: Results, method: str) -> tuple[StudyRow, StudyRow] | None:
    """Return the rows of one step at the shortest and the longest horizon it was run to."""
    finished = [row for row in results.rows if row.method == method and row.finished]
    for horizon in reversed(horizons_of(results)[1:]):
        late = [row for row in finished if row.horizon == horizon]
        if late:
            end = min(late, key=lambda row: row.energy_band)
            for row in finished:
                if row.horizon == horizons_of(results)[0] and row.step_size == end.step_size:
                    return row, end
    return None


def _first_order_energy(results: Mapping[str, Results]) -> Iterator[str]:
    for name, entry in results.items():
        found = _growth(entry, _PAPER)
        if found is not None:
            yield (f'- {name}, h = {found[0].step_size:.3g} s: a band of '
                   f'{found[0].energy_band:.2g} J over {found[0].horizon:g} s and of '
                   f'{found[1].energy_band:.2g} J over {found[1].horizon:g} s.')


def _rk4(results: Mapping[str, Results]) -> Iterator[str]:
    yield ('| scene | step [s] | T [s] | rk4 [J] | T [s] | rk4 [J] | cheapest that is as good '
           'at the longer T |')
    yield '|---' * 7 + '|'
    for name, entry in results.items():
        pairs = list(_drifting(entry))
        # The largest step, the smallest, and one between them.
        for row, end in [pairs[i] for i in sorted({0, len(pairs) // 2, len(pairs) - 1})
                         if pairs]:
            best = cheapest((other for other in ours(of_horizon(entry, end.horizon))
                             if other.method != _CLASSIC), end.energy_band, 'energy_band')
            verdict = '' if best is None else (
                f'{best.method}, h = {best.step_size:.3g} s, {ratio(best, end):.2g} of its time')
            yield (f'| {name} | {row.step_size:.3g} | {row.horizon:g} | {row.energy_band:.2g} | '
                   f'{end.horizon:g} | {end.energy_band:.2g} | {verdict} |')


def _drifting(results: Results) -> Iterator[tuple[StudyRow, StudyRow]]:
    """Yield rows of RK4 whose energy is ten times as far off, or more, at a longer horizon."""
    for row in results.rows:
        if row.method != _CLASSIC or row.horizon != horizons_of(results)[0] or row.failed:
            continue
        later = [end for end in results.rows if end.method == _CLASSIC and end.finished
                 and end.step_size == row.step_size and end.horizon > row.horizon
                 and end.horizon in shown(results)]
        if later and later[-1].energy_band > 10.0 * row.energy_band > 1e-10:
            yield row, later[-1]


def _peers(results: Mapping[str, Results]) -> Iterator[str]:
    lines = []
    for name, horizon, rows in _cases(results):
        if not peers(rows):
            continue
        ratios = {}
        # Where no path can be followed, energies are compared.
        column, what = ('path_error', 'path error') if _has_paths(rows) else (
            'energy_band', 'energy band [J]')
        for error in _PEER_ERRORS:
            best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
            if best and other:
                ratios[error] = ratio(best, other)
        cells = [f'{ratios[error]:.2g}' if error in ratios else '-' for error in _PEER_ERRORS]
        lines.append(f'| {name} | {horizon:g} | {what} | {" | ".join(cells)} |')
    if not lines:
        yield 'No peer was measured; `--peers` does that.'
        return
    yield ('The time of our cheapest method over that of the cheapest peer, by the error that is '
           'asked for; below 1, ours is faster; a dash: not reached by both.\n')
    yield '| scene | T [s] | error | ' + ' | '.join(f'{e:g}' for e in _PEER_ERRORS) + ' |'
    yield '|---' * (3 + len(_PEER_ERRORS)) + '|'
    yield from lines


def _learned(results: Mapping[str, Results]) -> Iterator[str]:
    for name, entry in results.items():
        for horizon in sorted({*entry.model_errors} & {*shown(entry)}):
            yield f'- {name}, T = {horizon:g} s: ' + ' '.join(
                line for line in circumstances(entry, horizon)[2:])


def _scenes(results: Mapping[str, Results]) -> Iterator[str]:
    for name, entry in results.items():
        horizons = ', '.join(f'{horizon:g}' for horizon in shown(entry))
        yield f'- [{name}]({FOLDER}/{name}.md), T = {horizons} s'


def _toctree(results: Mapping[str, Results]) -> Iterator[str]:
    for name in results:
        yield f'{name} <{FOLDER}/{name}>'
