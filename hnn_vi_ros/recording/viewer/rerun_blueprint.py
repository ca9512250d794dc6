# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Paths and styles of the entities of a rerun recording, and the layout of its views."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from operator import attrgetter, itemgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from hnn_vi_ros.hamiltonians import Ball, Hamiltonian, Line, Part, Trail
from hnn_vi_ros.phase_space import (
    column_units, columns, Coordinate, energy_unit, momentum_name, raised)
from hnn_vi_ros.recording.sample import Sample
from hnn_vi_ros.recording.viewer.phase_portrait import contours, Frame, ticks
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

PALETTE = ((88, 166, 255), (242, 165, 65), (86, 211, 100), (219, 109, 190), (121, 216, 217),
           (255, 123, 114), (210, 168, 255), (225, 210, 90))
BACKGROUND, INK, GREY, WHITE = (13, 17, 23), (170, 180, 195), (72, 82, 98), (245, 247, 250)
LOW, HIGH = np.array([38, 62, 104]), np.array([92, 138, 190])


def phase_path(coordinate: Coordinate) -> str:
    """Return the entity that holds a coordinate's phase portrait."""
    return f'/phase/{rr.escape_entity_path_part(coordinate.name)}'


def part_path(name: str) -> str:
    """Return the entity that holds a part of the mechanism."""
    return f'/world/{rr.escape_entity_path_part(name)}'


class Series(NamedTuple):
    """
    Curves of one entity: a row of the table that recordings and their layout are made of.

    Parameters
    ----------
    path : str
        The entity.
    names : list of str
        Names of the curves, with units.
    plot : str
        Title of the plot that shows them.
    value : callable
        Function that returns the values at a sample, or at a timing: a number, or one for each
        curve.
    color : int, optional
        Place of the first curve in PALETTE.
    tab : str, optional
        Name of the tab with that plot.
    band : bool, optional
        True for the ends of bands: all lower ones, then all upper ones.

    """

    path: str
    names: list[str]
    plot: str
    value: Callable[[Any], Any]
    color: int = 0
    tab: str = 'Motion'
    band: bool = False


# Wall time of a step.
TIMING = (Series('/timing/microseconds_per_step', ['p50 [µs]', 'p99 [µs]'], 'Step time',
                 itemgetter(2), 3, 'Timing'),
          Series('/timing/real_time_factor', ['real-time factor'], 'Pace', itemgetter(3), 6,
                 'Timing'))
_CAUSES = {'stored': 'Stored energy', 'work': 'Work', 'heat': 'Heat'}


def series_of(hamiltonian: Hamiltonian, relative: bool, conservative: bool, modified: bool,
              band: bool = False, causes: Sequence[str] = ()) -> Iterator[Series]:
    """
    Yield the series of a run.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H, with a curve for each coordinate, momentum and further invariant.
    relative : bool
        True if the energy error is relative to H0.
    conservative : bool
        True if no effect does work; otherwise the work W is shown.
    modified : bool
        True if a modified energy is known; it is shown if no work is done.
    band : bool, optional
        True if there are bands around q and p.
    causes : sequence of str, optional
        Names of the energies by cause, such as ``work/servo``.

    """
    coordinates, invariants = hamiltonian.coordinates, hamiltonian.invariants
    unit, (q_units, p_units) = raised(energy_unit(coordinates)), column_units(coordinates)
    q_names, p_names = columns(coordinates)
    for half, plot, names, units in (('q', 'Coordinates', q_names, q_units), (
            'p', 'Momenta', [*map(momentum_name, p_names)], p_units)):
        yield Series(f'/state/{half}', [f'{name} [{raised(own)}]' for name, own in zip(
            names, units, strict=True)], plot, attrgetter(half))
        if band:
            yield Series(f'/state/{half}_band', [
                f'{name} {end}' for end in ('lowest', 'highest') for name in names],
                plot, partial(_ends_of_band, half), band=True)
    yield Series('/energy/H', [f'H [{unit}]'], 'Energy', attrgetter('energy'))
    if not conservative:
        yield Series('/energy/work', [f'work W [{unit}]'], 'Energy', attrgetter('work'), 1)
    elif modified:
        yield Series('/energy/modified', [f'modified H [{unit}]'], 'Energy',
                     attrgetter('modified_energy'), 2)
    error = 'H - H0' if conservative else 'H - H0 - W'
    yield Series('/energy/error', [f'({error}) / |H0|' if relative else f'{error} [{unit}]'],
                 'Energy error', attrgetter('energy_error'), 5)
    if invariants:
        yield Series('/invariants', list(invariants), 'Invariants', lambda sample: [
            function(sample.q, sample.p) for function in invariants.values()], 4)
    for kind, plot in _CAUSES.items():
        if own := [k for k, name in enumerate(causes) if name.startswith(f'{kind}/')]:
            names = [causes[k].partition('/')[2].replace('hamiltonian', 'rest of H') for k in own]
            yield Series(f'/energy_by_cause/{kind}', [f'{name} [{unit}]' for name in names], plot,
                         partial(_causes_at, own), tab='Energy by cause')


