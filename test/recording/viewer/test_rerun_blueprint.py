# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The views fit into the window, whatever there is to show."""

from types import SimpleNamespace

from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.recording.viewer.rerun_blueprint import (
    _left_column, Arrangement, BAR, COLUMN, eye_of, make_blueprint, MARGINS, MOST_BESIDE, raised,
    Series, series_of, SeriesExtent, VIEW_ANGLE, with_ticks, without_unit)
import numpy as np
import pytest
import rerun.blueprint as rrb

BOUNDS = np.array([[-1.0, -0.5, 0.0], [2.0, 0.5, 1.0]])


@pytest.mark.parametrize('portraits, bounds', [
    *((n, None) for n in range(1, 9)), *((n, BOUNDS) for n in range(1, MOST_BESIDE + 1))])
def test_portraits_and_their_labels_fit_into_the_column(portraits: int, bounds):
    arrangement = Arrangement(portraits, bounds)
    rows = 1 if arrangement.tabbed else -(-portraits // arrangement.columns)
    left, right, top, bottom = MARGINS
    width = arrangement.columns * (arrangement.side + left + right)
    height = rows * (BAR + arrangement.side + top + bottom)
    # Sums and differences of some hundred points, rounded to 1e-13.
    assert width <= COLUMN[0] + 1e-9
    assert height <= COLUMN[1] * (1.0 - arrangement.world_share) + 1e-9
    # Five ticks with their labels of about 35 points each.
    assert arrangement.side >= 175.0


def test_every_pane_of_the_left_column_holds_a_view():
    coordinates = [Coordinate(f'x{k}', 'm', 'kg m/s') for k in range(8)]
    for portraits in range(9):
        for bounds in (None, BOUNDS)[:1 + (portraits <= MOST_BESIDE)]:
            views = [rrb.Spatial2DView() for _ in range(portraits)]
            world = None if bounds is None else rrb.Spatial3DView()
            left = _left_column(world, views, Arrangement(portraits, bounds))
            assert views_in(left) == portraits + (bounds is not None)
            assert make_blueprint(coordinates[:portraits], rows_of(coordinates),
                                  Arrangement(portraits, bounds), 1)
    # Without portraits the events are below the mechanism.
    for portraits in (0, 1):
        left, right = make_blueprint(
            coordinates[:portraits], rows_of(coordinates), Arrangement(portraits, BOUNDS), 1
            ).root_container.contents
        assert [has_events(side) for side in (left, right)] == [portraits == 0, portraits == 1]


def test_time_axes_of_a_recording_begin_and_end_together():
    coordinates = [Coordinate(f'x{k}', 'm', 'kg m/s') for k in range(2)]
    blueprint = make_blueprint(
        coordinates, rows_of(coordinates), Arrangement(2, None), 1,
        extent=SeriesExtent((0, 10**9), {'/state/q': (-1.0, 1.0)}))
    ranges = [view.properties['TimeAxis'].view_range.as_arrow_array().to_pylist()
              for view in series_views(blueprint.root_container)[:4]]
    assert len(ranges) == 4 and all(one == ranges[0] for one in ranges)


def rows_of(coordinates: list[Coordinate]) -> list[Series]:
    """Return the series of a conservative run in coordinates."""
    return [*series_of(SimpleNamespace(coordinates=coordinates, invariants={}), True, True, False)]


def has_events(part) -> bool:
    """Return whether a part of a blueprint holds the events."""
    return isinstance(part, rrb.TextLogView) or (isinstance(part, rrb.Container) and any(
        map(has_events, part.contents)))


def series_views(part) -> list:
    """Return the plots of a part of a blueprint, in their order."""
    if isinstance(part, rrb.Container):
        return [view for child in part.contents for view in series_views(child)]
    return [part] if isinstance(part, rrb.TimeSeriesView) else []


def views_in(part) -> int:
    """Count the views, and find no container without any."""
    if part is None:
        return 0
    if not isinstance(part, rrb.Container):
        return 1
    assert part.contents
    return sum(views_in(child) for child in part.contents)


@pytest.mark.parametrize('bounds', [
    BOUNDS, np.array([[-2.0, -2.0, -0.1], [2.0, 2.0, 0.1]]),
    np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 5.0]]), 1e-3 * BOUNDS],
    ids=['side', 'flat', 'tall', 'tiny'])
@pytest.mark.parametrize('aspect', [0.5, 2.5])
def test_eye_sees_every_corner_and_is_not_too_far_away(bounds: np.ndarray, aspect: float):
    center = bounds.mean(axis=0)
    eye = eye_of(bounds, aspect)
    back = (eye - center) / np.linalg.norm(eye - center)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    corners = np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1]
                        for z in bounds[:, 2]]) - eye
    depth = -(corners @ back)
    slope = np.tan(0.5 * VIEW_ANGLE)
    vertical = abs(corners @ np.cross(back, right)) / depth / slope
    horizontal = abs(corners @ right) / depth / slope / aspect
    assert depth.min() > 0.0
    # The eye is 5 % further away than where a corner touches the edge.
    assert 0.8 < max(vertical.max(), horizontal.max()) < 1.0


@pytest.mark.parametrize('low, high', [
    (-1.0, 1.0), (-5.5, 6.3), (12.41, 12.59), (11.0, 17.0), (7.5, 13.0), (-8e-16, 3e-16),
    (0.3, 0.3), (0.0, 0.0), (-40.0, -40.0), (2.0, 1e7)])
def test_axis_has_two_ticks_with_labels_and_holds_the_values(low: float, high: float):
    begin, end = with_ticks(low, high)
    assert begin < low <= high < end
    # The viewer labels multiples of a power of ten that are 25 points apart, of 130 or more.
    gap = 10.0 ** np.ceil(np.log10(25.0 / 130.0 * (end - begin)))
    assert np.floor(end / gap) - np.ceil(begin / gap) >= 1.0
    # The curves still fill at least a quarter of the height, unless they are rounding.
    assert high - low == 0.0 or max(-low, high) < 1e-12 or end - begin < 4.0 * (high - low)


def test_higher_plot_has_more_ticks_instead_of_a_wider_axis():
    assert np.ptp(with_ticks(-2.5, 2.5)) > 10.0
    assert np.ptp(with_ticks(-2.5, 2.5, 6.0)) < 6.0


@pytest.mark.parametrize('unit, expected', [
    ('kg m2/s', 'kg m²/s'), ('m', 'm'), ('1', '1'), ('kg m2/s2', 'kg m²/s²'), ('s-1', 's⁻¹')])
def test_exponents_of_units_are_superscripts(unit: str, expected: str):
    assert raised(unit) == expected


@pytest.mark.parametrize('names, shown, title', [
    (['a [rad]', 'b_1 [rad]'], ['a', 'b_1'], ' [rad]'),
    # Of several units each stays with its name, and so does that of a single one.
    (['a [rad]', 'b [m]'], ['a [rad]', 'b [m]'], ''), (['a [m]'], ['a [m]'], ''),
    (['spin', 'a [m]'], ['spin', 'a [m]'], ''), (['spin', 'lift'], ['spin', 'lift'], '')])
def test_names_have_no_unit_that_the_title_has(names: list[str], shown: list[str], title: str):
    assert without_unit(names) == (shown, title)
