# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Drawn bodies follow their coordinates and stay in one piece."""

from itertools import pairwise

from hnn_vi_ros.hamiltonians import Ball, bounds_of, COORDINATES, Cuboid, Line, MECHANISMS, Trail
from hnn_vi_ros.hamiltonians.fput_chain import FputChain
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

REACH = 0.3
DISPLACEMENTS = np.linspace(-REACH, REACH, 7)[:, None]
ANGLES = np.random.default_rng(0).uniform(-4.0, 4.0, (7, 2))
PLACES = np.random.default_rng(1).uniform(-REACH, REACH, (7, 2))
CHAINS = np.random.default_rng(2).uniform(-REACH, REACH, (7, 6))
POSES = np.hstack([CHAINS[:, :3], Rotation.from_quat(
    np.random.default_rng(3).normal(size=(7, 4))).as_quat()])
STATES = {
    'bouncing_mass': abs(DISPLACEMENTS), 'cartesian_pendulum': PLACES, 'charged_particle': PLACES,
    'double_pendulum': ANGLES, 'henon_heiles': PLACES, 'kepler': PLACES,
    'mass_spring': DISPLACEMENTS, 'pendulum': ANGLES[:, :1], 'spring_chain': CHAINS,
    'turning_body': POSES}


@pytest.mark.parametrize('name', MECHANISMS)
def test_mechanism_draws_many_states_as_it_draws_each(name: str):
    together = MECHANISMS[name](STATES[name], REACH)
    for i, q in enumerate(STATES[name]):
        alone = MECHANISMS[name](q, REACH)
        assert alone.keys() == together.keys()
        for key, part in together.items():
            field = {Ball: 'center', Cuboid: 'center', Line: 'points', Trail: 'point'}[type(part)]
            many, one = getattr(part, field), getattr(alone[key], field)
            np.testing.assert_array_equal(many[i] if part.moves else many, one)


@pytest.mark.parametrize('name', MECHANISMS)
def test_mechanism_draws_every_number_of_coordinates_that_is_said_of_it(name: str):
    assert len(COORDINATES[name]) > 0
    for number in COORDINATES[name]:
        parts = MECHANISMS[name](np.full((3, number), 0.1), 1.0)
        assert any(part.moves for part in parts.values())
        assert np.isfinite(bounds_of(parts)).all()


@pytest.mark.parametrize('name', ['bouncing_mass', 'cartesian_pendulum', 'charged_particle',
                                  'kepler', 'mass_spring', 'spring_chain'])
def test_mechanism_of_lengths_scales_with_its_reach(name: str):
    small = bounds_of(MECHANISMS[name](STATES[name], REACH))
    large = bounds_of(MECHANISMS[name](10.0 * STATES[name], 10.0 * REACH))
    # Every length is a product of few factors: a handful of roundings of 1.1e-16 each.
    np.testing.assert_allclose(large, 10.0 * small, rtol=1e-14, atol=1e-15)


def test_pendulum_hangs_down_at_zero_and_turns_towards_x():
    bob = MECHANISMS['pendulum'](np.array([[0.0], [0.5 * np.pi], [np.pi]]), REACH)['bob'].center
    # Rounding of pi / 2 and pi, 1e-16 each.
    np.testing.assert_allclose(bob, [[0, 0, -1], [1, 0, 0], [0, 0, 1]], atol=3e-16)


def test_double_pendulum_measures_both_angles_from_the_vertical():
    quarter = 0.5 * np.pi
    parts = MECHANISMS['double_pendulum'](np.array([[0.0, quarter], [quarter, 0.0]]), REACH)
    np.testing.assert_allclose(parts['bob1'].center, [[0, 0, -1], [1, 0, 0]], atol=3e-16)
    np.testing.assert_allclose(parts['bob2'].center, [[1, 0, -1], [1, 0, -1]], atol=3e-16)


def test_cartesian_pendulum_is_drawn_as_the_pendulum_at_the_same_place():
    angle = ANGLES[:, :1]
    polar = MECHANISMS['pendulum'](angle, 1.0)
    cartesian = MECHANISMS['cartesian_pendulum'](
        np.hstack([np.sin(angle), -np.cos(angle)]), 1.0)
    np.testing.assert_array_equal(cartesian['bob'].center, polar['bob'].center)
    np.testing.assert_array_equal(cartesian['rod'].points, polar['rod'].points)


@pytest.mark.parametrize('name, body, q', [
    ('kepler', 'body', PLACES), ('henon_heiles', 'star', PLACES),
    ('charged_particle', 'particle', PLACES), ('cartesian_pendulum', 'bob', CHAINS[:, :3]),
    ('mass_spring', 'mass', DISPLACEMENTS)])