def _causes_at(entries: list[int], sample: Sample) -> np.ndarray:
    assert sample.causes is not None, 'requested'
    return sample.causes[entries]


def _ends_of_band(half: str, sample: Sample) -> np.ndarray:
    values, d = getattr(sample, half), sample.q.size
    width = np.zeros(d + sample.p.size) if sample.spread is None else sample.spread
    width = width[:d] if half == 'q' else width[d:]
    return np.hstack([values - width, values + width])


def without_unit(names: Sequence[str]) -> tuple[list[str], str]:
    """Return names without their common unit, and the unit as ' [unit]' for a title."""
    parts = [name.rpartition(' [') for name in names]
    unit = parts[0][2]
    if len(names) < 2 or not parts[0][1] or any(part[1:] != (' [', unit) for part in parts):
        return list(names), ''
    return [name for name, _, _ in parts], f' [{unit}'


def log_series_styles(stream: rr.RecordingStream, rows: Sequence[Series]) -> None:
    """Name and colour every series."""
    for row in rows:
        # The ends of a band are thin lines in the colours of the curve inside it.
        count = len(row.names) // (2 if row.band else 1)
        colors = [PALETTE[(row.color + i % count) % len(PALETTE)] for i in range(len(row.names))]
        # By default the viewer averages samples that share a pixel, which hides oscillations.
        style = rr.SeriesLines(
            colors=colors, names=without_unit(row.names)[0],
            widths=[0.7 if row.band else 2.0] * len(row.names),
            aggregation_policy=rr.components.AggregationPolicy.MinMax)
        stream.log(row.path, style, static=True, strict=True)


def log_phase_portrait(stream: rr.RecordingStream, hamiltonian: Hamiltonian, frame: Frame,
                       q0: np.ndarray, p0: np.ndarray, side: float) -> None:
    """
    Draw the energy contours, the frame and its ticks, and style the trail and the state.

    ``side`` is the width of the frame in points, for placing the labels.

    Every point is logged as (q, p). The entity's transform maps the frame to the square from -1 to
    1 with p upwards, since a 2D view has its y axis down and equal scales.
    """
    coordinate = hamiltonian.coordinates[frame.axis]
    path = phase_path(coordinate)
    levels = contours(hamiltonian, frame, q0, p0)
    strips = [line for _, lines in levels for line in lines]
    shares = np.repeat(np.linspace(0.0, 1.0, len(levels)), [len(lines) for _, lines in levels])
    colors = (LOW + shares[:, None] * (HIGH - LOW)).astype(np.uint8)
    (q_low, q_high), (p_low, p_high) = frame.q, frame.p
    half_q, half_p = 0.5 * (q_high - q_low), 0.5 * (p_high - p_low)
    still = {
        '': rr.Transform3D(scale=[1.0 / half_q, -1.0 / half_p, 1.0],
                           translation=[-0.5 * (q_low + q_high) / half_q,
                                        0.5 * (p_low + p_high) / half_p, 0.0]),
        '/contours': rr.LineStrips2D(strips, colors=colors, radii=rr.Radius.ui_points(0.6)),
        '/frame': _frame_lines(frame),
        '/labels': _frame_labels(frame, coordinate, side),
        '/trail': rr.LineStrips2D.from_fields(colors=[PALETTE[1]], draw_order=30.0,
                                              radii=rr.Radius.ui_points(1.25)),
        '/state': rr.Points2D.from_fields(colors=[WHITE], radii=rr.Radius.ui_points(5.0),
                                          draw_order=40.0),
    }
    for child, archetype in still.items():
        stream.log(path + child, archetype, static=True, strict=True)


