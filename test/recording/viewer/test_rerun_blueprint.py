# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The views fit into the window, whatever there is to show."""

from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.recording.viewer.rerun_blueprint import (
    _left_column, Arrangement, BAR, COLUMN, eye_of, height_for, make_blueprint, MARGINS, raised,
    room_after, series_labels, VIEW_ANGLE, with_ticks, without_unit)
import numpy as np
import pytest
import rerun.blueprint as rrb

BOUNDS = np.array([[-1.0, -0.5, 0.0], [2.0, 0.5, 1.0]])


@pytest.mark.parametrize('bounds', [None, BOUNDS], ids=['bare', 'mechanism'])
@pytest.mark.parametrize('portraits', range(1, 9))
def test_portraits_and_their_labels_fit_into_the_column(portraits: int, bounds):
    arrangement = Arrangement(portraits, bounds)
    rows = 1 if arrangement.tabbed else -(-portraits // arrangement.columns)
    left, right, top, bottom = MARGINS
    width = arrangement.columns * (arrangement.side + left + right)
    height = rows * (BAR + arrangement.side + top + bottom)
    # Three portraits and the mechanism fill two rows of two.
    assert arrangement.quarters == (portraits == 3 and bounds is not None)
    # Sums and differences of some hundred points, rounded to 1e-13.
    assert width <= COLUMN[0] + 1e-9
    assert height <= COLUMN[1] * (1.0 - arrangement.world_share) + 1e-9
    # Five ticks with their labels of about 35 points each.
    assert arrangement.side >= 175.0


def test_every_pane_of_the_left_column_holds_a_view():
    coordinates = [Coordinate(f'x{k}', 'm', 'kg m/s') for k in range(8)]
    for portraits in range(9):
        for bounds in (None, BOUNDS):
            views = [rrb.Spatial2DView() for _ in range(portraits)]
            world = None if bounds is None else rrb.Spatial3DView()
            left = _left_column(world, views, Arrangement(portraits, bounds))
            assert views_in(left) == portraits + (bounds is not None)
            assert make_blueprint(coordinates[:portraits], series_labels(
                coordinates, True, True, False), Arrangement(portraits, bounds), 1)
    # What has no portraits has the whole column.
    assert Arrangement(0, BOUNDS).world_aspect == COLUMN[0] / (COLUMN[1] - BAR)


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
    # The curves still fill at least a quarter of the height.
    assert high - low == 0.0 or end - begin < 4.0 * (high - low)


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


def test_a_legend_has_room_for_its_names():
    six, two = [f'p_shoulder_{k}' for k in range(6)], ['x', 'y']
    # Of the plot's 775 points: letters of 7 points, and some 40 for its mark and edges.
    for names in (six, two):
        free = room_after(names) / (1.0 + room_after(names))
        assert 775.0 * free >= 40.0 + 7.0 * max(map(len, names))
    assert room_after(['H [J]']) < room_after(two)
    # A line is 23 points high, the bar above a plot 28 and the times below it 20.
    rows = np.array([height_for(names) for names in (six, six, two[:1], two[:1])])
    height = COLUMN[1] * rows / (rows.sum() + 0.6 * height_for(two))
    assert height[0] >= 6 * 23.0 + BAR + 20.0
    # The others keep a plot of 60 points.
    assert height[2] >= BAR + 20.0 + 60.0
