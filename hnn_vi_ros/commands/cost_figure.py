# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Plot the cost of accuracy: error against time, with a labelled line for each method."""

from collections import Counter
from collections.abc import Iterable
from io import BufferedWriter
from itertools import cycle
import math
from string import digits
from textwrap import fill
from typing import NamedTuple

from hnn_vi_ros.files import save_figure
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Chosen, CostStudy, Method, MethodCost
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import hsv_to_rgb, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np
from numpy.typing import ArrayLike
from scipy.constants import golden

# Height of a line of labels [points].
_LABEL_HEIGHT = 9.0


class Label(NamedTuple):
    """A text, its colour, and its point in data coordinates."""

    text: str
    color: str
    point: np.ndarray


def label_front(ax: Axes, labels: Iterable[Label]) -> None:
    """
    Label the points of the Pareto front, at least one line height apart.

    The area to the lower left of a front point is empty, so its label is put there.

    Parameters
    ----------
    ax : Axes
        Axes with costs to the right and errors upwards; their limits are final.
    labels : iterable of Label
        Labels of all points.

    """
    least = math.inf
    for label in sorted(labels, key=lambda label: float(label.point[0])):
        height = float(ax.transData.transform(label.point)[1]) * 72.0 / ax.figure.dpi
        if height < least - _LABEL_HEIGHT:
            least, (x, y) = height, label.point
            ax.annotate(label.text, (x, y), (-5, -3), textcoords='offset points', ha='right',
                        va='top', fontsize=7.5, color=label.color, zorder=6)


def _styles() -> dict[str, tuple[str, str]]:
    """
    Return a colour and a marker for each method.

    Methods of a family, whose names differ only in numbers, have neighbouring hues, from bright
    for the first of the list to dark for the last; markers differ within a family.
    """
    styles, met, markers = {}, Counter[str](), cycle('osD^v<>pPhX*d8H')
    names = list(dict.fromkeys(kind.removeprefix('lie_') for kind in INTEGRATORS))
    sizes = Counter(name.rstrip(digits) for name in names)
    # Methods for rotations are never in one plot with others; they use paler variants.
    for name in names:
        family = name.rstrip(digits)
        share = met[family] / max(1, sizes[family] - 1)
        met[family] += 1
        # Steps of the golden ratio around the colour circle separate eight families well; each
        # further group of eight is darker.
        number = list(sizes).index(family)
        hue, value = number / golden - 0.2 * share, 0.92 - 0.55 * share - 0.25 * (number // 8)
        styles[name] = [to_hex(hsv_to_rgb((hue % 1.0, saturation, max(value, 0.2))).tolist())
                        for saturation in (0.75, 0.45)], next(markers)
    found = {}
    for kind in INTEGRATORS:
        colors, marker = styles[kind.removeprefix('lie_')]
        found[kind] = colors[kind.startswith('lie_')], marker
    return found


STYLES = _styles()
INK, FAINT = '#222222', '#8a8a8a'
_SIZE, _DPI = (10.4, 6.4), 150


def draw(stream: BufferedWriter, name: str, study: CostStudy, chosen: Chosen | None) -> None:
    """
    Plot error against time, and mark the cheapest methods.

    Parameters
    ----------
    stream : BufferedWriter
        Stream of the file of the plot, whose suffix selects the format.
    name : str
        Name of the scene.
    study : CostStudy
        Measured costs.
    chosen : Chosen or None
        A requested error, and the recommended method, which is circled.

    """
    figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor='white')
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.08, 0.1, 0.65, 0.74))
    good = [cost for cost in study.costs if study.error(cost) <= study.lost]
    # Omit steps so long that solving their equations takes more time than shorter steps do.
    kinds = dict.fromkeys(cost.method.kind for cost in good)
    lines = [_draw_line(ax, study, _front(
        study, [cost for cost in good if cost.method.kind == kind])) for kind in kinds]
    _format_axes(ax, study, good)
    handles = [*lines, *_draw_levels(ax, study, chosen)]
    figure.text(0.08, 0.955, f'{name}: cost of accuracy over {study.reference.horizon:g} s',
                fontsize=14, color=INK, va='center', parse_math=False)
    subtitle = study.no_path if study.no_path else f'reference: {study.reference.how}'
    figure.text(0.08, 0.918, subtitle[:120], fontsize=8.5, color=FAINT, va='center')
    figure.legend(handles=handles, loc='upper left', bbox_to_anchor=(0.735, 0.855), fontsize=8.5,
                  frameon=False, labelspacing=0.55, handlelength=2.2)
    label_front(ax, [Label(_setting(cost.method, cost.step_size), STYLES[cost.method.kind][0],
                           _point(study, cost)) for cost in good])
    save_figure(stream, figure)


