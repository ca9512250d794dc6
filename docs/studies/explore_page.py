# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page docs/evidence/accuracy/explore.html: an offline explorer of the rows of every scene."""

from importlib.util import find_spec
import json
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import ParameterError
from studies.measuring import StudyRow
from studies.results import read_results
from studies.work_precision_figure import group_of, line_style, series_of

EXPLORER = 'explore.html'
_TEMPLATE = Path(__file__).parent / 'templates' / 'explore.html'
# Plotly's names for the markers of matplotlib.
_SYMBOLS = {'o': 'circle', '<': 'triangle-left', '>': 'triangle-right', 'x': 'x-thin',
            's': 'square', 'D': 'diamond', '^': 'triangle-up', 'p': 'pentagon',
            'v': 'triangle-down', 'd': 'diamond-tall', 'X': 'x', 'P': 'cross', '*': 'star',
            'h': 'hexagon', 'H': 'hexagon2', '8': 'octagon'}
_COLUMNS = ('step_size', 'horizon', 'path_error', 'energy_band', 'us_per_simulated_second',
            'gradients_per_simulated_second')


def write_explorer(folder: Path) -> Path:
    """
    Write one self-contained page with plotly.js and every row.

    Parameters
    ----------
    folder : Path
        Contains the results; the page is written here.

    Raises
    ------
    ParameterError
        The package plotly is not installed.

    """
    text = _TEMPLATE.read_text(encoding='utf-8')
    # A '<' occurs in strings of the JSON only, where it could end the script that holds it.
    data = json.dumps(page_data(folder), separators=(',', ':'), allow_nan=False)
    parts = (('/*DATA*/', data.replace('<', '\\u003c')), ('/*PLOTLY*/', _plotly()))
    for mark, part in parts:
        before, _, after = text.partition(mark)
        text = before + part + after
    path = folder / EXPLORER
    path.write_text(text, encoding='utf-8')
    return path


def page_data(folder: Path) -> dict[str, Any]:
    """
    Return the data of the page: rows by scene, and the style of each line.

    Raises
    ------
    ParameterError
        The results cannot be read.

    """
    found = read_results(folder)
    rows = {scene: results.rows for scene, results in found.items()}
    names = list(dict.fromkeys(row.method for entry in rows.values() for row in entry))
    lines = list(dict.fromkeys(line for entry in rows.values() for line in series_of(entry)))
    return {
        'machine': ' and '.join(dict.fromkeys(
            results.identity['machine'] for results in found.values())),
        'commits': ', '.join(dict.fromkeys(
            commit for results in found.values() for commit in results.commits)),
        'count': sum(map(len, rows.values())),
        'methods': [{'name': name, 'line': name.partition(' tolerance=')[0]} for name in names],
        'lines': {name: _line_style(name) for name in lines},
        'scenes': {scene: {
            'horizons': {repr(horizon): {key: floor.as_json()[key]
                                         for key in ('reference', 'path', 'energy')}
                         for horizon, floor in found[scene].floors.items()
                         if horizon in found[scene].shown},
            'rows': [_as_list(row, names.index(row.method)) for row in entry]}
            for scene, entry in rows.items()}}


def _line_style(name: str) -> dict[str, str]:
    style, group = line_style(name), group_of(name)
    return {'color': style['color'],
            'symbol': _SYMBOLS[style['marker']] + ('' if group == 'ours' else '-open'),
            'dash': {'ours': 'solid', 'peers': 'dash'}[group],
            'group': group}


def _as_list(row: StudyRow, method: int) -> list[Any]:
    return [method, *(_or_none(getattr(row, column)) for column in _COLUMNS), row.status]


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plotly() -> str:
    """Return plotly.js from the files of the package, because its import takes seconds."""
    spec = find_spec('plotly')
    if spec is None or not spec.submodule_search_locations:
        raise ParameterError(f'{EXPLORER} needs the package plotly, which is not installed: '
                             'pip install plotly')
    script = Path(spec.submodule_search_locations[0]) / 'package_data' / 'plotly.min.js'
    return script.read_text(encoding='utf-8')
