# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The views fit into the window, whatever there is to show."""

from hnn_vi_ros.viewer.rerun_blueprint import Arrangement, BAR, COLUMN, eye_of, MARGINS, VIEW_ANGLE
import numpy as np
import pytest

BOUNDS = np.array([[-1.0, -0.5, 0.0], [2.0, 0.5, 1.0]])


@pytest.mark.parametrize('bounds', [None, BOUNDS], ids=['bare', 'mechanism'])
@pytest.mark.parametrize('portraits', range(1, 9))
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
