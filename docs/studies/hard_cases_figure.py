# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of hard cases: the error over a run, one panel per set-up, and all energy bands."""

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from textwrap import fill
from typing import Any

from hnn_vi_ros.commands.cost_figure import FAINT, INK, STYLES
from hnn_vi_ros.integrators import INTEGRATORS
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
import numpy as np
from studies.hard_cases_checks import LENGTH, RATE
from studies.hard_cases_plan import Case
from studies.hard_cases_results import CaseRow

_OTHER = ('#555555', '*')
_MARKS, _DPI, _COLUMNS, _PANELS = 6, 110, 2, 3
_ROUNDING = 1e-17
# Marks of the runs of each verdict, and their names.
_VERDICTS: dict[str, dict[str, Any]] = {
    'stable': {'marker': 'o', 'color': '#1b7f4d', 'markersize': 3.6},
    'alarm': {'marker': '^', 'color': '#c77700', 'markersize': 4.6},
    'stopped': {'marker': 's', 'color': '#5a5a8c', 'markersize': 4.0},
    'unstable': {'marker': 'X', 'color': '#c0143c', 'markersize': 6.0}}
_NAMES = {'stable': 'stable', 'alarm': 'an alarm was raised', 'stopped': 'stopped with an error',
          'unstable': 'failed without an alarm'}
# Parts of the bar of a method, with their names and colours: 'meant' are alarms and stops of cases
# that claim them.
_BARS = {'stable': ('stable', '#1b7f4d'),
         'meant': ('an alarm or a stop, as the case claims', '#8c7853'),
         'alarm': ('another alarm', '#c77700'), 'stopped': ('another stop', '#5a5a8c'),
         'unstable': ('failed without an alarm', '#c0143c')}
# Errors beyond this are drawn at it.
_CEILING = 1e6
_LABELS = {
    'dissipation': 'abs(H - exact H) [J]',
    'motion': 'largest abs(H - H0) of a block [J]',
    'counts': 'largest abs(H - H0) so far [J]',
    'books': 'largest abs(H - H0 - W) so far,\nrelative to the largest work or heat [1]',
    'paths': 'path error so far,\nrelative to the amplitude [1]',
    'constraint': 'largest error until t:\nlength [m], its rate [m/s]',
    'repeatability': 'largest difference of q or p [SI]',
}
# Checks with two curves: the legend of the second, dashed one, and the limits of both.
_SECOND = {
    'constraint': ('solid: length; dashed: its rate', (LENGTH, RATE)),
    'paths': ('solid: true; dashed: told by the run', ()),
    'repeatability': (
        'solid: repeated, and resumed midway;\ndashed: start with one rounding error', ()),
}
_LIMITS = ('limit of the length', 'limit of its rate')
# Below this a difference is drawn on a linear axis, on which 0 has a place.
_SMALLEST = 1e-16

# The end of a run that stopped: no method's own marker.
_STOPPED = 'stopped'
_END: dict[str, Any] = {'marker': 'P', 'color': INK, 'markersize': 11.0, 'linestyle': ''}