def test_body_is_drawn_where_it_is(name: str, body: str, q: np.ndarray):
    center = MECHANISMS[name](q, REACH)[body].center
    np.testing.assert_array_equal(center[:, :q.shape[1]], q)
    # The axes along which it does not move.
    assert not np.ptp(center[:, q.shape[1]:], axis=0).any()


def test_henon_heiles_triangle_is_the_level_set_of_the_escape_energy():
    corners = MECHANISMS['henon_heiles'](PLACES, REACH)['triangle'].points
    # Cosines and sines that are rounded to 1e-16, of angles to 1e-15.
    np.testing.assert_allclose(corners[0], corners[3], atol=1e-15)
    share = np.linspace(0.0, 1.0, 11)[:, None]
    sides = np.vstack([(1.0 - share) * corners[i, :2] + share * corners[i + 1, :2]
                       for i in range(3)])
    energy = HenonHeiles().energy(sides, np.zeros_like(sides))
    # The potential has terms of at most one, each of a few roundings.
    np.testing.assert_allclose(energy, 1.0 / 6.0, atol=1e-15)


def masses_of(chain: np.ndarray) -> np.ndarray:
    parts = MECHANISMS['spring_chain'](chain, REACH)
    return np.stack([parts[f'mass{i}'].center[..., 0] for i in range(1, 7)], axis=-1)


def test_spring_chain_moves_its_masses_as_the_hamiltonian_says():
    moved = masses_of(CHAINS) - masses_of(np.zeros_like(CHAINS))
    first, second = moved[:, 0::2], moved[:, 1::2]
    # Places of up to 3 m, rounded to 4e-16 each.
    np.testing.assert_allclose((second + first) / np.sqrt(2.0), CHAINS[:, :3], atol=4e-15)
    np.testing.assert_allclose((second - first) / np.sqrt(2.0), CHAINS[:, 3:], atol=4e-15)
    # The soft springs hold 1/4 of the fourth powers of sqrt(2) times their extensions.
    extension = np.diff(np.hstack([np.zeros((7, 1)), moved, np.zeros((7, 1))]))[:, ::2]
    chain = FputChain(pairs=3, omega=2.0)
    soft = chain.energy(CHAINS, np.zeros_like(CHAINS)) - 2.0 * (CHAINS[:, 3:] ** 2).sum(axis=1)
    np.testing.assert_allclose((extension ** 4).sum(axis=1), soft, rtol=1e-12)


def test_bounds_of_holds_every_corner():
    parts = MECHANISMS['mass_spring'](DISPLACEMENTS, REACH)
    low, high = bounds_of(parts)
    assert low[0] == pytest.approx(parts['wall'].center[0] - parts['wall'].half_size[0])
    assert high[0] == pytest.approx(parts['floor'].center[0] + parts['floor'].half_size[0])
    assert (parts['spring'].points >= low).all() and (parts['spring'].points <= high).all()


def test_turning_body_has_its_axes_and_leaves_the_path_of_its_place():
    parts, turns = MECHANISMS['turning_body'](POSES, REACH), Rotation.from_quat(POSES[:, 3:])
    for axis, name in zip(np.eye(3), ('x_axis', 'y_axis', 'z_axis'), strict=True):
        start, end = np.moveaxis(parts[name].points, -2, 0)
        np.testing.assert_array_equal(start, POSES[:, :3])
        np.testing.assert_allclose(end - start, 0.2 * REACH * turns.apply(axis), atol=1e-15)
    # Every edge of the box, and none that is not one: neighbours differ along one axis.
    corners = turns[0].inv().apply(parts['body'].points[0] - POSES[0, :3]) / (0.1 * REACH)
    corners = np.round(corners / [1.0, 1.0, 0.25]).astype(int)
    edges = {frozenset(map(tuple, pair)) for pair in pairwise(corners)}
    assert (abs(np.diff(corners, axis=0)).sum(axis=1) == 2).all() and len(edges) == 12
    np.testing.assert_array_equal(parts['path'].point, POSES[:, :3])
    # About a point it is the end of the third axis whose path is drawn.
    about = MECHANISMS['turning_body'](POSES[:, 3:], 1.0)
    np.testing.assert_allclose(about['path'].point, 0.8 * turns.apply([0.0, 0.0, 1.0]),
                               atol=1e-15)
    np.testing.assert_array_equal(about['path'].point, about['z_axis'].points[:, 1])
