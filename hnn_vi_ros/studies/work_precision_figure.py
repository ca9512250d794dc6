# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a work-precision study: two panels, told apart in grey as well."""

from collections.abc import Iterable, Sequence
import math
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.models.energy_error import EnergyError
from hnn_vi_ros.studies.label_placement import place_labels
from hnn_vi_ros.studies.measuring import StudyRow
from hnn_vi_ros.studies.references import ModelDiscrepancy, Reference
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

# Colour and marker; families share a colour, from light to dark with the order.
STYLES = {
    'variational_euler': ('#d1495b', 'o'),
    'symplectic_euler': ('#e07a5f', '<'),
    'symplectic_euler_adjoint': ('#e07a5f', '>'),
    'explicit_euler': ('#8d99ae', 'x'),
    'generalized_leapfrog': ('#edae49', 's'),
    'stormer_verlet': ('#c17c1b', 'D'),
    'implicit_midpoint': ('#c9a227', '^'),
    'discrete_gradient': ('#7f6a93', 'p'),
    'yoshida4': ('#8f5fa8', 'v'),
    'suzuki4': ('#6b3f8a', 'd'),
    'rk4': ('#2f2f2f', 'X'),
    'gauss4': ('#7fb7d6', 'o'), 'gauss6': ('#66a5cc', 's'), 'gauss8': ('#3d87ba', 's'),
    'gauss10': ('#2f76a8', '^'), 'gauss12': ('#236496', 'v'), 'gauss14': ('#175383', 'D'),
    'gauss16': ('#0b3c6f', 'D'),
    'scipy DOP853': ('#1b7f5c', 'o'), 'scipy RK45': ('#63b995', 's'),
    'torchdiffeq dopri5': ('#a8623a', '^'), 'torchdiffeq dopri8': ('#7a3e1d', 'v'),
    'torchdiffeq rk4': ('#c99672', 'X'),
    'diffrax Tsit5': ('#6c757d', 'D'), 'diffrax Dopri8': ('#343a40', 'P'),
    'diffrax SemiImplicitEuler': ('#adb5bd', 'o'),
}
_OTHER = ('#555555', '*')
INK, FAINT = '#222222', '#8a8a8a'
# Larger errors say only that the run is lost.
_LOST = 100.0
_DPI = 120
_EPS = float(np.finfo(np.float64).eps)


class Panel(NamedTuple):
    """What a panel shows: two columns of StudyRow, and what they are called."""

    x: str
    y: str
    title: str
    x_label: str
    y_label: str


PANELS = (
    Panel('seconds_per_simulated_second', 'path_error', 'How far from the true path',
          'wall time per simulated second [s/s]', 'path error'),
    Panel('gradients_per_simulated_second', 'energy_band', 'How far from the energy',
          'gradients per simulated second [1/s]', 'energy band [J]'),
)


def series_of(rows: Iterable[StudyRow]) -> dict[str, list[StudyRow]]:
    """Return the rows that make a line each; the tolerances of a peer are one line."""
    series: dict[str, list[StudyRow]] = {}
    for row in rows:
        series.setdefault(row.method.partition(' tolerance=')[0], []).append(row)
    return series


def panels_of(rows: Iterable[StudyRow]) -> tuple[Panel, Panel]:
    """Return the two panels; energies stand in both where no path can be followed."""
    left, right = PANELS
    if any(row.finished and not math.isnan(row.path_error) for row in rows):
        return left, right
    return right._replace(x=left.x, x_label=left.x_label, title=(
        'How far from the energy (no path can be followed so far)')), right


def is_peer(name: str) -> bool:
    """Tell a peer's line from one of ours, whose names have no spaces."""
    return ' ' in name


def draw(path: Path, title: str, rows: Sequence[StudyRow], reference: Reference,
         model: ModelDiscrepancy | None) -> Path:
    """
    Draw the rows of one horizon into a PNG file.

    Parameters
    ----------
    path : Path
        Where to write.
    title : str
        Above both panels.
    rows : sequence of StudyRow
        All of one horizon.
    reference : Reference
        Below whose accuracy no path error is known.
    model : ModelDiscrepancy or None
        What a learned H is off by, drawn as a floor.

    """
    figure = Figure(figsize=(14.0, 7.5), dpi=_DPI, facecolor='white')
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, color=INK)
    floors = {'path_error': model.path, 'energy_band': model.energy} if model else {}
    panels = panels_of(rows)
    axes = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.06, right=0.975, bottom=0.12, top=0.875, wspace=0.17)
    lines = [_draw_panel(ax, panel, rows, floors.get(panel.y, math.nan))
             for ax, panel in zip(axes, panels, strict=True)]
    for ax, panel in zip(axes, panels, strict=True):
        if panel.y == 'energy_band' and model is not None and model.box is not None:
            _draw_box_error(ax, model.box)
    if panels[0].y == 'path_error' and reference.verified:
        bottom = axes[0].get_ylim()[0]
        if reference.accuracy > bottom:
            axes[0].axhspan(bottom, reference.accuracy, color='#e9e9e9', zorder=0.5)
            axes[0].annotate('the reference knows no more', (0.0, reference.accuracy),
                             (5, -3), ha='left', va='top', fontsize=8, color=FAINT,
                             xycoords=axes[0].get_yaxis_transform(), textcoords='offset points')
    figure.text(0.995, 0.004, 'solid: ours   dashed: peers   dotted: not solved to round-off, or '
                'float32   \N{MULTIPLICATION SIGN} at the upper edge: failed or lost',
                ha='right', va='bottom', fontsize=8, color=FAINT)
    # Last: the layout is final only now.
    for ax, drawn in zip(axes, lines, strict=True):
        place_labels(ax, drawn)
    figure.savefig(path, dpi=_DPI)
    return path


