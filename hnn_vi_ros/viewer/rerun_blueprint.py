# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How a rerun recording lays its views out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.viewer.rerun_layout import (
    BACKGROUND, BANDS, part_path, phase_path, TIMING)
import numpy as np
import rerun.blueprint as rrb

TRAIL_SAMPLES = 300
# Sizes in points: the column of mechanism and portraits in a window of 1400 x 900, the bar above
# each view, and what a portrait's labels need on the left, right, top and bottom of its frame.
COLUMN, BAR, MARGINS = (588.0, 830.0), 28.0, (58.0, 18.0, 46.0, 60.0)
# The viewer's vertical angle of view.
VIEW_ANGLE = np.radians(55.0)
# What is plotted together.
ENERGIES = ('/energy/H', '/energy/modified', '/energy/work')
INVARIANTS = '/invariants'


@dataclass(frozen=True)
class Arrangement:
    """
    How the views share the left column.

    Parameters
    ----------
    portraits : int
        Number of phase portraits.
    bounds : np.ndarray, shape (2, 3), or None
        Lowest and highest corner of what the mechanism can reach [m]; None if there is none.
    hidden : str, optional
        The entity of the mechanism below which nothing is shown.

    """

    portraits: int
    bounds: np.ndarray | None
    hidden: str = ''

    @property
    def tabbed(self) -> bool:
        """Whether the portraits lie on top of each other, since there are too many."""
        return self.portraits > 4

    @property
    def columns(self) -> int:
        """Portraits beside each other."""
        if self.tabbed or self.portraits == 1:
            return 1
        return 1 if self.portraits == 2 and self.bounds is None else 2

    @property
    def world_share(self) -> float:
        """Share of the height that the mechanism has."""
        if self.bounds is None:
            return 0.0
        # Two portraits beside each other are half as high as one; four are in two rows of such.
        return {2: 0.55, 3: 0.25, 4: 0.25}.get(self.portraits, 0.32)

    @property
    def side(self) -> float:
        """Return width and height of a portrait's frame, in points."""
        rows = 1 if self.tabbed else max(1, -(-self.portraits // self.columns))
        left, right, top, bottom = MARGINS
        height = COLUMN[1] * (1.0 - self.world_share) / rows - BAR
        return min(COLUMN[0] / self.columns - left - right, height - top - bottom)


def make_blueprint(coordinates: Sequence[Coordinate], labels: Mapping[str, Sequence[str]],
                   arrangement: Arrangement, interval: int, pace: float | None = None,
                   trails: Sequence[str] = ()) -> rrb.Blueprint:
    """
    Lay the views out for a window of about 1400 x 900 points.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        One phase portrait each.
    labels : mapping of str to sequence of str
        What :func:`series_labels` returns.
    arrangement : Arrangement
        Of as many portraits.
    interval : int
        Simulated time between two samples [ns]; the trail is TRAIL_SAMPLES of them long.
    pace : float, optional
        The real-time factor that is asked for.
    trails : sequence of str, optional
        Parts of the mechanism that leave a trail of that length as well.

    """
    views = [_phase_view(coordinate, interval, arrangement.side) for coordinate in coordinates]
    left: rrb.Container = rrb.Tabs(*views) if arrangement.tabbed else rrb.Grid(
        *views, grid_columns=arrangement.columns)
    share = arrangement.world_share
    if arrangement.bounds is not None:
        world = _world_view(arrangement.bounds, COLUMN[0] / (share * COLUMN[1] - BAR),
                            {part_path(name): _recent(interval) for name in trails},
                            arrangement.hidden)
        left = rrb.Vertical(world, left, row_shares=[share, 1.0 - share])
    energies = [path for path in labels if path in ENERGIES]
    errors = [_series_view('Energy error', ['/energy/error'], labels)]
    if INVARIANTS in labels:
        errors.append(_series_view('Invariants', [INVARIANTS], labels))
    q_paths, p_paths = ([path, band] if band in labels else [path]
                        for path, band in zip(('/state/q', '/state/p'), BANDS, strict=True))
    right = rrb.Vertical(
        rrb.Horizontal(_series_view('Coordinate', q_paths, labels),
                       _series_view('Momentum', p_paths, labels)),
        _series_view('Energy', energies, labels),
        rrb.Horizontal(*errors, _timing_views(pace),
                       column_shares=[0.68 / len(errors)] * len(errors) + [0.32]),
        _events_view(), row_shares=[0.24, 0.24, 0.345, 0.175])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[0.42, 0.58])
        if views or arrangement.bounds is not None else right,
        rrb.BlueprintPanel(state='collapsed'), rrb.SelectionPanel(state='collapsed'),
        rrb.TimePanel(state='collapsed', timeline='sim_time', play_state='following'),
        auto_views=False)


