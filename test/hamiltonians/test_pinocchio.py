# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Robots of rigid bodies against Pinocchio: M, V, the gradient and forward dynamics."""

from pathlib import Path

from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
import numpy as np
import pytest
from urdf_robots import SHIPPED, SMALL_ARGUMENTS, TREE, TREE_ARGUMENTS, with_quaternions

pinocchio = pytest.importorskip('pinocchio', reason='pin is not installed; see `make test`')

STATES, TOLERANCE = 1000, 1e-12


class Peer:
    """A robot by Pinocchio, in the coordinates of ours."""

    def __init__(self, file: Path, robot: RigidBodyTree, arguments: dict):
        model = pinocchio.buildModelFromUrdf(str(file))
        held, values = [], pinocchio.neutral(model)
        for name, value in arguments.get('locked', {}).items():
            held.append(model.getJointId(name))
            values[model.joints[held[-1]].idx_q] = value
        self.model = pinocchio.buildReducedModel(model, held, values)
        self.model.gravity.linear = np.array(arguments.get('gravity', [0.0, 0.0, -9.81]))
        self.data = self.model.createData()
        self._joints = [self.model.joints[self.model.getJointId(c.name)]
                        for c in robot.coordinates]
        self.places = [joint.idx_v for joint in self._joints]
        armature = self.model.armature.copy()
        for c, place in zip(robot.coordinates, self.places, strict=True):
            armature[place] = arguments.get('rotor_inertia', {}).get(c.name, 0.0)
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
    *(path.stem for path in SHIPPED), 'rotors', 'tree', 'quaternions', 'small'])
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
    return robot, Peer(file, robot, arguments)


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