def _frame_lines(frame: Frame) -> rr.LineStrips2D:
    (left, right), (low, high) = frame.q, frame.p
    strips = [[(left, low), (right, low), (right, high), (left, high), (left, low)]]
    dash_q, dash_p = 0.015 * (right - left), 0.015 * (high - low)
    strips += [[(q, low), (q, low + dash_p)] for q in ticks(frame.q)]
    strips += [[(left, p), (left + dash_q, p)] for p in ticks(frame.p)]
    return rr.LineStrips2D(strips, colors=[GREY], radii=rr.Radius.ui_points(0.6))


def _frame_labels(frame: Frame, coordinate: Coordinate, side: float) -> rr.Points2D:
    """Place the labels; the viewer writes each just below its point, so p's labels are raised."""
    (left, right), (low, high) = frame.q, frame.p
    # One point in the units of each axis.
    dq, dp = (right - left) / side, (high - low) / side
    texts = {(q, low - 2.0 * dp): f'{q:g}' for q in ticks(frame.q)}
    texts |= {(left - 24.0 * dq, p + 15.0 * dp): f'{p:g}' for p in ticks(frame.p)}
    texts[0.5 * (left + right), low - 32.0 * dp] = (
        f'{coordinate.name} [{raised(coordinate.q_unit)}]')
    texts[left + 15.0 * dq, high + 42.0 * dp] = (
        f'{momentum_name(coordinate.name)} [{raised(coordinate.p_unit)}]')
    return rr.Points2D(list(texts), labels=list(texts.values()), show_labels=True, colors=[INK],
                       radii=rr.Radius.ui_points(0.01))


