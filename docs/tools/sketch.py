# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A sketch of a run: the mechanism at its end and the paths of its bodies, without axes."""

import io

from hnn_vi_ros import Trajectory
from hnn_vi_ros.hamiltonians import Ball, bounds_of, Cuboid, Line, Part, Trail
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
import numpy as np
from PIL import Image

# Side [inch], its resolution [1/inch], and the ground of the viewer.
_SIDE, _DPI, GROUND = 3.2, 100, '#0d1117'
# Samples of the last part of the run, whose path is drawn.
_PATH = 4000


def sketch(run: Trajectory, sample: int = -1) -> Image.Image:
    """
    Draw the mechanism of a run's scene.

    Parameters
    ----------
    run : Trajectory
        Trajectory of a scene with a mechanism.
    sample : int, optional
        At which it is drawn: by default the last.

    """
    mechanism = run.mechanism()
    assert mechanism is not None, 'the caller asks for those that have one'
    parts = mechanism(run.q, float(np.abs(run.q).max()) or 1.0)
    figure = Figure(figsize=(_SIDE, _SIDE), facecolor=GROUND)
    axes = figure.add_axes((0.04, 0.04, 0.92, 0.92), aspect='equal')
    axes.set_axis_off()
    across, up = _plane(parts)
    for part in parts.values():
        _draw(axes, part, across, up, sample % len(run.t))
    low, high = bounds_of(parts)
    axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
    film = io.BytesIO()
    figure.savefig(film, dpi=_DPI)
    return Image.open(film).convert('RGB')


def _plane(parts: dict[str, Part]) -> tuple[int, int]:
    """Return the axes of a view: from above for motion in x and y, otherwise from the side."""
    places = np.vstack([_places(part) for part in parts.values() if part.moves])
    along_x, along_y, along_z = np.ptp(places, axis=0)
    # Motion along x alone is not flat: its springs stand upright on a floor.
    if along_z < 0.3 * max(along_x, along_y) and along_z < along_y:
        return 0, 1
    return (0, 2) if along_y <= along_x * (1.0 + 1e-9) else (1, 2)


def _places(part: Part) -> np.ndarray:
    place = part.points if isinstance(part, Line) else (
        part.point if isinstance(part, Trail) else part.center)
    return place.reshape(-1, 3)


def _draw(axes: Axes, part: Part, across: int, up: int, k: int) -> None:
    """Draw a part at a sample, and behind a body or a trail its path."""
    colour = tuple(value / 255.0 for value in part.color)
    if isinstance(part, Line):
        points = part.points[k] if part.moves else part.points
        axes.plot(points[:, across], points[:, up], color=colour, linewidth=1.8,
                  solid_capstyle='round', zorder=2)
        return
    path = _places(part)
    path = path[max(k - _PATH, 0):k + 1] if part.moves else path
    if part.moves:
        axes.plot(path[:, across], path[:, up], color=colour, linewidth=0.7, alpha=0.55, zorder=1)
    if isinstance(part, Ball):
        axes.add_patch(Circle(tuple(path[-1][[across, up]]), part.radius, color=colour, zorder=3))
        if part.moves:
            # No smaller than can be seen where the path is long.
            axes.plot(*path[-1][[across, up]], 'o', color=colour, markersize=7.0, zorder=3)
    elif isinstance(part, Cuboid):
        half, center = np.array(part.half_size), path[-1]
        corner = (center - half)[[across, up]]
        axes.add_patch(Rectangle(tuple(corner), *(2.0 * half[[across, up]]), color=colour,
                                 zorder=3))
