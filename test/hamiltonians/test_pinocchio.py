# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Robots of rigid bodies against Pinocchio: M, V, the gradient and forward dynamics."""

from collections.abc import Sequence
from pathlib import Path
import sys

from hnn_vi_ros.hamiltonians import read_urdf, RigidBodyTree
from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import FollowingParameters
from hnn_vi_ros.hamiltonians.rigid_body.small_tree import MOST_STRAIGHT
from hnn_vi_ros.kernels import Kernel
import numpy as np
import pytest
from urdf_robots import (
    mimic_tree, SHIPPED, SMALL_ARGUMENTS, TREE, TREE_ARGUMENTS, with_quaternions)

pinocchio = pytest.importorskip('pinocchio', reason='pin is not installed; see `make test`')

STATES, TOLERANCE = 1000, 1e-12


class Peer:
    """A robot by Pinocchio, with joints in the order of some names."""

    def __init__(self, file: Path, names: Sequence[str], arguments: dict):
        model = pinocchio.buildModelFromUrdf(str(file))
        held, values = [], pinocchio.neutral(model)
        for name, value in arguments.get('locked', {}).items():
            held.append(model.getJointId(name))
            joint = model.joints[held[-1]]
            values[joint.idx_q:joint.idx_q + joint.nq] = \
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
        self.model = pinocchio.buildReducedModel(model, held, values)
        self.model.gravity.linear = np.array(arguments.get('gravity', [0.0, 0.0, -9.81]))
        self.data = self.model.createData()
        self._joints = [self.model.joints[self.model.getJointId(name)] for name in names]
        self.places = [joint.idx_v for joint in self._joints]
        armature = self.model.armature.copy()
        for name, place in zip(names, self.places, strict=True):
            armature[place] = arguments.get('rotor_inertia', {}).get(name, 0.0)
        self.model.armature = armature

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """Return q as Pinocchio has it: a continuous joint by its cosine and sine."""
        values = pinocchio.neutral(self.model)
        for joint, value in zip(self._joints, q, strict=True):
            values[joint.idx_q:joint.idx_q + joint.nq] = \
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
        return values

    def velocity(self, v: np.ndarray) -> np.ndarray:
        values = np.zeros(self.model.nv)
        values[self.places] = v
        return values


@pytest.fixture(params=[
    *(path.stem for path in SHIPPED if '<mimic' not in path.read_text()),
    'rotors', 'tree', 'quaternions', 'small'])
def pair(request, tmp_path) -> tuple[RigidBodyTree, Peer]:
    file, arguments = tmp_path / 'tree.urdf', TREE_ARGUMENTS
    if request.param in ('tree', 'quaternions', 'small'):
        file.write_text(with_quaternions(TREE) if request.param == 'quaternions' else TREE)
        if request.param == 'small':
            arguments = SMALL_ARGUMENTS | {'gravity': [0.0, 3.0, -9.0]}
    else:
        file = next(path for path in SHIPPED if path.stem == request.param or (
            request.param == 'rotors' and path.stem == 'six_joint_arm'))
        arguments = {}
        if request.param == 'rotors':
            arguments = {'rotor_inertia': {'shoulder_pan': 0.5, 'wrist_3': 0.02},
                         'gravity': [0.0, 3.0, -9.0]}
    robot = RigidBodyTree(str(file), **arguments)
    return robot, Peer(file, [c.name for c in robot.coordinates], arguments)


def close(own: np.ndarray, peer: np.ndarray, of: np.ndarray) -> bool:
    """Tell whether they are the same, relative to the largest entry of another array."""
    return bool(np.abs(own - peer).max() <= TOLERANCE * np.abs(of).max())


def test_robot_is_that_of_pinocchio(pair):
    robot, peer = pair
    model, data, places, d = peer.model, peer.data, peer.places, robot.dimension
    q, v = np.random.default_rng(3).uniform(-3.0, 3.0, (2, STATES, d))
    masses = robot.masses(q)
    p = np.einsum('nij,nj->ni', masses, v)
    energies, (H_q, H_p) = robot.energy(q, p), robot.gradient(q, p)
    # q'' = H_pq q' - H_pp H_q, of which forward dynamics is made.
    accelerations = robot.hessian_vector(q, p, H_p, -H_q)[1]
    for k in range(STATES):
        at, moving = peer.configuration(q[k]), peer.velocity(v[k])
        upper = np.triu(pinocchio.crba(model, data, at))
        mass = (upper + np.triu(upper, 1).T)[np.ix_(places, places)]
        assert close(masses[k], mass, mass)
        potential = pinocchio.computePotentialEnergy(model, data, at)
        kinetic = 0.5 * v[k] @ mass @ v[k]
        assert close(energies[k], kinetic + potential, np.array([kinetic, potential]))
        assert close(H_p[k], v[k], v[k])
        # p' = M v' + M' v with M' = C + C^T, and M v' + C v + g = 0.
        coriolis = pinocchio.computeCoriolisMatrix(model, data, at, moving)
        weight = pinocchio.computeGeneralizedGravity(model, data, at)
        turning = coriolis.T @ moving
        assert close(H_q[k], (weight - turning)[places], np.concatenate([weight, turning]))
        forward = pinocchio.aba(model, data, at, moving, np.zeros(d))[places]
        assert close(accelerations[k], forward, forward)


def plain_kernel(robot: RigidBodyTree, dtype: type = float) -> Kernel:
    """Return the kernel, to be run as plain Python, also for complex numbers."""
    kernel = robot.kernel
    return kernel if robot.bodies.parent.size <= MOST_STRAIGHT + 1 else kernel._replace(
        parameters=FollowingParameters.empty(robot.bodies, robot.following, dtype))


