# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory in motion: the mechanism of its scene, or its states in their planes."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.mechanisms.parts import Ball, bounds_of, Line, Mechanism, Part, Trail
from hnn_vi_ros.trajectory.data import TrajectoryData
from hnn_vi_ros.trajectory.portrait import draw_portrait, portrayed
from hnn_vi_ros.trajectory.style import COLOURS, new_figure
import numpy as np

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More pictures than this would take minutes and gigabytes to draw.
MOST_FRAMES = 10_000
# Side of a picture of a mechanism [inch], and width of its lines on paper [points].
_SIDE, _LINE_WIDTH = 5.0, 3.0
# Room around a mechanism, in shares of its extent.
_MARGIN = 0.06
_GROUND = '#0d1117'
_AXES = ('x [m]', 'y [m]', 'z [m]')

# Moves what is drawn to the sample of a number.
_Show = Callable[[int], None]


def animate(trajectory: TrajectoryData, speed: float, rate: float) -> 'FuncAnimation':
    """Return what ``Trajectory.animate`` tells."""
    run = trajectory.single()
    for name, value in (('speed', speed), ('rate', rate)):
        if not value > 0.0:
            raise ValueError(f'{name} = {value} must be above 0')
    times = np.arange(run.t[0], run.t[-1] + 0.5 * speed / rate, speed / rate)
    if len(times) > MOST_FRAMES:
        raise ValueError(f'{len(times)} pictures are more than {MOST_FRAMES}: take a larger speed '
                         'or a smaller rate')
    # The newest sample that is not later; half a rounding error of time does not matter.
    samples = np.searchsorted(run.t, times + 1e-9 * speed / rate, side='right') - 1
    mechanism = run.scene.mechanism if run.scene is not None else None
    figure, show = _mechanism(run, MECHANISMS[mechanism]) if mechanism else _portrait(run)
    figure.suptitle(run.title)
    clock = figure.axes[0].set_title('', loc='left', fontsize='medium')

    def update(k: int) -> None:
        clock.set_text(f't = {run.t[k]:.3f} s')
        show(k)

    # Laid out once, which takes as long as drawing: nothing changes its size from then on.
    update(int(samples[0]))
    figure.draw_without_rendering()
    figure.set_layout_engine('none')
    from matplotlib.animation import FuncAnimation
    return FuncAnimation(figure, update, frames=samples.tolist(), interval=1000.0 / rate)


def _portrait(run: TrajectoryData) -> tuple['Figure', _Show]:
    """Return a figure of the phase portraits, in which a point follows each path."""
    shown = portrayed(run)
    figure = draw_portrait(run, contours=len(run.coordinates) == 1)
    points = [axes.plot([], [], 'o', color=COLOURS[2], markersize=9.0, zorder=4)[0]
              for axes in figure.axes]

    def show(k: int) -> None:
        for point, (_, i, j) in zip(points, shown, strict=True):
            point.set_data([run.q[k, i]], [run.p[k, j]])
    return figure, show


def _mechanism(run: TrajectoryData, mechanism: Mechanism) -> tuple['Figure', _Show]:
    """Return a figure of the mechanism, seen along the axis in which it extends least."""
    parts = mechanism(run.q, float(np.abs(run.q).max()) or 1.0)
    bounds = bounds_of(parts)
    moved = bounds_of({name: part for name, part in parts.items() if part.moves})
    # A tie hides y, so that x is to the right and z up; see REP 103.
    extents = np.ptp(moved, axis=0)
    hidden = 1 if extents[1] <= extents.min() * (1.0 + 1e-9) else int(extents.argmin())
    across, up = (axis for axis in range(3) if axis != hidden)
    size = np.ptp(bounds, axis=0)
    share = float(np.clip(size[up] / size[across], 0.4, 1.6))
    figure = new_figure(_SIDE, _SIDE * share + 0.9)
    axes = figure.subplots()
    low, high = bounds - _MARGIN * size.max() * np.array([[1.0], [-1.0]])
    axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect='equal',
             xlabel=_AXES[across], ylabel=_AXES[up])
    # Parts have the viewer's colours, on its dark ground.
    axes.set_facecolor(_GROUND)
    drawn = [_draw(axes, part, across, up) for part in parts.values()]

    def show(k: int) -> None:
        for move in drawn:
            move(k)
    return figure, show


def _draw(axes: 'Axes', part: Part, across: int, up: int) -> _Show:
    """Draw a part, and return what moves it to the place of a sample."""
    colour = tuple(value / 255.0 for value in part.color)
    if isinstance(part, Line):
        line, = axes.plot([], [], color=colour, linewidth=_LINE_WIDTH, solid_capstyle='round',
                          zorder=2)

        def move_line(k: int) -> None:
            points = part.points[k] if part.moves else part.points
            line.set_data(points[:, across], points[:, up])
        return move_line
    if isinstance(part, Trail):
        path = np.reshape(part.point, (-1, 3))
        trail, = axes.plot([], [], color=colour, linewidth=0.5 * _LINE_WIDTH, zorder=1)

        def move_trail(k: int) -> None:
            trail.set_data(path[:k + 1, across], path[:k + 1, up])
        return move_trail
    from matplotlib.patches import Circle, Rectangle
    if isinstance(part, Ball):
        ball = Circle((0.0, 0.0), part.radius, color=colour, zorder=3)
        axes.add_patch(ball)

        def move_ball(k: int) -> None:
            ball.center = (part.center[k] if part.moves else part.center)[[across, up]]
        return move_ball
    half = np.array(part.half_size)[[across, up]]
    box = Rectangle((0.0, 0.0), *2.0 * half, color=colour, zorder=3)
    axes.add_patch(box)

    def move_box(k: int) -> None:
        center = part.center[k] if part.moves else part.center
        box.set_xy(center[[across, up]] - half)
    return move_box