def _setting(method: Method, step_size: float) -> str:
    return f'h = {step_size:.2g} s' if method.tolerance is None else f'{method.tolerance:.0e}'


def _point(study: CostStudy, cost: MethodCost) -> np.ndarray:
    return np.array([1e6 * cost.seconds, study.error(cost)])


def _draw_line(ax: Axes, study: CostStudy, costs: list[MethodCost]) -> Line2D:
    color, marker = STYLES[costs[0].method.kind]
    points = np.array([_point(study, cost) for cost in costs])
    line, = ax.plot(*points.T, color=color, marker=marker, markersize=5.0, linewidth=1.2,
                    label=fill(costs[0].method.family, 34, subsequent_indent='    '), zorder=3)
    return line


def _format_axes(ax: Axes, study: CostStudy, good: list[MethodCost]) -> None:
    """Set scales, limits and labels of the axes."""
    ax.set(xscale='log', yscale='log')
    if good:
        x, y = np.array([_point(study, cost) for cost in good]).T
        low = min([*y[y > 0.0], study.floor or 1.0])
        ax.set(xlim=(x.min() / 2.5, x.max() * 1.6),
               ylim=(10.0 ** math.floor(math.log10(low) - 0.1), 1.5 * study.lost))
    else:
        ax.text(0.5, 0.5, 'no run has a usable error', ha='center', transform=ax.transAxes,
                color=FAINT)
    ax.set_xlabel('processor time [us per simulated second]', fontsize=10)
    ax.set_ylabel('energy error, largest |H - H0 - W| over the energy scale [1]'
                  if study.no_path else
                  'path error, largest deviation of a coordinate or momentum [SI units]',
                  fontsize=10)
    top = ax.secondary_xaxis('top', functions=(_inverse, _inverse))
    top.set_xlabel('times real time', fontsize=10)
    for axis in (ax, top):
        axis.tick_params(labelsize=9, colors=INK)
    ax.grid(which='major', color='#e6e6e6', linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines['right'].set_visible(False)


def _inverse(x: ArrayLike) -> np.ndarray:
    with np.errstate(divide='ignore'):
        return 1e6 / np.asarray(x)


def _draw_levels(ax: Axes, study: CostStudy, chosen: Chosen | None) -> list[Line2D | Patch]:
    """Draw the accuracy limit and the requested error; return the entries of the legend."""
    handles: list[Line2D | Patch] = []
    if study.floor > 0.0:
        ax.axhspan(ax.get_ylim()[0], study.floor, color='#ececec', zorder=0.5)
        handles.append(Patch(
            color='#ececec', label=f'accuracy of the reference: {study.floor:.0e}'))
    if chosen is not None:
        error, choice = chosen.tolerance.error, chosen.choice
        handles.append(ax.axhline(error, color=INK, linewidth=1.0, linestyle=(0, (6, 3)), zorder=2,
                                  label=f'requested: {error:g}'))
        method = Method(choice.method, choice.arguments)
        mark, = ax.plot(1e6 * choice.seconds_per_simulated_second, choice.error, marker='o',
                        markersize=13.0, markerfacecolor='none', markeredgecolor=INK,
                        markeredgewidth=1.6, linestyle='', zorder=5, label=(
                            f'recommended: {method.kind}, {_setting(method, choice.step_size)}'))
        handles.append(mark)
    return handles


def _front(study: CostStudy, good: list[MethodCost]) -> list[MethodCost]:
    """Return the Pareto front of error and time; the cheapest first."""
    front: list[MethodCost] = []
    for cost in sorted(good, key=lambda cost: cost.seconds):
        if not front or study.error(cost) < study.error(front[-1]):
            front.append(cost)
    return front
