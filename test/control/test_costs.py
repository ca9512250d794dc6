# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Costs and their expansions."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.control import Cost, Energy, Kinetic, Point, Quadratic
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, RigidBodyTree
from messages import refused
import numpy as np
import pytest
from urdf_robots import ROOT

Q, R = np.diag([2.0, 1.0, 0.5, 0.0]), np.array([[0.3]])


@pytest.fixture(scope='module')
def model() -> Hamiltonian:
    return load_scene('exact_double_pendulum').create_hamiltonian()


def points(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(count, 4)), rng.normal(size=(count, 1))


def costs(model: Hamiltonian) -> dict[str, Cost]:
    tip = Point.chain([1.0, 0.7], [0.1, 0.0, 1.6])
    quadratic = Quadratic(model, ([np.pi, 0.0, 0.1, 0.0], [0.2]), Q, R)
    return {'quadratic': quadratic, 'energy': Energy(model, np.zeros(4)),
            'kinetic': Kinetic(model), 'tip': tip,
            'relative': Point.chain([1.0, 0.7], [0.1, 0.0, 1.6], relative=True),
            'sum': 3.0 * tip.saturating(0.1) + 0.1 * Kinetic(model) + quadratic.saturating(5.0)}


def assert_slopes(cost: Cost, z: np.ndarray, u: np.ndarray, bound: float) -> None:
    """Compare gradients of a cost with differences of fourth order."""
    found, e = cost.expand(z, u), 1e-3
    for k, unit in enumerate(np.eye(z.shape[1] + u.shape[1])):
        by_z, by_u = np.split(e * unit, [z.shape[1]])
        one, two = (cost.value(z + n * by_z, u + n * by_u) - cost.value(z - n * by_z, u - n * by_u)
                    for n in (1.0, 2.0))
        by = found.by_z if by_z.any() else found.by_u
        # Rounding 2e-16 / e times values of up to some hundred, and e^4.
        assert np.abs((8.0 * one - two) / (12.0 * e) - by[:, k % z.shape[1]]).max() \
            < bound * max(1.0, np.abs(by).max())


@pytest.mark.parametrize('name', ['quadratic', 'energy', 'kinetic', 'tip', 'relative', 'sum'])
def test_gradients_are_differences_and_hessians_are_not_negative(model, name):
    cost, (z, u) = costs(model)[name], points(6)
    found = cost.expand(z, u)
    assert found.value == pytest.approx(cost.value(z, u), rel=1e-13)
    assert_slopes(cost, z, u, 1e-9)
    scale = max(1.0, np.abs(found.by_zz).max())
    assert np.linalg.eigvalsh(found.by_zz).min() > -1e-12 * scale


def test_quadratic_wraps_angles_and_kinetic_has_inverse_masses(model):
    z, u = points(4)
    cost = costs(model)['quadratic']
    turned = z + 2.0 * np.pi * np.array([3.0, -1.0, 0.0, 0.0])
    assert cost.value(turned, u) == pytest.approx(cost.value(z, u), rel=1e-12)
    by_zz = Kinetic(model).expand(z, u).by_zz
    rest = np.zeros((4, 2))
    for k, unit in enumerate(np.eye(2)):
        velocity = model.gradient(z[:, :2], rest + unit)[1]
        assert by_zz[:, 2:, 2 + k] == pytest.approx(velocity, rel=1e-12)


def test_points_are_those_of_rods_and_of_a_urdf():
    q = np.random.default_rng(1).normal(size=(5, 2))
    tip = Point.chain([1.0, 0.7], [0.0, 0.0, 1.7], relative=True).place(q)
    turned = np.cumsum(q, axis=1)
    expected = [np.sin(turned) @ [1.0, 0.7], np.zeros(5), -np.cos(turned) @ [1.0, 0.7]]
    assert np.abs(tip - np.transpose(expected)).max() < 1e-14
    arm = load_scene('two_joint_arm').create_hamiltonian()
    end = Point(arm, 'forearm', [0.0, 0.0, 0.7], offset=[0.0, 0.0, -0.3])
    # The URDF turns both joints about y: positive angles move what hangs towards -x.
    expected = [-np.sin(turned) @ [0.4, 0.3], np.full(5, 0.125), -np.cos(turned) @ [0.4, 0.3]]
    assert np.abs(end.place(q) - np.transpose(expected)).max() < 1e-14


def test_point_of_a_link_that_follows_moves_with_the_leader():
    gripper = RigidBodyTree(str(ROOT / 'config' / 'robots' / 'gripper.urdf'))
    cost, q = Point(gripper, 'right_tip', [0.0, 0.0, 0.0]), np.array([[0.2], [0.7]])
    # Both fingers open, and the tips stay upright.
    expected = np.hstack([0.0 * q, -0.03 - 0.08 * np.sin(q), -0.08 * np.cos(q)])
    assert np.abs(cost.place(q) - expected).max() < 1e-16
    assert_slopes(cost, np.hstack([q, 0.0 * q]), np.zeros((2, 1)), 1e-10)


def test_points_of_an_arm_have_exact_derivatives():
    arm = load_scene('six_joint_arm').create_hamiltonian()
    cost = Point(arm, arm.joints[-1].child, [0.3, 0.2, 0.4], offset=[0.0, 0.05, 0.1])
    q = np.random.default_rng(2).normal(size=(3, 6))
    assert_slopes(cost, np.hstack([q, np.zeros((3, 6))]), np.zeros((3, 6)), 1e-10)


def test_what_makes_no_cost_is_one_line(model):
    with refused(ValueError):
        Quadratic(model, (np.zeros(4), np.zeros(1)), -Q, R)
    with refused(ValueError):
        -1.0 * Kinetic(model)
    with refused(ValueError):
        Kinetic(model).saturating(0.0)
    with refused(UnsupportedSystem):
        Point(model, 'forearm', np.zeros(3))
    with refused(ValueError):
        Point(load_scene('two_joint_arm').create_hamiltonian(), 'wrist', np.zeros(3))