def log_mechanism_styles(stream: rr.RecordingStream, parts: Mapping[str, Part]) -> None:
    """Draw the fixed parts, and style the moving ones."""
    stream.log('/world', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    for name, part in parts.items():
        still: rr.AsComponents
        if isinstance(part, Line | Trail):
            strips = [part.points] if isinstance(part, Line) and not part.moves else None
            still = rr.LineStrips3D.from_fields(
                strips=strips, radii=[part.radius], colors=[part.color])
        else:
            kind, half_size = (rr.Ellipsoids3D, 3 * (part.radius,)) if isinstance(
                part, Ball) else (rr.Boxes3D, part.half_size)
            still = kind.from_fields(
                centers=None if part.moves else [part.center], half_sizes=[half_size],
                colors=[part.color], fill_mode=rr.components.FillMode.Solid)
        stream.log(part_path(name), still, static=True, strict=True)


TRAIL_SAMPLES = 300
# Maximum number of phase portraits next to a mechanism.
MOST_BESIDE = 2
# Sizes in points: column of mechanism and portraits in a window of 1400 x 900, bar above each
# view, and margins for a portrait's labels on the left, right, top and bottom.
COLUMN, BAR, MARGINS = (588.0, 830.0), 28.0, (58.0, 18.0, 46.0, 60.0)
# The viewer's vertical angle of view.
VIEW_ANGLE = np.radians(55.0)
# Free shares of the time axis at its end: for a legend, and for the last label only.
_LEGEND_ROOM, _END_ROOM = 0.25, 0.04
# In points: widths of a plot, of a letter and of the edges of a legend, height of a plot for each
# line of its legend, which fills 0.78 of it, and of the axis below, and minimum height of a view.
_PLOT_WIDTH, _LETTER_WIDTH, _LEGEND_EDGES = 775.0, 7.6, 42.0
_LEGEND_LINE, _AXIS, _MIN_HEIGHT = 29.6, 29.0, 112.0
_EVENTS_HEIGHT = 0.75 * _MIN_HEIGHT
# Minimum share of a run with known duration that a trail shows.
_TRAIL_SHARE = 0.2
# Distance of ticks with labels, in points, and their number over the lowest plot.
_TICK_GAP, _TICK_GAPS = 26.0, 5.0
# Values below the first are rounding of zero; the range of a plot that shows them.
_ROUNDING, _ROUNDING_RANGE = 1e-12, (-1.3e-9, 1.3e-9)


class SeriesExtent(NamedTuple):
    """
    Ranges of times and values covered by series.

    Parameters
    ----------
    times : tuple of int
        First and last time [ns].
    values : mapping of str to (float, float)
        Minimum and maximum finite value by entity.

    """

    times: tuple[int, int]
    values: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Arrangement:
    """
    Arrangement of the views that share the left column.

    Parameters
    ----------
    portraits : int
        Number of phase portraits; at most MOST_BESIDE next to a mechanism.
    bounds : np.ndarray, shape (2, 3), or None
        Minimum and maximum corner of the mechanism's reach [m]; None without a mechanism.
    hidden : str, optional
        Entity of the mechanism whose children are hidden.

    """

    portraits: int
    bounds: np.ndarray | None
    hidden: str = ''

    @property
    def tabbed(self) -> bool:
        """Return whether there are too many portraits to show them next to each other."""
        return self.portraits > 4

    @property
    def columns(self) -> int:
        """Return the number of portraits in a row."""
        if self.tabbed or self.portraits <= 1:
            return 1
        return 1 if self.portraits == 2 and self.bounds is None else 2

    @property
    def world_share(self) -> float:
        """Share of the height reserved for the mechanism."""
        # Two portraits in a row are half as high as one.
        return 0.0 if self.bounds is None else (0.78, 0.32, 0.55)[self.portraits]

    @property
    def world_aspect(self) -> float:
        """Width of the view of the mechanism over its height."""
        return COLUMN[0] / (self.world_share * COLUMN[1] - BAR)

    @property
    def side(self) -> float:
        """Return width and height of a portrait's frame, in points; 0 without portraits."""
        if not self.portraits:
            return 0.0
        rows = 1 if self.tabbed else -(-self.portraits // self.columns)
        left, right, top, bottom = MARGINS
        height = COLUMN[1] * (1.0 - self.world_share) / rows - BAR
        return min(COLUMN[0] / self.columns - left - right, height - top - bottom)


def make_blueprint(coordinates: Sequence[Coordinate], rows: Sequence[Series],
                   arrangement: Arrangement, interval: int, pace: float | None = None,
                   trails: Sequence[str] = (), extent: SeriesExtent | None = None
                   ) -> rrb.Blueprint:
    """
    Return the layout of the views for a window of about 1400 x 900 points.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Coordinates with one phase portrait each.
    rows : sequence of Series
        The series of the run.
    arrangement : Arrangement
        Arrangement with as many portraits.
    interval : int
        Simulated time between two samples [ns]; the trail is TRAIL_SAMPLES of them long, and if
        the extent is known at least a fifth of the run.
    pace : float, optional
        Requested real-time factor.
    trails : sequence of str, optional
        Parts of the mechanism with a trail of the same length.
    extent : Extent, optional
        Times and values of the series, if known; otherwise the viewer fits its axes to the data,
        and a legend covers part of them.

    """
    trail = 1e-9 * TRAIL_SAMPLES * interval
    if extent is not None:
        trail = max(trail, 1e-9 * _TRAIL_SHARE * (extent.times[1] - extent.times[0]))
    views = [_phase_view(coordinate, trail, arrangement.side) for coordinate in coordinates]
    world = None if arrangement.bounds is None else _world_view(
        arrangement.bounds, arrangement.world_aspect,
        {part_path(name): _recent(trail) for name in trails}, arrangement.hidden)
    left = _left_column(world, views, arrangement)
    plots = _plots_of(rows, 'Motion')
    names = [names_of(plot)[0] for plot in plots.values()]
    # All time axes end together, after the longest legend.
    room = max(map(legend_share, names))
    shares = [*map(height_for, names)]
    # A mechanism alone leaves room below.
    alone = world if left is world else None
    total = sum(shares) + (_EVENTS_HEIGHT if alone is None else 0.0)
    gaps = [max((COLUMN[1] * share / total - BAR - _AXIS) / _TICK_GAP, _TICK_GAPS)
            for share in shares]
    panes: list[rrb.View] = [
        _series_view(title, plot, extent, room, gaps=most)
        for (title, plot), most in zip(plots.items(), gaps, strict=True)]
    if alone is not None:
        share = arrangement.world_share
        left = rrb.Vertical(alone, _events_view(), row_shares=[share, 1.0 - share])
    else:
        panes.append(_events_view())
        shares.append(_EVENTS_HEIGHT)
    motion = rrb.Vertical(*panes, row_shares=shares, name='Motion')
    tabs = [_tab(tab, rows, extent) for tab in dict.fromkeys(
        row.tab for row in rows if row.tab != 'Motion')]
    # Start the axis at zero; otherwise jitter of a percent would fill the plot.
    timing = _tab('Timing', TIMING, extent, {} if pace is None else {'Pace': (0.0, 1.25 * pace)})
    right = rrb.Tabs(motion, *tabs, timing)
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[0.42, 0.58])
        if left is not None else right,
        rrb.BlueprintPanel(state='collapsed'), rrb.SelectionPanel(state='collapsed'),
        rrb.TimePanel(state='collapsed', timeline='sim_time', play_state='following'),
        auto_views=False)


