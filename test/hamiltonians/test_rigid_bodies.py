# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bodies that turn: their H, its derivatives, what they conserve, and how states are laid out."""

from helpers import assert_derivatives_of_energy
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.turning_body import spatial_momentum
from hnn_vi_ros.phase_space import angle_columns, columns, Coordinate, rotations
from hnn_vi_ros.scene import Condition
from messages import refused
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

BODIES = {'free_rigid_body': HAMILTONIANS['free_rigid_body']([1.0, 1.4, 0.8]),
          'heavy_top': HAMILTONIANS['heavy_top']([1.0, 1.4, 0.8], 0.7, 0.6, 3.7),
          'ball_joint_pendulum': HAMILTONIANS['ball_joint_pendulum'](0.7, 0.6, 1.0, 3.7),
          'quadrotor': HAMILTONIANS['quadrotor'](0.7, [1.0, 1.4, 0.8], 3.7)}


def states(count: int = 5, places: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return random attitudes and momenta, those of so many coordinates before them."""
    rng = np.random.default_rng(7)
    q = rng.normal(size=(count, places + 4))
    q[:, places:] /= np.linalg.norm(q[:, places:], axis=1, keepdims=True)
    return q, rng.normal(size=(count, places + 3))


def states_of(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return random states of a body."""
    return states(places=BODIES[name].rotations[0])


@pytest.mark.parametrize('name', BODIES)
def test_body_has_the_energy_of_its_rotation_matrix(name: str):
    body, (q, p) = BODIES[name], states_of(name)
    attitudes, turning = Rotation.from_quat(q[:, -4:]), p[:, -3:]
    inertia = np.array([1.0, 1.4, 0.8])
    if name == 'ball_joint_pendulum':
        # A ball about its middle, and by Steiner's theorem about the joint.
        inertia = 0.4 * 0.7 + 0.7 * 0.6 ** 2 * np.array([1.0, 1.0, 0.0])
    expected = np.sum(turning * turning / (2.0 * inertia), axis=1)
    if name == 'quadrotor':
        expected += np.sum(p[:, :3] ** 2, axis=1) / (2.0 * 0.7) + 0.7 * 3.7 * q[:, 2]
    elif name != 'free_rigid_body':
        middle = {'heavy_top': 0.6, 'ball_joint_pendulum': -0.6}[name]
        expected += 0.7 * 3.7 * attitudes.apply([0.0, 0.0, middle])[:, 2]
    np.testing.assert_allclose(body.energy(q, p), expected, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(spatial_momentum(q[:, -4:], turning), attitudes.apply(turning),
                               rtol=1e-13)


@pytest.mark.parametrize('name', BODIES)
def test_body_has_the_derivatives_of_its_energy(name: str):
    # H is quadratic: a central difference has no error but rounding, some 1e-15 / 1e-4.
    assert_derivatives_of_energy(BODIES[name], *states_of(name), 1e-10)


@pytest.mark.parametrize('name, arguments', [
    *((name, {'inertia': inertia}) for name in ('free_rigid_body', 'heavy_top', 'quadrotor')
      for inertia in ([1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 2.5])),
    *(('heavy_top', {name: float('nan')}) for name in ('mass', 'length', 'gravity')),
    ('quadrotor', {'mass': 0.0}), ('quadrotor', {'gravity': -9.81}),
    ('quadrotor', {'gravity': float('inf')}), ('ball_joint_pendulum', {'radius': 0.0})])
def test_body_refuses_what_is_no_inertia_and_a_constant_out_of_range(name: str, arguments: dict):
    with refused(ValueError):
        HAMILTONIANS[name](**arguments)


def test_known_invariants_are_momenta_in_space_and_the_spin_of_a_symmetric_top():
    (q, *_), (p, *_) = states()
    space = Rotation.from_quat(q).apply(p)
    free = BODIES['free_rigid_body'].known_invariants
    assert list(free) == ['momentum_x', 'momentum_y', 'momentum_z']
    np.testing.assert_allclose([function(q, p) for function in free.values()], space, rtol=1e-13)
    assert list(BODIES['heavy_top'].known_invariants) == ['vertical_momentum']
    top = HAMILTONIANS['heavy_top']().known_invariants
    assert top['vertical_momentum'](q, p) == pytest.approx(space[2], rel=1e-13)
    assert top['spin'](q, p) == p[2]
    hanging = BODIES['ball_joint_pendulum'].known_invariants
    assert {name: hanging[name](q, p) for name in hanging} == {
        name: top[name](q, p) for name in top}
    (q, *_), (p, *_) = states_of('quadrotor')
    flying = BODIES['quadrotor'].known_invariants
    assert list(flying) == ['momentum_x', 'momentum_y', 'spin_x', 'spin_y', 'spin_z']
    np.testing.assert_allclose([function(q, p) for function in flying.values()],
                               [*p[:2], *Rotation.from_quat(q[3:]).apply(p[3:])], rtol=1e-13)


def test_coordinates_of_every_kind_have_their_columns():
    mixed = [Coordinate('x', 'm'), Coordinate('body', kind='pose'), Coordinate('angle', 'rad'),
             Coordinate('wheel', kind='rotation')]
    q, p = columns(mixed)
    assert q == ['x', 'body_x', 'body_y', 'body_z', 'body_qx', 'body_qy', 'body_qz', 'body_qw',
                 'angle', 'wheel_qx', 'wheel_qy', 'wheel_qz', 'wheel_qw']
    assert p == ['x', 'body_x', 'body_y', 'body_z', 'body_rx', 'body_ry', 'body_rz', 'angle',
                 'wheel_rx', 'wheel_ry', 'wheel_rz']
    assert rotations(mixed) == (4, 9)
    assert np.flatnonzero(angle_columns(mixed)).tolist() == [8]


def test_condition_names_the_columns_of_a_rotation():
    top, (q, p) = HAMILTONIANS['heavy_top'](), states()
    condition = Condition('attitude_qw + p_attitude_rz = v_attitude_rx')
    condition.check(top)
    np.testing.assert_array_equal(condition.values(top, q, p, 0.0), q[:, 3] + p[:, 2] - p[:, 0])
    with refused(ValueError):
        Condition('p_attitude_qx = 0').check(top)
