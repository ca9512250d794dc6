# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Robots of rigid bodies: derivatives, known systems, and what simulations keep of them."""

from pathlib import Path

from hnn_vi_ros.hamiltonians import HAMILTONIANS, RigidBodyTree
from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import FollowingParameters
from hnn_vi_ros.hamiltonians.rigid_body.small_tree import MOST_STRAIGHT
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import TreeParameters, TreeWork
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import by_address, original
from hnn_vi_ros.scene import described_scene, load_scene
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene
from urdf_robots import chain, ROOT, SHIPPED, SMALL_ARGUMENTS, TREE, TREE_ARGUMENTS
import yaml

STATES = 20


@pytest.fixture(params=['tree', 'small tree', 'followers', *(path.stem for path in SHIPPED)])
def robot(request, tmp_path) -> RigidBodyTree:
    if request.param == 'tree':
        return tree(tmp_path)
    if request.param == 'small tree':
        return tree(tmp_path, **SMALL_ARGUMENTS)
    if request.param == 'followers':
        return tree(tmp_path, locked={}, rotor_inertia={'hip': 0.3, 'follower': 0.2})
    return RigidBodyTree(str(ROOT / 'config' / 'robots' / f'{request.param}.urdf'))


def tree(folder: Path, text: str = TREE, **arguments) -> RigidBodyTree:
    path = folder / 'robot.urdf'
    path.write_text(text)
    return RigidBodyTree(str(path), **(TREE_ARGUMENTS if text == TREE else {}) | arguments)


def states(robot: RigidBodyTree) -> tuple[np.ndarray, np.ndarray]:
    """Return random q and p, shape (STATES, d), with velocities of order one."""
    q, v = np.random.default_rng(5).uniform(-2.0, 2.0, (2, STATES, robot.dimension))
    return q, np.einsum('nij,nj->ni', robot.masses(q), v)


def complex_kernel(robot: RigidBodyTree):
    """Return the kernel as plain Python for complex numbers, in which nothing is lost by steps."""
    kernel = robot.kernel
    if robot.bodies.parent.size <= MOST_STRAIGHT + 1:
        return kernel
    parameters = TreeParameters(robot.bodies, TreeWork.empty(robot.dimension, complex)) \
        if robot.following is None else FollowingParameters.empty(
            robot.bodies, robot.following, complex)
    return kernel._replace(parameters=parameters)


def test_gradient_is_the_derivative_of_the_energy(robot):
    kernel, d = complex_kernel(robot), robot.dimension
    q, p = states(robot)
    for z, row in zip(np.hstack([q, p]), np.hstack(robot.gradient(q, p)), strict=True):
        exact = np.array([np.imag(kernel.energy.py_func(
            kernel.parameters, (z + shift)[:d], (z + shift)[d:])) / 1e-40
            for shift in 1e-40j * np.eye(2 * d)])
        # Each half by itself: velocities and forces differ in size.
        for part in (slice(0, d), slice(d, None)):
            np.testing.assert_allclose(row[part], exact[part], rtol=0.0,
                                       atol=1e-12 * np.abs(exact[part]).max())


def test_hessian_vector_is_the_derivative_of_the_gradient(robot):
    kernel, d = complex_kernel(robot), robot.dimension
    q, p = states(robot)
    v_q, v_p = np.random.default_rng(6).normal(size=(2, STATES, d))
    computed = robot.hessian_vector(q, p, v_q, v_p)
    for k in range(STATES):
        exact = np.zeros((2, d), dtype=complex)
        kernel.gradient.py_func(kernel.parameters, q[k] + 1e-40j * v_q[k],
                                p[k] + 1e-40j * v_p[k], *exact)
        for part, row in zip(np.imag(exact) / 1e-40, computed, strict=True):
            np.testing.assert_allclose(row[k], part, rtol=0.0, atol=1e-12 * np.abs(part).max())


