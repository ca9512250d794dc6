# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Names written beside their lines, where they hide least."""

from collections.abc import Iterator, Mapping
from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox
import numpy as np

_FONT = 8.5
# Offsets from a point to the near corner of its label [points], the preferred ones first.
_OFFSETS = ((8, 0), (8, 9), (8, -9), (-8, 0), (-8, 9), (-8, -9), (0, 12), (0, -12),
            (22, 18), (22, -18), (-22, 18), (-22, -18), (30, 0), (-30, 0))


def place_labels(ax: Axes, lines: Mapping[str, tuple[str, np.ndarray]]) -> None:
    """
    Write the name of each line beside one of its points.

    Every place beside every point is tried; the one is taken where the label covers the fewest
    points, lines and other labels, and lies inside the axes.

    Parameters
    ----------
    ax : Axes
        Whose limits and scales are final.
    lines : mapping
        From a name to its colour and its points, shape (n, 2), n > 0.

    """
    figure = ax.figure
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    pixels = figure.dpi / 72.0
    obstacles = np.vstack([_along(ax.transData.transform(points))
                           for _, points in lines.values()] or [np.empty((0, 2))])
    inside, taken = ax.get_window_extent(renderer), []
    # Those that have the fewest points to stand beside come first.
    for name, (color, points) in sorted(lines.items(), key=lambda item: len(item[1][1])):
        text = ax.annotate(name, points[-1], (0, 0), fontsize=_FONT, color=color, zorder=6,
                           textcoords='offset points')
        box = text.get_window_extent(renderer)
        best = min(_candidates(ax.transData.transform(points), box, pixels),
                   key=lambda place: _cost(place[2], place[3], obstacles, taken, inside))
        i, offset, place, _ = best
        taken.append(place)
        text.xy, text.xyann = points[i], offset[:2]
        text.set(ha=offset[2], va='center')
        if max(abs(offset[0]), abs(offset[1])) > 12:
            ax.annotate('', points[i], offset[:2], textcoords='offset points', zorder=5,
                        arrowprops={'arrowstyle': '-', 'color': color, 'linewidth': 0.6})


def _along(points: np.ndarray) -> np.ndarray:
    """Return places along a line through points, in pixels."""
    if len(points) < 2:
        return points
    shares = np.linspace(0.0, 1.0, 12)[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(points)])


def _candidates(points: np.ndarray, box: Bbox, pixels: float
                ) -> Iterator[tuple[int, tuple[int, int, str], Bbox, float]]:
    """Yield point, offset with alignment, extent and reluctance of each place for a label."""
    for back, i in enumerate(range(len(points) - 1, -1, -1)):
        for rank, (dx, dy) in enumerate(_OFFSETS):
            x, y = points[i] + np.array([dx, dy]) * pixels
            align = 'left' if dx > 0 else 'right' if dx < 0 else 'center'
            left = x - {'left': 0.0, 'right': box.width, 'center': 0.5 * box.width}[align]
            yield i, (dx, dy, align), Bbox.from_bounds(
                left, y - 0.5 * box.height, box.width, box.height), 0.3 * rank + 0.4 * back


def _cost(place: Bbox, reluctance: float, obstacles: np.ndarray, taken: list[Bbox],
          inside: Bbox) -> float:
    within = ((obstacles > place.min - 2.0) & (obstacles < place.max + 2.0)).all(axis=1).sum()
    overlaps = sum(place.overlaps(other) for other in taken)
    outside = (place.x0 < inside.x0) + (place.x1 > inside.x1 + 40.0) \
        + (place.y0 < inside.y0) + (place.y1 > inside.y1)
    return reluctance + 1.5 * within + 30.0 * overlaps + 60.0 * outside
