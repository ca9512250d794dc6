# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Labels placed next to their points, where they hide nothing."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
import numpy as np

_FONT = 7.5
# Offsets from a point to the near corner of its label [points], the preferred ones first.
_OFFSETS = ((6, 0), (6, 6), (6, -6), (-6, 0), (-6, 6), (-6, -6), (0, 9), (0, -9))


class Label(NamedTuple):
    """A text, its colour, and the point that it belongs to, in data coordinates."""

    text: str
    color: str
    point: np.ndarray


def place_labels(ax: Axes, labels: Sequence[Label], lines: Sequence[np.ndarray]) -> int:
    """
    Write texts next to their points.

    Of all places next to the point, the label takes the one where it covers the fewest points and
    lines. A label that would overlap another one, or leave the axes, everywhere is left out.

    Parameters
    ----------
    ax : Axes
        Whose limits, scales and layout are final: drawn once.
    labels : sequence of Label
        The first ones find a place first.
    lines : sequence of np.ndarray, shape (n, 2)
        The lines of the figure.

    Returns
    -------
    int
        How many were written.

    """
    figure = ax.figure
    pixels = figure.dpi / 72.0
    obstacles = np.vstack([_along(ax.transData.transform(points)) for points in lines]
                          or [np.empty((0, 2))])
    inside = ax.get_window_extent()
    taken: list[Bbox] = []
    for label in labels:
        x, y = label.point
        text = ax.annotate(label.text, (x, y), (0, 0), fontsize=_FONT, color=label.color,
                           zorder=6, textcoords='offset points',
                           path_effects=[withStroke(linewidth=1.5, foreground='white')])
        box = text.get_window_extent()
        places = [place for place in _candidates(ax.transData.transform(label.point), box, pixels)
                  if _is_free(place[1], taken, inside)]
        if not places:
            text.remove()
            continue
        offset, place, _ = min(places, key=lambda entry: entry[2] + 1.5 * _covered(
            entry[1], obstacles))
        taken.append(place)
        text.xyann = offset[:2]
        text.set(ha=offset[2], va='center')
    return len(taken)


def _along(points: np.ndarray) -> np.ndarray:
    """Return places along a line through points, in pixels."""
    if len(points) < 2:
        return points
    shares = np.linspace(0.0, 1.0, 12)[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(points)])


def _candidates(point: np.ndarray, box: Bbox, pixels: float
                ) -> Iterator[tuple[tuple[int, int, str], Bbox, float]]:
    """Yield offset with alignment, extent and reluctance of each place for a label."""
    for rank, (dx, dy) in enumerate(_OFFSETS):
        x, y = point + np.array([dx, dy]) * pixels
        align = 'left' if dx > 0 else 'right' if dx < 0 else 'center'
        left = x - {'left': 0.0, 'right': box.width, 'center': 0.5 * box.width}[align]
        yield (dx, dy, align), Bbox.from_bounds(
            left, y - 0.5 * box.height, box.width, box.height), 0.3 * rank


def _is_free(place: Bbox, taken: list[Bbox], inside: Bbox) -> bool:
    within = (place.x0 >= inside.x0 and place.x1 <= inside.x1
              and place.y0 >= inside.y0 and place.y1 <= inside.y1)
    return within and not any(place.overlaps(other) for other in taken)


def _covered(place: Bbox, obstacles: np.ndarray) -> int:
    low, high = np.array([place.min, place.max])
    return int(((obstacles > low - 2.0) & (obstacles < high + 2.0)).all(axis=1).sum())