def assert_reduced(robot: RigidBodyTree, peer: Peer, G: np.ndarray, c: np.ndarray,
                   rng: np.random.Generator) -> None:
    """Compare H, its gradient and Hessian products with those of the whole tree on q = G y + c."""
    places, d = peer.places, robot.dimension
    real, complex_ = plain_kernel(robot), plain_kernel(robot, complex)
    for q, v, v_q, v_p in rng.uniform(-1.0, 1.0, (3, 4, d)):
        at, moving = peer.configuration(G @ q + c), peer.velocity(G @ v)
        upper = np.triu(pinocchio.crba(peer.model, peer.data, at))
        mass = G.T @ (upper + np.triu(upper, 1).T)[np.ix_(places, places)] @ G
        own = robot.masses(q[None])[0]
        assert close(own, mass, mass)
        p, kinetic = mass @ v, 0.5 * v @ mass @ v
        potential = pinocchio.computePotentialEnergy(peer.model, peer.data, at)
        energy = real.energy.py_func(real.parameters, q, p)
        assert close(energy, kinetic + potential, np.array([kinetic, potential]))
        H_q, H_p, by_q, by_p = np.zeros((4, d))
        real.gradient.py_func(real.parameters, q, p, H_q, H_p)
        # M^-1 p in round-off of M v.
        assert close(mass @ H_p, p, np.abs(mass) @ np.abs(v))
        coriolis = pinocchio.computeCoriolisMatrix(peer.model, peer.data, at, moving)
        weight = pinocchio.computeGeneralizedGravity(peer.model, peer.data, at)
        parts = np.abs(G.T) @ np.abs([weight[places], (coriolis.T @ moving)[places]]).T
        assert close(H_q, G.T @ (weight - coriolis.T @ moving)[places], parts)
        # Forward dynamics, M_y y'' = -G^T (C q' + g), by a product.
        real.hessian_vector.py_func(real.parameters, q, p, H_p, -H_q, by_q, by_p)
        bias = pinocchio.nonLinearEffects(peer.model, peer.data, at, moving)[places]
        size = np.abs(G.T) @ np.abs(bias) + np.abs(mass) @ np.abs(by_p)
        assert close(mass @ by_p, -G.T @ bias, size)
        # Any product is the derivative of the gradient, which has no round-off along i.
        real.hessian_vector.py_func(real.parameters, q, p, v_q, v_p, by_q, by_p)
        exact = np.zeros((2, d), dtype=complex)
        complex_.gradient.py_func(complex_.parameters, q + 1e-40j * v_q, p + 1e-40j * v_p, *exact)
        for product, derivative in zip((by_q, by_p), np.imag(exact) / 1e-40, strict=True):
            assert close(product, derivative, derivative)


@pytest.mark.filterwarnings('ignore:.*limits of joints that mimic others')
@pytest.mark.parametrize('seed', range(20))
def test_tree_whose_joints_follow_others_is_that_of_pinocchio_reduced_by_hand(seed, tmp_path):
    rng = np.random.default_rng(seed)
    # Few joints become code without loops.
    count = 2 + seed % 9
    text, G, c = mimic_tree(rng, count, max(1, count // 2))
    file = tmp_path / 'tree.urdf'
    file.write_text(text)
    names = [f'j{i}' for i in range(count)]
    arguments = {'rotor_inertia': {names[0]: 0.3, names[-1]: 0.2}, 'gravity': [1.0, -2.0, -9.0]}
    free = [names[row] for row in np.flatnonzero((G == 1.0).any(axis=1) & (c == 0.0))]
    order = [*rng.permutation(free)]
    robot = RigidBodyTree(str(file), joints=order, **arguments)
    assert {*robot.robot.followers} == {*names} - {*free}
    assert_reduced(robot, Peer(file, names, arguments), G[:, [free.index(name) for name in order]],
                   c, rng)


def published(path: str) -> Path:
    """Return a robot of example-robot-data, or skip the test."""
    for folder in sys.path:
        file = Path(folder) / 'cmeel.prefix/share/example-robot-data/robots' / path
        if file.is_file():
            return file
    pytest.skip('example-robot-data is not installed')


@pytest.mark.parametrize('path, leaders, followers', [
    ('panda_description/urdf/panda.urdf', 'panda_', 1),
    ('talos_data/robots/talos_full_v2.urdf', 'gripper_left_joint', 6),
    ('tiago_pro_description/robots/tiago_pro.urdf', 'gripper_left_finger_joint', 5),
    ('pr2_description/urdf/pr2.urdf', 'r_gripper_l_finger_joint', 5),
    ('baxter_description/urdf/baxter.urdf', 'l_gripper_l_finger_joint', 1)])
@pytest.mark.filterwarnings('ignore::UserWarning')
def test_published_robot_with_followers_is_that_of_pinocchio_reduced(path, leaders, followers):
    file = published(path)
    held = {name: 0.0 for name, joint in read_urdf(file).joints.items()
            if joint.moves and joint.mimic is None and not name.startswith(leaders)}
    # Fingers feel no weight along g.
    tilted = {'gravity': [1.0, -2.0, -9.0]}
    robot = RigidBodyTree(str(file), locked=held, **tilted)
    assert len(robot.robot.followers) == followers
    free = [c.name for c in robot.coordinates]
    names = [*free, *robot.robot.followers]
    assert_reduced(robot, Peer(file, names, {'locked': robot.robot.locked} | tilted),
                   *robot.robot.driven(names, free), np.random.default_rng(1))
