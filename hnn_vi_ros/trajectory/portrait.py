# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The phase portraits of a trajectory, as a figure."""

import math
from typing import TYPE_CHECKING

from hnn_vi_ros.phase_space import Coordinate, momentum_name
from hnn_vi_ros.trajectory.data import TrajectoryData
from hnn_vi_ros.trajectory.style import (
    COLOURS, CONTOUR, draw_curves, label, MOST_NAMED, name_curves, new_figure)
from hnn_vi_ros.viewer.phase_portrait import contours as level_sets
from hnn_vi_ros.viewer.phase_portrait import Frame
import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Side of a panel [inch], and the most panels in a row.
_SIDE, _MOST_IN_A_ROW = 3.6, 3
# Room around the path, in shares of its extent.
_MARGIN = 0.08


def portrayed(trajectory: TrajectoryData) -> list[tuple[Coordinate, int, int]]:
    """
    Return the coordinates that have a plane with their momentum, with their columns of q and p.

    Raises
    ------
    ValueError
        There is none: all of them are rotations or poses.

    """
    q, p = (list(names) for names in trajectory.names)
    found = [(own, q.index(own.name), p.index(momentum_name(own.name)))
             for own in trajectory.coordinates if own.kind == 'scalar']
    if not found:
        raise ValueError('no coordinate has a plane with its momentum: '
                         f'{", ".join(own.name for own in trajectory.coordinates)} turns; '
                         'plot() draws its columns')
    return found


def draw_portrait(trajectory: TrajectoryData, contours: bool) -> 'Figure':
    """Draw what ``Trajectory.phase_portrait`` tells; contours: level sets of H, too."""
    shown = portrayed(trajectory)
    across = min(len(shown), _MOST_IN_A_ROW)
    down = math.ceil(len(shown) / across)
    figure = new_figure(_SIDE * across + 1.4, _SIDE * down + 0.4)
    grid = figure.subplots(down, across, squeeze=False)
    for axes in grid.flat[len(shown):]:
        axes.remove()
    for axes, (own, i, k) in zip(grid.flat, shown, strict=False):
        q, p = trajectory.q[..., i], trajectory.p[..., k]
        axes.set(xlabel=label(own.name, own.q_unit),
                 ylabel=label(momentum_name(own.name), own.p_unit))
        axes.margins(_MARGIN)
        _draw_paths(axes, q, p)
        if contours and trajectory.scene is not None:
            draw_contours(axes, trajectory)
        axes.grid(alpha=0.3)
    # The marks are the same in every panel.
    name_curves(grid[0, across - 1])
    figure.suptitle(trajectory.title)
    return figure


def _draw_paths(axes: 'Axes', q: np.ndarray, p: np.ndarray) -> None:
    """Draw paths of shape (N,) or (N, m), where each begins, and where it ends."""
    paths = [('path', q, p)] if q.ndim == 1 else [
        (f'trajectory {k}', q[:, k], p[:, k]) for k in range(q.shape[1])]
    draw_curves(axes, paths)
    if len(paths) > MOST_NAMED:
        return
    for name, at, inside in (('start', 0, 'white'), ('end', -1, COLOURS[-1])):
        axes.plot(q[at], p[at], 'o', color=COLOURS[-1], markerfacecolor=inside, markersize=6.0,
                  zorder=3, label=name)


def draw_contours(axes: 'Axes', trajectory: TrajectoryData) -> None:
    """Draw level sets of H behind the path of a single coordinate, over what the axes show."""
    from matplotlib.collections import LineCollection
    q, p = trajectory.q.reshape(-1, 1), trajectory.p.reshape(-1, 1)
    frame = Frame(0, axes.get_xlim(), axes.get_ylim())
    levels = level_sets(trajectory.hamiltonian(), frame, q[0], p[0])
    lines = LineCollection([line for _, own in levels for line in own], colors=CONTOUR,
                           linewidths=0.8, zorder=0, label='level sets of H')
    axes.add_collection(lines, autolim=False)
    axes.set(xlim=frame.q, ylim=frame.p)
