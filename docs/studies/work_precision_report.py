# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on a work-precision study, as Markdown, pictures and a rerun recording."""

from collections.abc import Iterable, Sequence
import math
from pathlib import Path

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.models.energy_error import interval_text
from hnn_vi_ros.viewer.rerun_diagram import Curve, Diagram, record_diagrams
from studies.measuring import StudyRow, TOO_LONG
from studies.results import CSV, Results
from studies.work_precision_figure import draw, INK, is_peer, PANELS, series_of, STYLES

MARKDOWN, RECORDING = 'work_precision.md', 'work_precision.rrd'
# For which the cheapest method is named.
ERRORS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10)


def write_report(results: Results, name: str) -> list[Path]:
    """
    Write everything that is drawn and said of the rows; return the files.

    Parameters
    ----------
    results : Results
        Of one scene; at least one row.
    name : str
        Of the scene.

    Raises
    ------
    ParameterError
        A file cannot be written.

    """
    folder = results.folder
    try:
        (folder / MARKDOWN).write_text(as_markdown(results, name), encoding='utf-8')
        pictures = [
            draw(folder / picture_name(horizon), f'{name}: what accuracy costs over '
                 f'{horizon:g} s', of_horizon(results, horizon), results.references[horizon],
                 results.model_errors.get(horizon))
            for horizon in horizons_of(results)]
        (folder / RECORDING).unlink(missing_ok=True)
        record_diagrams(folder / RECORDING, f'work_precision_{name}', _diagrams(results))
    except OSError as problem:
        raise ParameterError(f'--out {folder}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem
    return [folder / CSV, folder / MARKDOWN, *pictures, folder / RECORDING]


def picture_name(horizon: float) -> str:
    """Return the file name of the picture of a horizon [s]."""
    return f'work_precision_{horizon:g}s.png'.replace('+', '')


def horizons_of(results: Results) -> list[float]:
    """Return the horizons that there are rows of, the shortest first."""
    return sorted({row.horizon for row in results.rows})


def of_horizon(results: Results, horizon: float) -> list[StudyRow]:
    """Return the rows of one horizon."""
    return [row for row in results.rows if row.horizon == horizon]


def as_markdown(results: Results, name: str) -> str:
    """Return the whole document."""
    parts = [f'# What accuracy costs: {name}\n', *[
        f'- {key}: {value}' for key, value in results.identity.items()],
        f'- commit: {", ".join(results.commits)}', '']
    horizons = horizons_of(results)
    for horizon in horizons:
        rows = of_horizon(results, horizon)
        parts += [f'## T = {horizon:g} s\n', f'![T = {horizon:g} s]({picture_name(horizon)})\n',
                  *[f'- {line}' for line in circumstances(results, horizon)], '',
                  best_table(rows), '### Every run\n', row_table(rows)]
    worse = drift_table(results)
    if worse:
        parts += ['## Steps that are not solved, gradients that are rounded\n',
                  'A band that grows with the horizon is a drift. The simulator takes none of '
                  'these steps.\n', worse]
    return '\n'.join(parts)


def drift_table(results: Results, most: int | None = None) -> str:
    """
    Return the energy bands of variants over the horizons, each beside the method itself.

    Parameters
    ----------
    results : Results
        Of a scene.
    most : int, optional
        Step sizes of each variant, evenly among those that are there; all by default.

    """
    bands = {row.key: row.energy_band for row in results.rows if row.finished}
    horizons = horizons_of(results)
    lines = ['| method | step [s] | ' + ' | '.join(
        f'energy band at T = {horizon:g} s [J]' for horizon in horizons) + ' |',
        '|---' * (2 + len(horizons)) + '|']
    settings: dict[str, list[float]] = {}
    for row in results.rows:
        steps = settings.setdefault(row.method, []) if '@' in row.method else [row.step_size]
        if row.step_size not in steps:
            steps.append(row.step_size)
    for method, step in [(method, step) for method, steps in settings.items()
                         for step in _spread(steps, most or len(steps))]:
        for name in (method, method.partition('@')[0]):
            cells = [_number(bands.get((name, step, horizon), math.nan)) for horizon in horizons]
            if any(cells):
                lines.append(f'| {" | ".join([name, f"{step:g}", *cells])} |')
    return '\n'.join(lines) + '\n' if settings else ''


def _spread(items: Sequence, most: int) -> list:
    """Return some of the items, evenly, the first and the last among them."""
    n = min(most, len(items))
    return [items[round(k * (len(items) - 1) / max(n - 1, 1))] for k in range(n)]


def circumstances(results: Results, horizon: float) -> list[str]:
    """Return sentences on how the rows of a horizon were measured, and on the learned H."""
    reference, model = results.references[horizon], results.model_errors.get(horizon)
    runs = int(results.identity['number of --runs'])
    times = runs if horizon == horizons_of(results)[0] else min(3, runs)
    lines = [f'Times: median and 95th percentile of {times} runs, after one that is not counted.']
    if reference.verified:
        lines.append(f'Reference: {reference.how}; good to {reference.accuracy:.1e}.')
    else:
        lines.append('Reference: none, for the motion is chaotic and cannot be followed so far: '
                     'only energies are compared.')
    if model is None:
        return lines
    if model.box is not None:
        lines.append('All over the box of its data, the learned H is off by '
                     f'{model.box.rms:.2g} J RMS ({interval_text(model.box.rms_interval)}) and '
                     f'{model.box.sup:.2g} J at most ({interval_text(model.box.sup_interval)}).')
    if math.isnan(model.path):
        return [*lines, f'The learned H is off by {model.energy:.2g} J in energy.']
    lines.append(f'The learned H itself is off by {model.path:.2g} along the path and '
                 f'{model.energy:.2g} J in energy: a smaller error of the integrator is wasted.')
    reaching = _longest_steps(of_horizon(results, horizon), model.path)
    if reaching:
        lines.append('Longest step that is as good as that: ' + ', '.join(
            f'{method} {step:g} s' for method, step in reaching.items()) + '.')
    return lines


def _longest_steps(rows: Iterable[StudyRow], error: float) -> dict[str, float]:
    """Return for each of our methods the longest step with at most this path error [s]."""
    longest: dict[str, float] = {}
    for row in rows:
        if row.path_error <= error and not is_peer(row.method) and '@' not in row.method:
            longest[row.method] = max(row.step_size, longest.get(row.method, 0.0))
    return longest


def cheapest(rows: Iterable[StudyRow], error: float, column: str = 'path_error'
             ) -> StudyRow | None:
    """Return the row that takes the least time among those with at most this error."""
    good = [row for row in rows if row.finished and getattr(row, column) <= error]
    return min(good, key=lambda row: row.seconds_per_simulated_second, default=None)


def ratio(row: StudyRow, other: StudyRow) -> float:
    """Return the time of a row over that of another."""
    return row.seconds_per_simulated_second / other.seconds_per_simulated_second


def ours(rows: Iterable[StudyRow]) -> list[StudyRow]:
    """Return the rows of our methods, solved to round-off, in double precision."""
    return [row for row in rows if not is_peer(row.method) and '@' not in row.method]


def peers(rows: Iterable[StudyRow]) -> list[StudyRow]:
    """Return the rows of the peers."""
    return [row for row in rows if is_peer(row.method)]


def best_table(rows: Sequence[StudyRow]) -> str:
    """Return for each error the cheapest of our methods and the cheapest peer."""
    column, unit = ('path_error', '') if any(
        not math.isnan(row.path_error) for row in rows) else ('energy_band', ' J')
    title = 'path error' if column == 'path_error' else 'energy band'
    with_peers = bool(peers(rows))
    head = f'| {title} | ours | step [s] | us a simulated second |'
    lines = [head + (' peer | us a simulated second | ours / peer |' if with_peers else ''),
             '|---' * (7 if with_peers else 4) + '|']
    for error in ERRORS:
        best, other = (cheapest(some, error, column) for some in (ours(rows), peers(rows)))
        cells = [f'{error:g}{unit}', *_cells(best, ours(rows))]
        if with_peers:
            cells += [other.method if other else none_of(peers(rows)), _microseconds(other),
                      f'{ratio(best, other):.2g}' if best and other else '']
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def _cells(row: StudyRow | None, among: Sequence[StudyRow]) -> list[str]:
    if row is None:
        return [none_of(among), '', '']
    return [row.method, f'{row.step_size:g}', _microseconds(row)]


def was_run(row: StudyRow) -> bool:
    """Return whether a row was measured, failed runs included, and not left for its time."""
    return not row.status.startswith(TOO_LONG)


def none_of(among: Sequence[StudyRow]) -> str:
    """Say that no row is good enough, and how many were not run."""
    left_out = sum(not was_run(row) for row in among)
    return f'none ({left_out} not run)' if left_out else 'none'


def _microseconds(row: StudyRow | None) -> str:
    return '' if row is None else f'{1e6 * row.seconds_per_simulated_second:.3g}'


def row_table(rows: Iterable[StudyRow]) -> str:
    """Return every row, with those that failed and those that were not run."""
    lines = ['| method | step [s] | path error | energy band [J] | us a simulated second | '
             '95th percentile | gradients a simulated second | status |', '|---' * 8 + '|']
    for row in rows:
        numbers = [_number(row.step_size), _number(row.path_error), _number(row.energy_band),
                   _number(1e6 * row.seconds_per_simulated_second),
                   _number(1e6 * row.p95_seconds), _number(row.gradients_per_simulated_second)]
        lines.append(f'| {" | ".join([row.method, *numbers, row.status])} |')
    return '\n'.join(lines) + '\n'


def _number(value: float) -> str:
    return '' if math.isnan(value) else f'{value:.3g}'


def _diagrams(results: Results) -> Iterable[Diagram]:
    for horizon in horizons_of(results):
        rows, model = of_horizon(results, horizon), results.model_errors.get(horizon)
        floors = {'path_error': model.path, 'energy_band': model.energy} if model else {}
        for panel in PANELS:
            curves = [_curve(name, line, panel.x, panel.y)
                      for name, line in series_of(rows).items()]
            yield Diagram(panel.y, panel.title, panel.x_label, panel.y_label, horizon,
                          [curve for curve in curves if curve.points],
                          floors.get(panel.y, math.nan),
                          best_table(rows))


def _curve(name: str, rows: Sequence[StudyRow], x: str, y: str) -> Curve:
    color = STYLES.get(name.partition('@')[0], (INK, ''))[0]
    return Curve(name, tuple(int(color[i:i + 2], 16) for i in (1, 3, 5)), [
        (getattr(row, x), getattr(row, y)) for row in rows
        if row.finished and getattr(row, x) > 0.0 and getattr(row, y) > 0.0])
