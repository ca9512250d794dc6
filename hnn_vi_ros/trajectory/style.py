# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The look of the figures of trajectories: colours, labels, and who keeps a figure."""

from collections.abc import Sequence
import re
from typing import Any, TYPE_CHECKING

from hnn_vi_ros.files.optional_package import optional
import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# P. Tol, Colour Schemes (2021), "high contrast", and black: told apart by colour-blind readers,
# and in grey, where their lightness L* is 29, 73, 50 and 0. A dash each besides.
COLOURS = ('#004488', '#ddaa33', '#bb5566', '#000000')
DASHES = ('-', (0, (5, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.2)))
EVENT, ALARM, CONTOUR = '0.55', '#bb5566', '0.82'
# More curves than this in one panel are not told apart one by one: they are shaded by number.
MOST_NAMED = 8
_SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')


def new_figure(width: float, height: float) -> 'Figure':
    """
    Return an empty figure of this size [inch], which a window shows if the user has any.

    Where there are no windows, as in a notebook or a script without a screen, pyplot keeps no
    hold of it: it would be shown twice, or never freed.
    """
    with optional('matplotlib', 'drawing a trajectory'):
        from matplotlib import get_backend, pyplot
    figure = pyplot.figure(figsize=(width, height), layout='constrained')
    if 'inline' in get_backend().lower() or get_backend().lower() == 'agg':
        pyplot.close(figure)
    return figure


def label(name: str, unit: str) -> str:
    """Return a name with its unit, whose powers are superscripts; that of a number is left out."""
    if unit == '1':
        return name
    raised = re.sub(r'(?<=[A-Za-z])-?\d+', lambda power: power[0].translate(_SUPERSCRIPTS), unit)
    return f'{name} [{raised}]'


def draw_curves(axes: 'Axes', curves: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """
    Draw curves, each a name, x and y.

    More than MOST_NAMED are shaded from dark to light, and the first and the last are named.
    """
    from matplotlib import colormaps
    shades = colormaps['cividis']
    for i, (name, x, y) in enumerate(curves):
        style: dict[str, Any]
        if len(curves) > MOST_NAMED:
            style = {'color': shades(0.9 * i / (len(curves) - 1)), 'linewidth': 0.8}
            if i > 0:
                name = f'... {name}' if i == len(curves) - 1 else '_nolegend_'
        else:
            style = {'color': COLOURS[i % len(COLOURS)], 'linewidth': 1.4,
                     'linestyle': DASHES[(i + i // len(COLOURS)) % len(DASHES)]}
        axes.plot(x, y, label=name, **style)


def name_curves(axes: 'Axes') -> None:
    """Name the marks of a panel in a legend to its right; its axis names a single one."""
    if len(axes.get_legend_handles_labels()[1]) > 1:
        axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5), frameon=False,
                    fontsize='small', handlelength=2.6)
