# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a work-precision study: small multiples, distinguishable in grey."""

from collections.abc import Callable, Iterable, Sequence
import math
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.commands.cost_figure import FAINT, INK, Label, label_front, STYLES
from hnn_vi_ros.models import EnergyError
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np
from PIL import Image
from studies.measuring import StudyRow
from studies.references import Floor

# Colour and marker of the peers.
_PEERS = {
    'scipy DOP853': ('#1b7f5c', 'o'), 'scipy RK45': ('#63b995', 's'),
    'torchdiffeq dopri5': ('#a8623a', '^'), 'torchdiffeq dopri8': ('#7a3e1d', 'v'),
    'torchdiffeq rk4': ('#c99672', 'X'),
    'diffrax Tsit5': ('#6c757d', 'D'), 'diffrax Dopri8': ('#343a40', 'P'),
    'diffrax SemiImplicitEuler': ('#adb5bd', 'o'),
    'RK4 on quaternions': ('#2f2f2f', 'X'),
    'MuJoCo RK4': ('#b23a48', 'D'), 'MuJoCo implicitfast': ('#d98893', 'd'),
}
_OTHER = ('#555555', '*')
# Larger errors say only that the run is lost.
_LOST = 100.0
# A page shows a picture about as wide as this [inch], so texts keep their size on it.
_DPI, _WIDTH, _COLOURS = 125, 8.6, 128
# Heights: the title of a panel, all panels beside their legend, ticks with their label; margins
# above and below [inch].
_TITLE, _PANELS, _TICKS, _TOP, _BOTTOM = 0.3, 7.8, 0.5, 0.35, 0.6
_FLOORS = {'path_error': 'path', 'energy_band': 'energy'}
_EPS = float(np.finfo(np.float64).eps)


# Groups of the first picture of the page: label, style, and filter of rows.
_FRONTS: tuple[tuple[str, dict[str, Any], Callable[[StudyRow], bool]], ...] = (
    ('ours, the fastest', {'color': '#0b5fa5', 'marker': 'o', 'linewidth': 2.2},
     lambda row: row.is_ours),
    ("the paper's, variational_euler", {'color': '#c0392b', 'marker': 's'},
     lambda row: row.method == 'variational_euler'),
    *((f'{name}, the fastest', {'color': color, 'marker': marker, 'linestyle': (0, (5, 2))},
       lambda row, name=name: row.method.startswith(f'{name} '))
      for name, color, marker in (('diffrax', '#343a40', 'P'), ('scipy', '#1b7f5c', '^'),
                                  ('torchdiffeq', '#a8623a', 'v'))))


class Panel(NamedTuple):
    """Panel of a figure: two columns of StudyRow, and their labels."""

    x: str
    y: str
    title: str
    x_label: str
    y_label: str


_TIME = 'us_per_simulated_second', 'time [us per simulated second]'
PATHS = Panel(_TIME[0], 'path_error', 'Path error', _TIME[1],
              'path error, largest component\n'
              r'$\|(q, p) - \mathrm{reference}\|_\infty$ [SI units]')
ENERGIES = Panel(_TIME[0], 'energy_band', 'Energy error', _TIME[1],
                 'energy band, largest $|H - H_0|$ [J]')


def series_of(rows: Iterable[StudyRow]) -> dict[str, list[StudyRow]]:
    """Return the rows that make a line each; the tolerances of a peer are one line."""
    series: dict[str, list[StudyRow]] = {}
    for row in rows:
        series.setdefault(row.family, []).append(row)
    return series


def panels_of(rows: Sequence[StudyRow]) -> list[Panel]:
    """Return the panels of a figure; without paths where none is known."""
    paths = any(row.finished and not math.isnan(row.path_error) for row in rows)
    return [PATHS] * paths + [ENERGIES]


def is_peer(name: str) -> bool:
    """Return whether a line is a peer's, not one of ours, whose names have no spaces."""
    return ' ' in name