def draw_bands(path: Path, cases: Sequence[Case], rows: Sequence[CaseRow]) -> Path:
    """
    Draw the energy band of every run into a PNG file, one small panel per case with its methods.

    Parameters
    ----------
    path : Path
        Output file.
    cases : sequence of Case
        The panels.
    rows : sequence of CaseRow
        Their runs; those without a band are omitted.

    """
    rows = [row for row in rows if '@' not in row.method and row.band == row.band]
    cases = [case for case in cases if any(row.case == case.number for row in rows)]
    met = {case.number: [name for name in INTEGRATORS if any(
        (row.case, row.method) == (case.number, name) for row in rows)] for case in cases}
    lines = [cases[i:i + _PANELS] for i in range(0, len(cases), _PANELS)]
    most = [max(len(met[case.number]) for case in line) for line in lines]
    # In inches: a line of panels, its title and ticks; labels of methods; the whole picture.
    heights, label = [0.16 * number + 0.85 for number in most], 1.5
    width, height = 9.6, sum(heights) + 0.8
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor='white')
    FigureCanvasAgg(figure)
    for k, case in enumerate(cases):
        line, column = divmod(k, _PANELS)
        methods, panel = met[case.number], width / _PANELS
        # The panels of a line have their upper edges at one height.
        bottom = height - 0.1 - sum(heights[:line + 1]) + 0.16 * (most[line] - len(methods))
        ax = figure.add_axes((
            (column * panel + label) / width, bottom / height, (panel - label - 0.1) / width,
            0.16 * len(methods) / height), xscale='log', xlim=(_ROUNDING, _CEILING),
            ylim=(len(methods) - 0.5, -0.5))
        ax.set_title(fill(f'{case.number}. {case.title}', 44), fontsize=8.5, color=INK,
                     loc='right')
        ax.grid(color='#ececec', linewidth=0.6)
        ax.set_axisbelow(True)
        for verdict, style in _VERDICTS.items():
            ends = [(min(max(row.band, _ROUNDING), _CEILING), methods.index(row.method))
                    for row in rows if row.case == case.number and row.verdict == verdict]
            ax.plot(*np.reshape(ends, (-1, 2)).T, linestyle='', clip_on=False, **style)
        ax.set_xticks([1e-16, 1e-8, 1.0])
        ax.set_yticks(range(len(methods)), methods)
        ax.tick_params(labelsize=7.5, length=2.0)
        ax.minorticks_off()
        ax.spines[['top', 'right']].set_visible(False)
    figure.supxlabel(f'energy band of the run, largest abs(H - H0) [J]; above {_CEILING:g} J '
                     'drawn there', fontsize=9.0, color=INK, y=0.08 / height)
    figure.legend(handles=[Line2D([], [], label=_NAMES[verdict], linestyle='', **style)
                           for verdict, style in _VERDICTS.items()],
                  loc='upper center', ncols=4, fontsize=9.0, frameon=False)
    figure.savefig(path)
    return path


def draw_verdicts(path: Path, counts: Mapping[str, Mapping[str, int]]) -> Path:
    """
    Draw a bar for each method into a PNG file: its runs by verdict.

    Parameters
    ----------
    path : Path
        Output file.
    counts : mapping of str to mapping of str to int
        Number of runs of each part of ``_BARS``, by method.

    """
    figure = Figure(figsize=(7.4, 0.9 + 0.29 * len(counts)), dpi=_DPI, facecolor='white',
                    layout='constrained')
    FigureCanvasAgg(figure)
    ax, ends = figure.add_subplot(), np.zeros(len(counts))
    for verdict, (name, colour) in _BARS.items():
        lengths = np.array([own.get(verdict, 0) for own in counts.values()])
        bars = ax.barh(range(len(counts)), lengths, left=ends, height=0.74, label=name,
                       color=colour)
        ax.bar_label(bars, [str(length or '') for length in lengths], label_type='center',
                     color='white', fontsize=8.5)
        ends += lengths
    ax.set_yticks(range(len(counts)), counts)
    ax.set_xlabel('number of runs', color=INK)
    ax.set_ylim(len(counts) - 0.4, -0.6)
    ax.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside upper center', ncols=3, fontsize=8.5, frameon=False,
                  handlelength=1.0, columnspacing=1.2)
    figure.savefig(path)
    return path


def draw_case(path: Path, case: Case, rows: Sequence[CaseRow]) -> Path:
    """
    Draw the errors of a case's rows into a PNG file.

    Parameters
    ----------
    path : Path
        Output file.
    case : Case
        Whose set-ups are the panels.
    rows : sequence of CaseRow
        All of this case.

    """
    panels = list(dict.fromkeys((row.hamiltonian, row.set_up) for row in rows))
    columns = min(_COLUMNS, len(panels))
    lines = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(6.2 * columns + 2.0, 3.1 * lines + 0.9), dpi=_DPI,
                    facecolor='white', layout='constrained')
    FigureCanvasAgg(figure)
    figure.suptitle(f'Case {case.number}: {case.title}', fontsize=13, color=INK)
    grid = np.atleast_1d(figure.subplots(lines, columns, squeeze=False)).ravel()
    for ax in grid[len(panels):]:
        ax.set_visible(False)
    # One kind of time axis in all panels.
    spans = [[row.t[-1] for row in rows if row.t and (row.hamiltonian, row.set_up) == panel]
             for panel in panels]
    log = case.check != 'motion' or any(
        len(ends) > 0 and max(ends) > 100.0 * min(ends) for ends in spans)
    for ax, (hamiltonian, set_up) in zip(grid, panels, strict=False):
        title = ', '.join(part for part in (f'{hamiltonian} H', set_up) if part)
        _draw_panel(ax, case, title, [row for row in rows if (row.hamiltonian, row.set_up)
                                      == (hamiltonian, set_up)], log)
    handles = [_handle(method, _note(case, method, rows))
               for method in dict.fromkeys(row.method for row in rows if row.t)]
    if any(row.t and row.verdict == _STOPPED for row in rows):
        handles.append(Line2D([], [], label='stopped: a step failed', **_END))
    title, _ = _SECOND.get(case.check, (None, ()))
    legend = figure.legend(handles=handles, loc='outside right center', frameon=False,
                           fontsize=8.5, title=title, title_fontsize=8.5)
    legend.set_alignment('left')
    figure.savefig(path, dpi=_DPI)
    return path


