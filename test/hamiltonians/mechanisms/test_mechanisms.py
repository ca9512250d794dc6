# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Drawn bodies follow their coordinates and stay in one piece."""

from itertools import pairwise

from hnn_vi_ros.hamiltonians.fput_chain import FputChain
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
from hnn_vi_ros.hamiltonians.mechanisms.parts import Ball, bounds_of, Box, Line, Trail
from hnn_vi_ros.hamiltonians.mechanisms.registry import COORDINATES, MECHANISMS
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
            field = {Ball: 'center', Box: 'center', Line: 'points', Trail: 'point'}[type(part)]
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


def test_mass_spring_joins_wall_spring_mass_and_floor_and_keeps_them_apart():
    parts = MECHANISMS['mass_spring'](DISPLACEMENTS, REACH)
    wall, floor, spring, mass = (parts[key] for key in ('wall', 'floor', 'spring', 'mass'))
    wall_face = wall.center[0] + wall.half_size[0]
    mass_face = mass.center[:, 0] - mass.half_size[0]
    mass_bottom = mass.center[:, 2] - mass.half_size[2]
    # Lengths near 1 m, each a sum of two rounded terms.
    np.testing.assert_allclose(spring.points[:, 0, 0], wall_face, atol=1e-15)
    np.testing.assert_allclose(spring.points[:, -1, 0], mass_face, atol=1e-15)
    np.testing.assert_allclose(mass_bottom, floor.center[2] + floor.half_size[2], atol=1e-15)
    # They stay apart over the whole reach.
    assert (np.diff(spring.points[..., 0], axis=-1) > 0.0).all()
    floor_end = floor.center[0] + floor.half_size[0]
    assert (mass.center[:, 0] + mass.half_size[0] < floor_end).all()


def test_pendulum_hangs_down_at_zero_and_turns_towards_x():
    bob = MECHANISMS['pendulum'](np.array([[0.0], [0.5 * np.pi], [np.pi]]), REACH)['bob'].center
    # Rounding of pi / 2 and pi, 1e-16 each.
    np.testing.assert_allclose(bob, [[0, 0, -1], [1, 0, 0], [0, 0, 1]], atol=3e-16)


def test_double_pendulum_measures_both_angles_from_the_vertical():
    quarter = 0.5 * np.pi
    parts = MECHANISMS['double_pendulum'](np.array([[0.0, quarter], [quarter, 0.0]]), REACH)
    np.testing.assert_allclose(parts['bob1'].center, [[0, 0, -1], [1, 0, 0]], atol=3e-16)
    np.testing.assert_allclose(parts['bob2'].center, [[1, 0, -1], [1, 0, -1]], atol=3e-16)


@pytest.mark.parametrize('name, chain', [
    ('pendulum', ['pivot', 'rod', 'bob']),
    ('double_pendulum', ['pivot', 'rod1', 'bob1', 'rod2', 'bob2'])])
def test_pendulum_joins_each_rod_to_its_bobs(name: str, chain: list[str]):
    parts = MECHANISMS[name](STATES[name], REACH)
    for above, rod, below in zip(chain[:-2:2], chain[1::2], chain[2::2], strict=True):
        start, end = np.moveaxis(parts[rod].points, -2, 0)
        np.testing.assert_array_equal(start, np.broadcast_to(parts[above].center, start.shape))
        np.testing.assert_array_equal(end, parts[below].center)
        # A rod of 1 m, its ends rounded to 1e-16 each.
        np.testing.assert_allclose(np.linalg.norm(end - start, axis=-1), 1.0, atol=1e-15)


@pytest.mark.parametrize('name', ['pendulum', 'double_pendulum'])
def test_pendulum_leaves_room_for_every_angle(name: str):
    """Two states alone must frame all others, as the viewer does with the ends of the box."""
    low, high = bounds_of(MECHANISMS[name](STATES[name][:2], REACH))
    moving = MECHANISMS[name](STATES[name], REACH)
    for part in (part for part in moving.values() if part.moves):
        places = part.points if isinstance(part, Line) else (
            part.point if isinstance(part, Trail) else part.center)
        assert (places >= low - 1e-15).all() and (places <= high + 1e-15).all()


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


def test_kepler_ray_leads_from_the_centre_to_the_body():
    parts = MECHANISMS['kepler'](PLACES, REACH)
    np.testing.assert_array_equal(parts['ray'].points[:, 0], np.zeros((7, 3)))
    np.testing.assert_array_equal(parts['ray'].points[:, 1], parts['body'].center)
    np.testing.assert_array_equal(parts['centre'].center, np.zeros(3))


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


def test_charged_particle_field_lines_stand_upright_within_the_frame():
    parts = MECHANISMS['charged_particle'](PLACES, REACH)
    lines = [part.points for name, part in parts.items() if name.startswith('field')]
    assert len(lines) > 1
    for line in lines:
        assert (line[0, :2] == line[1, :2]).all() and line[0, 2] < 0.0 < line[1, 2]
        assert abs(line[:, :2]).max() < parts['frame'].points[:, :2].max() == REACH


def test_bouncing_mass_stands_on_the_floor_at_zero():
    parts = MECHANISMS['bouncing_mass'](np.array([[0.0], [0.2]]), REACH)
    mass, floor = parts['mass'], parts['floor']
    bottom = mass.center[:, 2] - mass.half_size[2]
    # Lengths of less than 1 m, each a sum of two rounded terms.
    np.testing.assert_allclose(bottom, [0.0, 0.2], atol=1e-16)
    assert floor.center[2] + floor.half_size[2] == 0.0


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


def test_spring_chain_joins_wall_springs_and_masses():
    parts = MECHANISMS['spring_chain'](CHAINS, REACH)
    half = parts['mass1'].half_size[0]
    faces = [parts['wall1'].center[0] + parts['wall1'].half_size[0]]
    for i in range(1, 7):
        x = parts[f'mass{i}'].center[:, 0]
        faces += [x - half, x + half]
    faces.append(parts['wall2'].center[0] - parts['wall2'].half_size[0])
    springs = ['soft0', 'stiff1', 'soft1', 'stiff2', 'soft2', 'stiff3', 'soft3']
    for spring, begin, end in zip(springs, faces[::2], faces[1::2], strict=True):
        points = parts[spring].points
        np.testing.assert_allclose(points[:, 0, 0], begin, atol=4e-15)
        np.testing.assert_allclose(points[:, -1, 0], end, atol=4e-15)


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