def group_of(name: str) -> str:
    """Return the group of a line: a peer's, or ours."""
    return 'peers' if is_peer(name) else 'ours'


def line_style(name: str) -> dict[str, Any]:
    """Return the style of a line: its own colour and mark, the dash of its group."""
    color, marker = {**STYLES, **_PEERS}.get(name, _OTHER)
    group = group_of(name)
    return {'color': color, 'marker': marker, 'markersize': 8.0 if marker == '*' else 6.0,
            'linestyle': {'ours': '-', 'peers': (0, (5, 2))}[group],
            'linewidth': 1.6 if group == 'ours' else 1.2, 'markeredgecolor': color,
            'markerfacecolor': color if group == 'ours' else 'white', 'markeredgewidth': 1.0}


def draw(path: Path, title: str, rows: Sequence[StudyRow], known: Floor) -> Path:
    """
    Draw the rows of one horizon into a PNG file: errors against time, panel below panel.

    Parameters
    ----------
    path : Path
        Output file.
    title : str
        Above all panels.
    rows : sequence of StudyRow
        All of one horizon.
    known : Floor
        Below whose accuracy no path error is known; what a learned H is off by is a floor too.

    """
    series, panels = series_of(rows), panels_of(rows)
    size = _PANELS / len(panels)
    height = _TOP + len(panels) * (_TITLE + size + _TICKS) + _BOTTOM
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, facecolor='white')
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, color=INK, y=1.0 - 0.15 / height)
    for k, panel in enumerate(panels):
        top = height - _TOP - k * (_TITLE + size + _TICKS) - _TITLE
        floor = getattr(known.model, _FLOORS[panel.y]) if known.model else math.nan
        ax = figure.add_axes((0.95 / _WIDTH, (top - size) / height, 4.9 / _WIDTH,
                              size / height))
        ax.tick_params(labelsize=8.5)
        _begin_panel(ax, panel, _limits_of(panel, rows, floor))
        _draw_lines(ax, panel, series)
        _draw_levels(ax, panel, floor, known)
        # The panels have the same lines and share a legend.
        if k == 0:
            ax.legend(handles=_handles(series), loc='upper left', frameon=False, fontsize=8.0,
                      bbox_to_anchor=(1.01, 1.02))
    figure.legend(handles=_common_handles(known), loc='lower center', frameon=False,
                  fontsize=8.5, ncols=2)
    figure.savefig(path, dpi=_DPI)
    # A third of the size. By coverage, not by count: a thin line keeps its own colour.
    with Image.open(path) as picture:
        small = picture.convert('RGB').quantize(
            _COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    return path


def draw_fronts(path: Path, title: str, rows: Sequence[StudyRow], answers: Iterable[StudyRow],
                floor: float) -> Path:
    """
    Draw the least path error that each group of rows reaches in a time, into a PNG file.

    Parameters
    ----------
    path : Path
        Output file.
    title : str
        Above the panel.
    rows : sequence of StudyRow
        All of one horizon.
    answers : iterable of StudyRow
        Rows that are named in the picture.
    floor : float
        Path error that the learned H causes by itself; NaN for an exact H.

    """
    figure = Figure(figsize=(_WIDTH, 4.6), dpi=_DPI, facecolor='white', layout='constrained')
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    ax.set_title(title, fontsize=11.5, loc='left', color=INK)
    for label, style, belongs in _FRONTS:
        front = _front([row for row in rows if belongs(row)])
        ax.plot(*np.array(front).reshape(-1, 2).T, label=label, markersize=5.0, **style)
    for best in answers:
        ax.annotate(f'{best.family}, {best.setting("{:.3g} s")}',
                    (best.us_per_simulated_second, best.path_error), xytext=(-7, 0),
                    textcoords='offset points', ha='right', va='center', fontsize=9.0, color=INK,
                    zorder=6, bbox={'facecolor': '#fbf9f3', 'edgecolor': 'none', 'pad': 0.5})
    ax.set(xscale='log', yscale='log', xlabel=_TIME[1],
           ylabel='path error, largest component [SI units]')
    # Room for the names, to the left of the first line, and for the legend.
    ax.set(xlim=(ax.get_xlim()[0] / 4.0, None), ylim=(ax.get_ylim()[0] / 30.0, ax.get_ylim()[1]))
    if not math.isnan(floor):
        _draw_floor(ax, floor)
        # To the left, where no line is.
        ax.annotate(f'error of the learned H: {floor:.2g}\nsmaller errors are of no use',
                    (0.01, floor), xycoords=('axes fraction', 'data'), xytext=(0, -3),
                    textcoords='offset points', va='top', fontsize=9.0, color=INK)
    ax.grid(which='major', color='#e3e3e3', linewidth=0.7)
    ax.spines[['top', 'right']].set_visible(False)
    ax.legend(frameon=False, fontsize=9.0, loc='lower left')
    figure.savefig(path)
    return path


def _front(rows: Iterable[StudyRow]) -> list[tuple[float, float]]:
    """Return time and error of the rows that no faster one beats."""
    points: list[tuple[float, float]] = []
    for row in sorted((row for row in rows if row.finished and row.path_error > 0.0),
                      key=lambda row: row.seconds_per_simulated_second):
        if not points or row.path_error < points[-1][1]:
            points.append((row.us_per_simulated_second, row.path_error))
    return points


def _limits_of(panel: Panel, rows: Sequence[StudyRow], floor: float
               ) -> tuple[float, float, float, float] | None:
    """Return the common limits of the panels of a row; None if no run finished."""
    points = np.array([(getattr(row, panel.x), getattr(row, panel.y)) for row in rows
                       if row.finished]).reshape(-1, 2)
    points = points[(points[:, 0] > 0.0) & (points[:, 1] >= 0.0)]
    if not points.size:
        return None
    x = points[:, 0]
    # A label takes a fifth of the width, to the left of its point.
    room = max(2.5, (x.max() / x.min()) ** 0.27)
    return (x.min() / room, x.max() * 1.7, *_limits(points[:, 1], floor))


def _begin_panel(ax: Axes, panel: Panel, limits: tuple[float, float, float, float] | None
                 ) -> None:
    ax.set(xscale='log', yscale='log')
    ax.set_xlabel(panel.x_label, fontsize=9.0)
    ax.set_ylabel(panel.y_label, fontsize=9.0)
    ax.set_title(panel.title, fontsize=10.5, loc='left')
    ax.grid(which='major', color='#e3e3e3', linewidth=0.7)
    ax.spines[['top', 'right']].set_visible(False)
    if limits is None:
        ax.text(0.5, 0.5, 'no run arrived', ha='center', transform=ax.transAxes, color=FAINT)
        limits = 1e-5, 1.0, 1e-12, 1.0
    ax.set(xlim=limits[:2], ylim=limits[2:])


def _limits(values: np.ndarray, floor: float) -> tuple[float, float]:
    """Return whole decades that contain all errors except lost runs, and labels."""
    usual = values[(values > 0.0) & (values <= _LOST)]
    usual = usual if usual.size else np.array([_EPS, _LOST])
    low = usual.min() if math.isnan(floor) else min(usual.min(), floor / 3.0)
    return (10.0 ** math.floor(math.log10(low) - 0.5),
            10.0 ** math.ceil(math.log10(usual.max()) + 0.1))


def _draw_lines(ax: Axes, panel: Panel, series: dict[str, list[StudyRow]]) -> None:
    """Draw the lines, and name the steps that are the cheapest."""
    low, high = ax.get_ylim()
    labels: list[Label] = []
    for name, rows in series.items():
        good, lost = _points(panel, rows, low, high)
        points = np.array([point[:2] for point in good]).reshape(-1, 2)
        style = line_style(name)
        ax.plot(*points.T, zorder=4, clip_on=False, **style)
        # A lost run may have taken longer than all that arrived.
        ax.plot(np.clip(lost, *ax.get_xlim()), [high] * len(lost), color=style['color'],
                marker='x', markersize=8.0, markeredgewidth=2.0, linestyle='', clip_on=False,
                zorder=5)
        labels += [Label(row.setting(), style['color'], point)
                   for point, (*_, row) in zip(points, good, strict=True)]
    label_front(ax, labels)


def _points(panel: Panel, rows: Sequence[StudyRow], low: float, high: float
            ) -> tuple[list[tuple[float, float, StudyRow]], list[float]]:
    """Return the points of a line with their rows, and where runs are lost."""
    good, lost = [], []
    for row in rows:
        x, y = getattr(row, panel.x), getattr(row, panel.y)
        if row.failed or y > high:
            lost.append(x)
        elif row.finished and y >= 0.0:
            # No error at all has no place on a logarithmic axis.
            good.append((x, max(y, low), row))
    return good, [x for x in lost if not math.isnan(x)]


def _handles(series: dict[str, list[StudyRow]]) -> list[Line2D]:
    """Return an entry of a legend for each line."""
    return [Line2D([], [], label=_legend_text(name, rows), **line_style(name))
            for name, rows in series.items()]


def _common_handles(known: Floor) -> list[Any]:
    """Return an entry of a legend for each mark that is no line of a method."""
    handles: list[Any] = [
        Line2D([], [], color=INK, marker='x', linestyle='', markersize=8.0, markeredgewidth=2.0,
               label='upper edge: failed or lost')]
    if known.model is not None:
        handles.append(Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (8, 3, 1, 3)),
                              label='error of the learned H itself: no use below'))
        if known.model.box is not None:
            handles.append(Line2D([], [], color='#8a5a00', linewidth=1.6,
                                  label='RMS and largest error of H in its box'))
    if known.verified:
        handles.append(Patch(color='#e9e9e9', label='below the accuracy of the reference'))
    return handles


