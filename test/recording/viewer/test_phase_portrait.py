# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Contours lie on level sets of H; frames and ticks fit what they frame."""

from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.recording import box_of, contours, Frame
from hnn_vi_ros.recording.viewer.phase_portrait import fit_frame, frame_of, GRID, ticks
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

MASS, STIFFNESS = 2.0, 8.0
FRAME = Frame(0, (-1.0, 1.5), (-4.0, 3.0))
Q0, P0 = np.array([1.0]), np.array([0.0])


def test_contours_lie_on_level_sets_of_H():
    oscillator = HarmonicOscillator(MASS, STIFFNESS)
    # Linear interpolation along an edge of length d errs by at most max |H''| d^2 / 8.
    cell = np.array([2.5, 7.0]) / (GRID - 1)
    tolerance = np.max(np.array([STIFFNESS, 1.0 / MASS]) * cell ** 2) / 8.0
    levels = contours(oscillator, FRAME, Q0, P0)
    assert len({level for level, _ in levels}) == len(levels)
    for level, lines in levels:
        assert lines
        points = np.vstack(lines)
        energy = oscillator.energy(points[:, :1], points[:, 1:])
        assert np.abs(energy - level).max() <= tolerance * (1.0 + 1e-9)


def test_contours_have_q_to_the_right_and_p_upwards():
    # k > 1/m: the ellipses of constant H are the wider in p.
    _, lines = contours(HarmonicOscillator(MASS, STIFFNESS), FRAME, Q0, P0)[0]
    width, height = np.ptp(np.vstack(lines), axis=0)
    assert height > 2.0 * width


def test_contours_leave_out_where_H_is_infinite():
    # On the x axis the centre of attraction lies on the grid.
    levels = contours(Kepler(), Frame(0, (-1.0, 1.0), (-1.0, 1.0)), np.array([1.0, 0.0]),
                      np.array([0.0, 1.0]))
    assert levels and np.isfinite([level for level, _ in levels]).all()
    points = np.vstack([line for _, lines in levels for line in lines])
    assert np.isfinite(points).all() and np.abs(points[:, 0]).min() > 0.0


def test_frame_is_the_box_of_the_training_data_widened_to_the_initial_state():
    box = (np.array([[-1.0, 1.0]]), np.array([[-2.0, 2.0]]))
    for q0, p0, expected in ((0.5, 0.5, Frame(0, (-1, 1), (-2, 2))),
                             (3.0, -5.0, Frame(0, (-1, 3), (-5, 2)))):
        assert frame_of(0, np.array([q0]), np.array([p0]), box) == expected


def test_box_of_a_path_holds_its_finite_states_with_a_margin():
    q, p = np.array([[-1.0], [3.0], [np.nan]]), np.array([[2.0], [2.0 + 1e-12], [0.0]])
    of_q, of_p = box_of(q, p)
    assert of_q.tolist() == [[pytest.approx(-1.4), pytest.approx(3.4)]]
    # What stays does not fill its axis with its rounding.
    assert of_p.tolist() == [[pytest.approx(1.0), pytest.approx(3.0)]]


@given(low=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3))
def test_ticks_are_few_ordered_and_inside(low: float, width: float):
    values = ticks((low, low + width))
    assert 2 <= len(values) <= 6
    assert values == sorted(set(values))
    # A tick may lie outside by the 1e-9 of a spacing that ticks() forgives.
    assert low - 1e-8 * width <= values[0] and values[-1] <= low + width + 1e-8 * width


def test_frame_is_widened_to_a_recorded_path():
    live, path = Frame(0, (-2.0, 2.0), (-4.0, 4.0)), np.array([[-1.0, 3.0], [-8.0, 8.0]])
    # The box is shown in any case, and widened by a twentieth.
    assert fit_frame(live, path) == Frame(0, (-2.0, 3.2), (-8.4, 8.4))
    assert fit_frame(live, np.array([[1.0, 1.0 + 1e-9], [4.0, 4.0]])) == live