def _draw_panel(ax: Axes, panel: Panel, rows: Sequence[StudyRow], floor: float
                ) -> dict[str, tuple[str, np.ndarray]]:
    """Draw a panel; return the colour and the points of each line that has some."""
    ax.set(xscale='log', yscale='log', xlabel=panel.x_label, ylabel=panel.y_label)
    ax.set_title(panel.title, pad=14.0)
    ax.grid(which='major', color='#e3e3e3', linewidth=0.7)
    ax.spines[['top', 'right']].set_visible(False)
    points = [(getattr(row, panel.x), getattr(row, panel.y)) for row in rows if row.finished]
    points = [(x, y) for x, y in points if x > 0.0 and y >= 0.0]
    if not points:
        ax.text(0.5, 0.5, 'no run arrived', ha='center', transform=ax.transAxes, color=FAINT)
        ax.set(xlim=(1e-5, 1.0), ylim=(1e-12, 1.0))
        return {}
    low, high = _limits(np.array(points)[:, 1], floor)
    ax.set_ylim(low, high)
    lines = {}
    for name, line in series_of(rows).items():
        lines[name] = _draw_line(ax, panel, name, line, (low, high))
    if not math.isnan(floor):
        _draw_floor(ax, floor)
    return {name: line for name, line in lines.items() if len(line[1])}


def _limits(values: np.ndarray, floor: float) -> tuple[float, float]:
    """Return whole decades that hold the errors, but for those of runs that are lost."""
    usual = values[(values > 0.0) & (values <= _LOST)]
    usual = usual if usual.size else np.array([_EPS, _LOST])
    low = usual.min() if math.isnan(floor) else min(usual.min(), floor / 3.0)
    return (10.0 ** math.floor(math.log10(low) - 0.2),
            10.0 ** math.ceil(math.log10(usual.max()) + 0.1))


def _draw_line(ax: Axes, panel: Panel, name: str, rows: Sequence[StudyRow],
               limits: tuple[float, float]) -> tuple[str, np.ndarray]:
    """Draw a method's line and its crosses; return its colour and points, shape (n, 2)."""
    low, high = limits
    base, _, variant = name.partition('@')
    color, marker = STYLES.get(base, _OTHER)
    good, lost = [], []
    for row in rows:
        x, y = getattr(row, panel.x), getattr(row, panel.y)
        if row.failed or y > high:
            lost.append(x)
        elif row.finished and y >= 0.0:
            # No error at all has no place on a logarithmic axis.
            good.append((x, max(y, low)))
    points = np.array(good).reshape(-1, 2)
    open_marker = bool(variant) or is_peer(name)
    ax.plot(*points.T, color=color, marker=marker, markersize=4.0 if variant else 6.0,
            linestyle=':' if variant else (0, (5, 2)) if is_peer(name) else '-',
            linewidth=1.0 if variant else 1.3 if is_peer(name) else 1.7,
            markerfacecolor='white' if open_marker else color, markeredgecolor=color,
            markeredgewidth=1.0, alpha=0.85 if variant else 1.0,
            zorder=2 if variant else 3 if is_peer(name) else 4, clip_on=False)
    known = [x for x in lost if not math.isnan(x)]
    ax.plot(known, [high] * len(known), color=color, marker='x', markersize=8.0,
            markeredgewidth=2.0, linestyle='', clip_on=False, zorder=5)
    return color, points


def _draw_floor(ax: Axes, floor: float) -> None:
    ax.axhspan(ax.get_ylim()[0], floor, color='#f7f3e8', zorder=0)
    ax.axhline(floor, color=INK, linewidth=1.0, linestyle=(0, (8, 3, 1, 3)), zorder=1)
    ax.annotate(f'the learned H itself is off by {floor:.2g}', (0.0, floor), (5, -4),
                xycoords=ax.get_yaxis_transform(), textcoords='offset points', fontsize=8.5,
                color=INK, va='top', zorder=5,
                bbox={'facecolor': '#f7f3e8', 'edgecolor': 'none', 'alpha': 0.85, 'pad': 1.0})


def _draw_box_error(ax: Axes, error: EnergyError) -> None:
    """Draw the RMS and the largest error of H in its box, with their intervals, at the right."""
    across = ax.get_yaxis_transform()
    for value, interval, label in ((error.rms, error.rms_interval, 'RMS'),
                                   (error.sup, error.sup_interval, 'largest')):
        if interval is not None:
            ax.axhspan(*interval, xmin=0.86, color=INK, alpha=0.15, linewidth=0.0, zorder=1)
        ax.plot([0.86, 1.0], [value, value], color=INK, linewidth=1.0, transform=across, zorder=1)
        ax.annotate(f'{label} error of H in the box', (1.0, value), (-3, 2), ha='right',
                    va='bottom', fontsize=7, color=INK, xycoords=across,
                    textcoords='offset points')
