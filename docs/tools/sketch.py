# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A sketch of a run: the mechanism at its end and the paths of its bodies, without axes."""

from collections.abc import Callable
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
# Directions to the right and up of a view of motion in space, from above at 25 degrees.
_OBLIQUE = np.array([[0.82, -0.57, 0.0], [0.24, 0.35, 0.91]])
# Instants of a flat mechanism, drawn below one another, and their distance relative to its length.
_INSTANTS, _ROW = 5, 0.16


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
    view, sample = _view(parts), sample % len(run.t)
    low, high = (view @ bound for bound in bounds_of(parts))
    if view is _OBLIQUE:
        # The corners of the box lie far from what it contains.
        places = np.vstack([_places(part) for part in parts.values()]) @ view.T
        margin = 0.08 * np.ptp(places, axis=0)
        low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    width, height = high - low
    if height < _ROW * width:
        # Time runs down.
        samples = np.linspace(0, sample, _INSTANTS).astype(int).tolist()
        shifts = [np.array([0.0, -k * _ROW * width]) for k in range(_INSTANTS)]
        low = low + shifts[-1]
    else:
        samples, shifts = [sample], [np.zeros(2)]
    for k, shift in zip(samples, shifts, strict=True):
        for part in parts.values():
            _draw(axes, part, lambda points, by=shift: points @ view.T + by, k, len(samples) == 1)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    film = io.BytesIO()
    figure.savefig(film, dpi=_DPI)
    return Image.open(film).convert('RGB')


def _view(parts: dict[str, Part]) -> np.ndarray:
    """Return the directions to the right and up, shape (2, 3): across the plane of a motion."""
    places = np.vstack([_places(part) for part in parts.values() if part.moves])
    along_x, along_y, along_z = extents = np.ptp(places, axis=0)
    if extents.min() >= 0.3 * extents.max():
        return _OBLIQUE
    # Motion along x alone is not flat: its springs stand upright on a floor.
    if along_z < 0.3 * max(along_x, along_y) and along_z < along_y:
        return np.eye(3)[[0, 1]]
    return np.eye(3)[[0, 2]] if along_y <= along_x * (1.0 + 1e-9) else np.eye(3)[[1, 2]]


def _places(part: Part) -> np.ndarray:
    place = part.points if isinstance(part, Line) else (
        part.point if isinstance(part, Trail) else part.center)
    return place.reshape(-1, 3)


def _draw(axes: Axes, part: Part, project: Callable[[np.ndarray], np.ndarray], k: int,
          trail: bool) -> None:
    """Draw a part at a sample, and behind a body or a trail its path if it is asked for."""
    colour = tuple(value / 255.0 for value in part.color)
    if isinstance(part, Line):
        axes.plot(*project(part.points[k] if part.moves else part.points).T, color=colour,
                  linewidth=1.8, solid_capstyle='round', zorder=2)
        return
    path = _places(part)
    path = project(path[max(k - _PATH, 0):k + 1] if part.moves else path)
    if part.moves and trail:
        axes.plot(*path.T, color=colour, linewidth=0.7, alpha=0.55, zorder=1)
    if isinstance(part, Ball):
        axes.add_patch(Circle(tuple(path[-1]), part.radius, color=colour, zorder=3))
        if part.moves:
            # No smaller than can be seen where the path is long.
            axes.plot(*path[-1], 'o', color=colour, markersize=7.0, zorder=3)
    elif isinstance(part, Cuboid):
        half = project(np.array(part.half_size)) - project(np.zeros(3))
        axes.add_patch(Rectangle(tuple(path[-1] - half), *(2.0 * half), color=colour, zorder=3))