def test_mass_matrix_is_the_inverse_of_the_second_derivative(robot):
    q, _ = states(robot)
    d = robot.dimension
    masses = robot.masses(q)
    np.testing.assert_array_equal(masses, np.swapaxes(masses, 1, 2))
    for one, mass in zip(q, masses, strict=True):
        none = np.zeros((d, d))
        _, inverse = robot.hessian_vector(none + one, none, none, np.eye(d))
        np.testing.assert_allclose(inverse @ mass, np.eye(d), atol=1e-14 * np.linalg.cond(mass))


def test_pendulum_of_a_urdf_is_the_exact_one(tmp_path):
    robot = tree(tmp_path, chain([0.7], [1.3]), gravity=[0.0, 0.0, -3.7])
    exact = HAMILTONIANS['pendulum'](0.7, 1.3, 3.7)
    q, p = np.random.default_rng(1).normal(size=(2, STATES, 1))
    # V is zero at the height of the joint, and not where it hangs.
    np.testing.assert_allclose(robot.energy(q, p) + 0.7 * 3.7 * 1.3, exact.energy(q, p),
                               rtol=0.0, atol=1e-13)
    for own, other in zip(robot.gradient(q, p), exact.gradient(q, p), strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-13, atol=1e-13)


def test_double_pendulum_of_a_urdf_is_the_exact_one_in_angles_between_the_rods(tmp_path):
    masses, lengths, g = [0.7, 1.9], [1.3, 0.6], 3.7
    robot = tree(tmp_path, chain(masses, lengths), gravity=[0.0, 0.0, -g])
    exact = HAMILTONIANS['double_pendulum'](*masses, *lengths, g)
    q, p = np.random.default_rng(2).normal(size=(2, STATES, 2))
    A = np.array([[1.0, 0.0], [-1.0, 1.0]])
    angles, momenta = q @ A.T, p @ np.linalg.inv(A)
    lowest = sum(masses) * g * lengths[0] + masses[1] * g * lengths[1]
    np.testing.assert_allclose(robot.energy(angles, momenta) + lowest, exact.energy(q, p),
                               rtol=1e-12)
    H_q, H_p = robot.gradient(angles, momenta)
    expected_q, expected_p = exact.gradient(q, p)
    np.testing.assert_allclose(H_q @ A, expected_q, rtol=0.0, atol=1e-12 * np.abs(H_q).max())
    np.testing.assert_allclose(H_p, expected_p @ A.T, rtol=0.0, atol=1e-12 * np.abs(H_p).max())


def test_locked_joint_is_one_that_is_held(tmp_path):
    """With the momenta that hold it, the others move as if it were rigid."""
    free = tree(tmp_path)
    held = tree(tmp_path, joints=['wrist', 'tail', 'rail', 'finger'],
                locked={'follower': 0.03, 'hip': 0.6}, rotor_inertia={'rail': 1.5, 'wrist': 0.02})
    q, _ = states(free)
    q[:, 3] = 0.6
    rest = [0, 1, 2, 4]
    np.testing.assert_allclose(held.masses(q[:, rest]), free.masses(q)[:, rest][:, :, rest],
                               rtol=0.0, atol=1e-14 * np.abs(free.masses(q)).max())
    none = np.zeros_like(q)
    np.testing.assert_allclose(
        held.gradient(q[:, rest], none[:, rest])[0], free.gradient(q, none)[0][:, rest],
        rtol=0.0, atol=1e-13 * free.kernel.gradient_scale[0])


def test_what_is_not_behind_the_base_does_not_act(tmp_path):
    whole = tree(tmp_path, base='slider', joints=['wrist', 'finger'], rotor_inertia={})
    assert [c.name for c in whole.coordinates] == ['wrist', 'finger']
    assert whole.robot.root == 'ground'
    # The base is where the frame is: nothing of what carries it is felt.
    alone = tree(tmp_path, base='trunk', joints=['wrist', 'finger'], rotor_inertia={},
                 locked={'follower': 0.03, 'rail': 0.2, 'tail': 0.1}, gravity=[0.0, 0.0, 0.0])
    q, _ = states(whole)
    np.testing.assert_allclose(whole.masses(q), alone.masses(q), rtol=1e-13, atol=1e-16)