def _series_view(title: str, paths: Sequence[str], labels: Mapping[str, Sequence[str]]
                 ) -> rrb.TimeSeriesView:
    """Plot some series; a single one is named in the title, where no legend hides data."""
    names = [name for path in paths for name in labels[path]]
    if len(names) == 1:
        title = f'{title} {names[0]}'
    legend = rrb.PlotLegend(corner='LeftTop', visible=len(names) > 1)
    return rrb.TimeSeriesView(name=title, origin='/', contents=paths, plot_legend=legend)


def _timing_views(pace: float | None) -> rrb.Vertical:
    # From zero on: else the plot would be filled by a jitter of a percent.
    axis = None if pace is None else rrb.ScalarAxis(range=(0.0, 1.25 * pace))
    titles = ('Step time p50, p99 [us]', 'Real-time factor')
    return rrb.Vertical(*(
        rrb.TimeSeriesView(name=title, origin='/', contents=[path], axis_y=axis_y,
                           plot_legend=rrb.PlotLegend(visible=False))
        for title, path, axis_y in zip(titles, TIMING, (None, axis), strict=True)),
        row_shares=[0.62, 0.38])


def _events_view() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=['sim_time'],
                                 text_log_columns=['LogLevel', 'Body'])
    return rrb.TextLogView(name='Events', origin='/events', columns=columns)


def _recent(interval: int) -> rrb.VisibleTimeRanges:
    """Return the times that a trail goes back to."""
    seconds = TRAIL_SAMPLES * interval * 1e-9
    recent = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)
    now, step_now = (rrb.TimeRangeBoundary.cursor_relative(),
                     rrb.TimeRangeBoundary.cursor_relative(seq=0))
    return rrb.VisibleTimeRanges([
        rrb.VisibleTimeRange('sim_time', start=recent, end=now),
        rrb.VisibleTimeRange('ros_time', start=recent, end=now),
        rrb.VisibleTimeRange('step', start=rrb.TimeRangeBoundary.infinite(), end=step_now),
    ])


def _phase_view(coordinate: Coordinate, interval: int, side: float) -> rrb.Spatial2DView:
    path = phase_path(coordinate)
    left, right, top, bottom = (1.0 + 2.0 * margin / side for margin in MARGINS)
    return rrb.Spatial2DView(
        name=f'Phase portrait of {coordinate.name}', origin='/phase', contents=f'{path}/**',
        background=BACKGROUND, overrides={f'{path}/trail': _recent(interval)},
        visual_bounds=rrb.VisualBounds2D(x_range=[-left, right], y_range=[-top, bottom]))


def _world_view(bounds: np.ndarray, aspect: float, trails: Mapping[str, rrb.VisibleTimeRanges],
                hidden: str) -> rrb.Spatial3DView:
    contents = ['$origin/**', *([f'- {hidden}/**'] if hidden else [])]
    return rrb.Spatial3DView(
        name='Mechanism', origin='/world', contents=contents, background=BACKGROUND,
        overrides=dict(trails),
        line_grid=rrb.LineGrid3D(visible=False), eye_controls=rrb.EyeControls3D(
            position=eye_of(bounds, aspect), look_target=bounds.mean(axis=0),
            eye_up=[0.0, 0.0, 1.0]))


def eye_of(bounds: np.ndarray, aspect: float) -> np.ndarray:
    """
    Return from where all within the bounds is seen: from the front, what lies flat from above.

    Parameters
    ----------
    bounds : np.ndarray, shape (2, 3)
        Lowest and highest corner [m].
    aspect : float
        Width of the view over its height.

    """
    center, size = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    flat = size[2] < 0.3 * size[1]
    back = np.array([0.0, -0.42, 0.91] if flat else [0.07, -0.95, 0.31])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    corners = np.array(list(product(*bounds.T))) - center
    sides = np.maximum(abs(corners @ np.cross(back, right)), abs(corners @ right) / aspect)
    distance = (corners @ back + sides / np.tan(0.5 * VIEW_ANGLE)).max()
    return center + 1.05 * distance * back