def _left_column(world: rrb.View | None, views: Sequence[rrb.View], arrangement: Arrangement
                 ) -> rrb.Container | rrb.View | None:
    """Arrange the existing mechanism and portraits in a column without gaps."""
    if not views:
        return world
    portraits = rrb.Tabs(*views) if arrangement.tabbed else rrb.Grid(
        *views, grid_columns=arrangement.columns)
    if world is None:
        return portraits
    share = arrangement.world_share
    return rrb.Vertical(world, portraits, row_shares=[share, 1.0 - share])


def _plots_of(rows: Sequence[Series], tab: str) -> dict[str, list[Series]]:
    """Return the series of each plot of a tab by its title."""
    plots: dict[str, list[Series]] = {}
    for row in rows:
        if row.tab == tab:
            plots.setdefault(row.plot, []).append(row)
    return plots


def _tab(name: str, rows: Sequence[Series], extent: SeriesExtent | None,
         least: Mapping[str, tuple[float, float]] = MappingProxyType({})) -> rrb.Vertical:
    """Return the plots of a tab in a column, some with the least range of their axis."""
    plots = _plots_of(rows, name)
    room = max(legend_share(names_of(plot)[0]) for plot in plots.values())
    return rrb.Vertical(*(_series_view(title, plot, extent, room, least.get(title))
                          for title, plot in plots.items()), name=name)


def _series_view(title: str, rows: Sequence[Series], extent: SeriesExtent | None, room: float,
                 least: tuple[float, float] | None = None, gaps: float = _TICK_GAPS
                 ) -> rrb.TimeSeriesView:
    """Plot some series; a single one is named in the title, where no legend hides data."""
    axis_y = None if least is None else rrb.ScalarAxis(range=least)
    names, unit = names_of(rows)
    title += f' {names[0]}' if len(names) == 1 else unit
    many = len(names) > 1
    axis_x = None
    if extent is not None:
        # The legend is placed after the last sample.
        begin, end = extent.times
        last = end + round(room * max(end - begin, 1))
        axis_x = rrb.TimeAxis(view_range=rr.TimeRange(
            start=rrb.TimeRangeBoundary.absolute(seconds=begin * 1e-9),
            end=rrb.TimeRangeBoundary.absolute(seconds=last * 1e-9)))
        ranges = [extent.values[row.path] for row in rows if row.path in extent.values]
        if ranges and least is None:
            axis_y = rrb.ScalarAxis(range=with_ticks(
                min(low for low, _ in ranges), max(high for _, high in ranges), gaps))
    return rrb.TimeSeriesView(
        name=title, origin='/', contents=[row.path for row in rows], axis_x=axis_x,
        axis_y=axis_y,
        plot_legend=rrb.PlotLegend(corner='RightTop', visible=many))


def names_of(rows: Sequence[Series]) -> tuple[list[str], str]:
    """Return the legend entries of a view's series, and the unit for its title."""
    found = [without_unit(row.names) for row in rows]
    return [name for names, _ in found for name in names], found[0][1]