def test_coordinates_are_the_joints_with_their_units(tmp_path):
    robot = tree(tmp_path)
    assert [(c.name, c.q_unit, c.p_unit) for c in robot.coordinates] == [
        ('wrist', 'rad', 'kg m2/s'), ('tail', 'rad', 'kg m2/s'), ('rail', 'm', 'kg m/s'),
        ('hip', 'rad', 'kg m2/s'), ('finger', 'm', 'kg m/s')]
    assert [joint.name for joint in robot.joints] == TREE_ARGUMENTS['joints']


def test_robots_are_one_kernel_and_small_ones_one_for_each_shape(tmp_path):
    robots = [tree(tmp_path), *(robot for path in SHIPPED if (
        robot := RigidBodyTree(str(path))).following is None
        and robot.dimension > MOST_STRAIGHT)]
    q, p = states(robots[0])
    robots[0].gradient(q, p)
    dispatcher = original(by_address(robots[0].kernel)).gradient
    assert all(robot.kernel.gradient is dispatcher for robot in robots)
    types = {str(tuple(map(type, _leaves(robot.kernel.parameters)))) for robot in robots}
    assert len(types) == 1
    small = [tree(tmp_path, chain([mass, 0.7], [0.4, 0.3])) for mass in (1.3, 0.9)]
    kernels = [robot.kernel for robot in small]
    assert kernels[0].gradient is kernels[1].gradient
    assert kernels[0].parameters != kernels[1].parameters


def _leaves(value):
    return [leaf for part in value for leaf in _leaves(part)] if isinstance(value, tuple) \
        else [value]


def test_copy_has_space_of_its_own(tmp_path):
    robot = tree(tmp_path)
    work, other = robot.kernel.parameters.work, robot.copy().kernel.parameters.work
    assert not any(np.shares_memory(one, two) for one, two in zip(work, other, strict=True))


def test_energy_with_other_numbers_is_not_that_of_earlier_calls(tmp_path):
    robot = tree(tmp_path)
    q, p = np.full((2, robot.dimension), 0.4)
    masses = [name for name in robot.robot.numbers() if name.endswith('.mass')]
    other = robot.with_numbers(dict.fromkeys(masses, 5.0)).energy(q, p)
    assert robot.energy(q, p) != other
    assert robot.with_numbers(dict.fromkeys(masses, 5.0)).energy(q, p) == other


def test_arm_keeps_its_energy_without_drift():
    scene = load_scene('two_joint_arm')
    hamiltonian, state = scene.create_hamiltonian(), scene.initial_state
    bands = []
    for h in (0.0025, 0.00125):
        simulation = Simulation(hamiltonian, INTEGRATORS['generalized_leapfrog'](), h,
                                state.q, state.p)
        energies = []
        for _ in range(200):
            simulation.advance(round(0.5 / h))
            energies.append(simulation.energy)
        bands.append(np.ptp(energies))
        # No drift: the second half is as good as the first.
        assert abs(np.mean(energies[100:]) - np.mean(energies[:100])) < bands[-1]
    # Of order 2; the motion is chaotic, so that the two see different states.
    assert bands[1] < 0.5 * bands[0] < 0.05


def test_scene_of_a_robot_is_found_again_from_a_recording_by_its_digest(tmp_path):
    (tmp_path / 'robot.urdf').write_text(chain([1.0], [1.0]))
    scene_file = write_scene(tmp_path / 'mine.yaml', 'urdf, file: robot.urdf')
    scene = load_scene(scene_file)
    assert scene.model_files() == {'robot.urdf': tmp_path / 'robot.urdf'}
    recorded = yaml.safe_dump(scene.model_dump(mode='json') | {
        'source': str(scene_file), 'model_files': scene.model_digests})
    again, _ = described_scene(recorded, 'bag')
    assert again.create_hamiltonian().coordinates[0].name == 'j1'
    (tmp_path / 'robot.urdf').write_text(chain([2.0], [1.0]))
    again, _ = described_scene(recorded, 'bag')
    with refused(Exception):
        again.create_hamiltonian()
