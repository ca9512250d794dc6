# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Contours lie on level sets of H; frames and ticks fit what they frame."""

from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation.build import build
from hnn_vi_ros.viewer.phase_portrait import (
    contours, fitted, Frame, frame_of, GRID, ticks)
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

MASS, STIFFNESS = 2.0, 8.0
FRAME = Frame(0, (-1.0, 1.5), (-4.0, 3.0))
Q0, P0 = np.array([1.0]), np.array([0.0])

OSCILLATOR = HarmonicOscillator()


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
        assert frame_of(0, OSCILLATOR, np.array([q0]), np.array([p0]), box) == expected


@pytest.mark.parametrize('state', [(1.0, 0.0), (0.0, -3.0), (0.0, 0.0)])
def test_frame_without_a_box_has_the_initial_state_inside(state: tuple[float, float]):
    frame = frame_of(0, OSCILLATOR, np.array(state[:1]), np.array(state[1:]), None)
    assert frame.q[0] < state[0] < frame.q[1] and frame.p[0] < state[1] < frame.p[1]


def test_frame_without_a_box_has_the_reach_of_the_energy_in_q_and_in_p():
    stiff = HarmonicOscillator(mass=1.0, stiffness=1e4)
    frame = frame_of(0, stiff, np.array([0.01]), np.array([0.0]), None)
    # H = 0.5 J: p reaches 1 kg m/s, q its initial 0.01 m; both within the steps of 1.2 and 1.25.
    assert 1.0 <= frame.p[1] <= 1.5
    assert 0.01 <= frame.q[1] <= 0.015


@given(low=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3))
def test_ticks_are_few_ordered_and_inside(low: float, width: float):
    values = ticks((low, low + width))
    assert 2 <= len(values) <= 6
    assert values == sorted(set(values))
    # A tick may lie outside by the 1e-9 of a spacing that ticks() forgives.
    assert low - 1e-8 * width <= values[0] and values[-1] <= low + width + 1e-8 * width


@pytest.mark.parametrize('scene, most', [
    # Of a circle of 1 m, 1 J of kinetic energy and what is lost from z = -0.8 m to -1 m.
    ('spherical_pendulum', {'q': 1.6, 'p': 4.0}),
    # Of r = 2 m, which E = -1/2 J bounds, twice a quarter more.
    ('kepler', {'q': 2.6, 'p': 4.0}), ('henon_heiles', {'q': 1.0, 'p': 1.0}),
    # More than half a turn each way says nothing new.
    ('six_joint_arm', {'q': 4.0, 'p': 100.0})])
def test_frame_without_a_box_is_of_the_scale_of_the_energy(scene: str, most: dict[str, float]):
    run = build(load_scene(scene))
    for frame in (frame_of(i, run.hamiltonian, run.q, run.p, None) for i in range(len(run.q))):
        for name, start in (('q', run.q), ('p', run.p)):
            low, high = getattr(frame, name)
            assert low < start[frame.axis] < high
            assert 1e-2 < high - low < 2.0 * most[name]


@pytest.mark.parametrize('size', [1e-2, 1e-3, 1e-4])
def test_frame_without_a_box_has_the_energy_of_the_others_too(size: float):
    # Where the one coordinate is at rest in its lowest place, the other lends it all.
    q0 = np.array([size, 0.0])
    for frame in (frame_of(i, HenonHeiles(), q0, np.zeros(2), None) for i in range(2)):
        # Within a step of 2 %, and the cubic term, which is a hundredth at most.
        assert np.abs([*frame.q, *frame.p]) == pytest.approx(1.25 * size, rel=0.05)


def test_frame_of_a_recorded_path_is_fitted_to_it():
    live, path = Frame(0, (-2.0, 2.0), (-4.0, 4.0)), np.array([[-1.0, 3.0], [-8.0, 8.0]])
    assert fitted(live, path, False) == Frame(0, (-1.5, 3.5), (-10.0, 10.0))
    # The box of the training data is shown in any case, and widened by a twentieth.
    assert fitted(live, path, True) == Frame(0, (-2.0, 3.2), (-8.4, 8.4))
    # What stays does not fill its axis with its rounding.
    assert fitted(live, np.array([[1.0, 1.0 + 1e-9], [4.0, 4.0]]), False) == live