def _style(method: str) -> dict[str, object]:
    base, _, variant = method.partition('@')
    color, marker = STYLES.get(base, _OTHER)
    return {'color': color, 'marker': marker, 'markersize': 5.0, 'linewidth': 1.1,
            'linestyle': ':' if variant else '-',
            'markerfacecolor': 'white' if variant else color}


def _handle(method: str, note: str) -> Line2D:
    return Line2D([], [], label=f'{method}{note}', **_style(method))


def _note(case: Case, method: str, rows: Sequence[CaseRow]) -> str:
    """Return the reason that a method has no curve in some panels."""
    own = [row for row in rows if row.method == method]
    if case.check == 'dissipation' and not any(any(row.error) for row in own):
        return ' (the reference)'
    found = {row.hamiltonian for row in own}
    if len({row.hamiltonian for row in rows}) == 1 or len(found) > 1:
        return ''
    return f' ({found.pop()} H only)'


def _draw_panel(ax: Axes, case: Case, title: str, rows: Sequence[CaseRow], log: bool) -> None:
    ax.set_title(title, fontsize=10, color=INK)
    ax.set(yscale='log', xlabel='t [s]', ylabel=_LABELS[case.check])
    ax.grid(which='major', color='#e3e3e3', linewidth=0.7)
    ax.spines[['top', 'right']].set_visible(False)
    drawn = False
    for k, row in enumerate(rows):
        if not row.t:
            continue
        t, error = np.array(row.t), np.minimum(np.array(row.error), _CEILING)
        if case.check != 'repeatability':
            # No error at all has no place on a logarithmic axis.
            error[error == 0.0] = math.nan
        # Markers at different places on each line, so that overlapping lines can be distinguished.
        step = max(1, t.size // _MARKS)
        ax.plot(t, error, markevery=(k * step // max(len(rows), 1), step), **_style(row.method))
        if row.other:
            other = np.minimum(row.other, _CEILING)
            other[(other == 0.0) & (case.check != 'repeatability')] = math.nan
            ax.plot(t, other, **_style(row.method) | {
                'linestyle': '--', 'marker': ''})
        drawn = True
        if row.verdict == _STOPPED:
            ax.plot(t[-1], error[-1], **_END)
    if not drawn:
        _say_stops(ax, rows)
        return
    if log:
        ax.set_xscale('log')
    if case.check == 'repeatability':
        ax.set_yscale('symlog', linthresh=_SMALLEST)
        ax.set_ylim(bottom=-0.5 * _SMALLEST)
        ax.yaxis.get_major_locator().set_params(numticks=8)
    for limit, name in zip(_SECOND.get(case.check, ('', ()))[1], _LIMITS, strict=False):
        ax.axhline(limit, color=FAINT, linewidth=1.0, linestyle=':')
        ax.annotate(name, (0.01, limit), xycoords=('axes fraction', 'data'), xytext=(0, 2),
                    textcoords='offset points', fontsize=8, color=FAINT)
    low, high = ax.get_ylim()
    if case.check == 'motion' and high < 10.0 * low:
        # A logarithmic axis without a power of ten has no readable ticks.
        ax.set_yscale('linear')


def _say_stops(ax: Axes, rows: Sequence[CaseRow]) -> None:
    """State where each run stopped, in a panel without curves."""
    ax.grid(visible=False)
    ax.minorticks_off()
    ax.set(xticks=[], yticks=[], xlabel='', ylabel='')
    ax.spines[:].set(visible=True, color='#e3e3e3')
    ax.text(0.5, 0.5, '\n\n'.join(f'{row.method} stopped:\n{fill(row.alarm, 64)}' for row in rows),
            transform=ax.transAxes, ha='center', va='center', fontsize=10, color=INK)