def legend_share(names: Sequence[str]) -> float:
    """Return the share of the time axis to leave free for a legend of these names."""
    if len(names) < 2:
        return _END_ROOM
    share = min((_LEGEND_EDGES + _LETTER_WIDTH * max(map(len, names))) / _PLOT_WIDTH, 0.5)
    return max(_LEGEND_ROOM, share / (1.0 - share))


def height_for(names: Sequence[str]) -> float:
    """Return the height of a view, in points, for a legend of up to eight names."""
    return max(_MIN_HEIGHT, BAR + _AXIS + _LEGEND_LINE * min(len(names), len(PALETTE)))


def with_ticks(low: float, high: float, gaps: float = _TICK_GAPS) -> tuple[float, float]:
    """
    Return a range with the values, a margin, and two ticks with their labels.

    The viewer labels multiples of a power of ten that are at least some 25 points apart: of the
    smallest one that fits at most ``gaps`` times into the range. It writes no labels of about
    1e-13 and below.
    """
    if 0.0 < max(abs(low), abs(high)) < _ROUNDING:
        return _ROUNDING_RANGE
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        # A constant: show zero as well, or one of its digits.
        low, high = min(low, 0.0), max(high, 0.0)
    if high == low:
        return -1.0, 1.0
    width = 1.12 * (high - low)
    middle = 0.5 * (low + high)
    low, high = middle - 0.5 * width, middle + 0.5 * width
    gap = 10.0 ** np.ceil(np.log10(width / gaps) - 1e-9)
    first, last = np.ceil(low / gap), np.floor(high / gap)
    # Extend the range to the nearest ticks until there are two, with room for their labels.
    while last - first < 1.0:
        if low - (first - 1.0) * gap < (last + 1.0) * gap - high:
            first -= 1.0
        else:
            last += 1.0
    low, high = min(low, (first - 0.12) * gap), max(high, (last + 0.12) * gap)
    return float(low), float(high)


def _events_view() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=['sim_time'],
                                 text_log_columns=['LogLevel', 'Body'])
    return rrb.TextLogView(name='Events', origin='/events', columns=columns)


def _recent(seconds: float) -> rrb.VisibleTimeRanges:
    """Return the time range of a trail."""
    recent = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)
    now, step_now = (rrb.TimeRangeBoundary.cursor_relative(),
                     rrb.TimeRangeBoundary.cursor_relative(seq=0))
    return rrb.VisibleTimeRanges([
        rrb.VisibleTimeRange('sim_time', start=recent, end=now),
        rrb.VisibleTimeRange('ros_time', start=recent, end=now),
        rrb.VisibleTimeRange('step', start=rrb.TimeRangeBoundary.infinite(), end=step_now),
    ])


def _phase_view(coordinate: Coordinate, trail: float, side: float) -> rrb.Spatial2DView:
    path = phase_path(coordinate)
    left, right, top, bottom = (1.0 + 2.0 * margin / side for margin in MARGINS)
    return rrb.Spatial2DView(
        name=f'Phase portrait of {coordinate.name}', origin='/phase', contents=f'{path}/**',
        background=BACKGROUND, overrides={f'{path}/trail': _recent(trail)},
        visual_bounds=rrb.VisualBounds2D(x_range=[-left, right], y_range=[-top, bottom]))


def _world_view(bounds: np.ndarray, aspect: float, trails: Mapping[str, rrb.VisibleTimeRanges],
                hidden: str) -> rrb.Spatial3DView:
    contents = ['$origin/**', *([f'- {hidden}/**'] if hidden else [])]
    return rrb.Spatial3DView(
        name='Mechanism', origin='/world', contents=contents, background=BACKGROUND,
        overrides=dict[Any, Any](trails),
        line_grid=rrb.LineGrid3D(visible=False), eye_controls=rrb.EyeControls3D(
            position=eye_of(bounds, aspect), look_target=bounds.mean(axis=0),
            eye_up=[0.0, 0.0, 1.0]))


def eye_of(bounds: np.ndarray, aspect: float) -> np.ndarray:
    """
    Return a camera position that sees the bounds: from the front, flat ones from above.

    Parameters
    ----------
    bounds : np.ndarray, shape (2, 3)
        Minimum and maximum corner [m].
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