def _legend_text(name: str, rows: Sequence[StudyRow]) -> str:
    steps = [row.step_size for row in rows if not math.isnan(row.step_size)]
    if not steps:
        return f'{name} (marks: tolerances)'
    return f'{name},\nh = {max(steps):.2g} to {min(steps):.2g} s'


def _draw_levels(ax: Axes, panel: Panel, floor: float, known: Floor) -> None:
    """Draw the errors below which nothing is known or gained."""
    if not math.isnan(floor):
        _draw_floor(ax, floor)
    if panel.y == 'energy_band' and known.model is not None and known.model.box is not None:
        _draw_box_error(ax, known.model.box)
    bottom = ax.get_ylim()[0]
    if panel.y == 'path_error' and known.verified and known.accuracy > bottom:
        ax.axhspan(bottom, known.accuracy, color='#e9e9e9', zorder=0.5)


def _draw_floor(ax: Axes, floor: float) -> None:
    ax.axhspan(ax.get_ylim()[0], floor, color='#f7f3e8', zorder=0)
    ax.axhline(floor, color=INK, linewidth=1.0, linestyle=(0, (8, 3, 1, 3)), zorder=3)


def _draw_box_error(ax: Axes, error: EnergyError) -> None:
    """Draw the RMS, with its interval, and the largest error of H in its box, at the right."""
    across = ax.get_yaxis_transform()
    if error.rms_interval is not None:
        ax.axhspan(*error.rms_interval, xmin=0.9, color='#8a5a00', alpha=0.2, linewidth=0.0,
                   zorder=1)
    for value in (error.rms, error.sup):
        ax.plot([0.9, 1.0], [value, value], color='#8a5a00', linewidth=1.6, transform=across,
                zorder=3)
