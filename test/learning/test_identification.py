# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The family rigid_body: a robot of a URDF whose inertias and friction are identified."""

from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.hamiltonians import RigidBodyTree, tree_kernel
from hnn_vi_ros.hamiltonians.rigid_body.tree import mass_matrix
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import ExcitationData, load_machine
from hnn_vi_ros.learning.families.priors import RigidTree
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.excitation import excited_motions
from hnn_vi_ros.learning.fit.inertias import identified_text, with_force_errors
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.learning.tasks.machine import learn
from hnn_vi_ros.learning.tasks.selection import RIGID, selected
from hnn_vi_ros.models import (
    INERTIAL, load_checkpoint, pseudo_inertia, save_checkpoint, tree_card, values_of)
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.models.rigid_body_card import bodies_of, check_values
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
import torch
from urdf_robots import ROOT, TREE

ARM = ROOT / 'config' / 'robots' / 'two_joint_arm.urdf'
EPS = np.finfo(np.float64).eps


def tree_of(path: Path, **settings) -> RigidTree:
    robot = RigidBodyTree(str(path), **settings)
    card = tree_card(robot.bodies, dict(enumerate(robot.joints)), robot.robot.name)
    return RigidTree(card, values_of(card, robot.bodies))


def shaken(tree: RigidTree, seed: int = 1) -> np.ndarray:
    """Give a tree random parameters, and return them."""
    rng = np.random.default_rng(seed)
    with torch.no_grad():
        for parameter, size in ((tree.raw, 0.5), (tree.offset, 1.0)):
            parameter.copy_(torch.tensor(rng.normal(0.0, size, parameter.shape)))
        tree.rotor.copy_(torch.tensor(rng.uniform(0.0, 0.3, tree.rotor.shape)))
        return tree.values().numpy().reshape(len(tree.raw), -1)


@pytest.fixture
def robots(tmp_path) -> list[RigidTree]:
    """Return one of every kind of joint, out of order, and a serial one."""
    (tmp_path / 'tree.urdf').write_text(TREE)
    joints = [joint.name for joint in RigidBodyTree(
        str(tmp_path / 'tree.urdf'), locked={'follower': 0.0}).joints]
    return [tree_of(tmp_path / 'tree.urdf', locked={'follower': 0.0}, joints=joints[::-1]),
            tree_of(ARM)]


def test_tree_in_torch_is_that_of_the_compiled_kernel(robots):
    for tree in robots:
        table = shaken(tree)
        bodies, d = bodies_of(tree.tree, table), len(table)
        rng = np.random.default_rng(2)
        q, v, a = rng.normal(size=(3, 5, d))
        at, moving, faster = map(torch.tensor, (q, v, a))
        with torch.no_grad():
            values = tree.values()
            M, forces = tree.mass(at, values), tree.forces(at, moving, values)
            turned, slope = (part.numpy() for part in tree.slopes(at, moving, values))
            columns = tree.columns(at, moving, faster)
        expected = np.stack([mass_matrix(bodies, one) for one in q])
        assert np.abs(M.numpy() - expected).max() < 1e-12 * np.abs(expected).max()
        kernel, (dH_dq, dH_dp) = tree_kernel(bodies), np.empty((2, *q.shape))
        kernel.gradient(kernel.parameters, q.ravel(), (expected @ v[:, :, None]).ravel(),
                        dH_dq.reshape(-1), dH_dp.reshape(-1))
        assert np.abs(slope + dH_dq).max() < 1e-12 * np.abs(dH_dq).max()
        assert np.abs(dH_dp - v).max() < 1e-12
        # (M v)' along q' = v, by automatic differentiation.
        _, change = torch.func.jvp(
            lambda q: (tree.mass(q, values) @ moving[:, :, None])[:, :, 0], (at,), (moving,))
        assert np.abs(change.detach().numpy() - turned).max() < 1e-12 * np.abs(turned).max()
        tau = (M @ faster[:, :, None])[:, :, 0] + forces
        assert (columns @ values - tau).abs().max() < 1e-12 * tau.abs().max()


def test_any_log_cholesky_parameters_are_those_of_a_body(robots):
    for tree in robots:
        for seed in range(20):
            table = shaken(tree, seed)
            check_values(tree.tree, table)
            for row in table:
                assert np.linalg.eigvalsh(pseudo_inertia(row[:INERTIAL]))[0] > 0.0
        table[0, 4] *= 10.0  # more than the two other moments together
        with refused(ValueError):
            check_values(tree.tree, table)


def config_of(family: dict | None = None, **changes) -> MachineConfig:
    return MachineConfig.model_validate({
        'coordinates': [{'name': 'shoulder', 'kind': 'continuous'}, {'name': 'elbow'}],
        'data': {'kind': 'excitation'}, 'loss': {'kind': 'inverse'},
        'family': {'kind': 'rigid_body', 'file': str(ARM)} | (family or {})} | changes)


def moved(noise: float, seed: int = 0, **settings):
    data = ExcitationData(kind='excitation', **{'runs': 2, 'duration': 5.0, 'interval': 0.01,
                                                'noise_tau': noise} | settings)
    return excited_motions(data, RigidBodyTree(str(ARM)), seed)[0]


def heavier(tmp_path: Path) -> Path:
    """Return the arm with other masses than it has."""
    path = tmp_path / 'heavier.urdf'
    path.write_text(ARM.read_text().replace('<mass value="1.2"/>', '<mass value="1.9"/>')
                    .replace('<mass value="2"/>', '<mass value="1.5"/>'))
    return path


def test_parameters_of_an_arm_are_found_from_a_wrong_urdf(tmp_path):
    path = heavier(tmp_path)
    fitted = learn(config_of({'file': str(path)}), moved(0.01))
    network, losses = fitted.module, fitted.losses
    found, truth = network.prior.identification, tree_of(ARM).values().detach().numpy()
    true_of = dict(zip(network.prior.names, truth, strict=True))
    # Two inertias, and first moments along and across each link; offsets, which are zero.
    assert len(found.base_parameters) == 8 and not found.weak
    for one in found.base_parameters:
        expected = sum(factor * true_of[name] for name, factor in one.combination.items())
        # Friction that turns over at another speed than the model's is worth some errors more.
        assert abs(one.value - expected) < 6.0 * one.standard_error
        assert 0.0 < one.standard_error < 0.02 * max(1.0, abs(one.value))
    # The same force of all samples, whatever changes along what is told to be idle.
    motion = moved(0.0)[0]
    states = map(torch.tensor, (motion.q, motion.v, motion.a_smooth))
    with torch.no_grad():
        columns = network.prior.columns(*states).numpy()
    size = np.abs(columns).max()
    assert len(found.held) == len(truth) - 2 - 8  # rotors are known, and not looked at
    for change in found.held:
        row = [change.get(name, 0.0) for name in network.prior.names]
        assert np.abs(columns @ row).max() < 1e-6 * size * np.abs(row).max()
    assert losses['rigid_body_inverse'] == pytest.approx(1.0, abs=0.5)


def test_held_parameters_stay_those_of_the_urdf(tmp_path):
    # Motions so slow that all forces are weights: inertia times acceleration, of some 0.01 N m,
    # is less than the noise.
    motions = moved(0.05, fastest=0.02, duration=40.0, interval=0.04)
    network = learn(config_of(), motions).module
    told, urdf = network.prior.identification, tree_of(ARM).values().detach().numpy()
    in_urdf = dict(zip(network.prior.names, urdf, strict=True))
    weak = {next(iter(one.combination)): one for one in told.weak}
    for one in (weak['forearm.inertia_yy'], weak['upper_arm.inertia_yy']):
        expected = sum(factor * in_urdf[name] for name, factor in one.combination.items())
        assert abs(one.value - expected) < 0.5 * one.standard_error
    assert 'The data hardly determine these' in identified_text(_model(network, motions).card)


def _model(network, motions):
    checkpoint = describe_machine(network, config_of(), motions, name='arm')
    return with_force_errors(checkpoint, network, motions)


def test_model_runs_as_others_do_and_keeps_its_energy(tmp_path):
    motions = moved(0.001)
    network = learn(config_of(), motions).module
    save_checkpoint(tmp_path / 'arm.safetensors', _model(network, motions))
    checkpoint = load_checkpoint(tmp_path / 'arm.safetensors')
    assert all(error < 1e-3 for error in
               checkpoint.card.mechanical.prior.identification.force_error)
    hamiltonian = MechanicalHamiltonian(checkpoint)
    state = np.array([0.3, 0.2]), np.zeros(2)

    def energies(*effects):
        simulation = Simulation(hamiltonian, INTEGRATORS['implicit_midpoint'](), 0.005, *state,
                                effects)
        before = hamiltonian.energy(*state)
        found = []
        for _ in range(100):
            simulation.advance(2)
            found.append(hamiltonian.energy(simulation.q, simulation.p) - before)
        return np.array(found)
    # The error of a symplectic method of order 2 is bounded by (omega h)^2 / 12 of what swings,
    # about omega = 9 / s and 1 J.
    assert np.abs(energies()).max() < (9.0 * 0.005)**2 / 12.0
    friction = EFFECTS['learned_friction'](str(tmp_path / 'arm.safetensors'))
    assert energies(friction)[-1] < -0.01


@pytest.mark.parametrize('residual', [['potential'], ['friction'], ['mass', 'potential']])
def test_networks_add_to_the_body_what_was_chosen(residual):
    config = config_of({'residual': residual}, hidden=[6], loss={
        'kind': 'inverse', 'steps': 2, 'lbfgs_steps': 0})
    network = learn(config, moved(0.01, runs=1, duration=2.0)).module
    rows = torch.tensor(np.random.default_rng(0).normal(size=(4, 2)))
    with torch.no_grad():
        L, slope = network._factor(rows), network._potential_slope(rows)
    assert (float(L.abs().max()) > 1e-10) == ('mass' in residual)
    assert bool(slope.any()) == ('potential' in residual)
    assert (network.structure.friction_features is not None) == ('friction' in residual)
    motions = moved(0.01, seed=1, runs=1, duration=1.0)
    checkpoint = _model(network, motions)
    share = checkpoint.card.mechanical.prior.identification.residual_share
    assert len(share) == 2 and all(0.0 < one < 1.0 for one in share)
    # The kernel of body and networks is what was trained.
    hamiltonian = MechanicalHamiltonian(checkpoint)
    q, v = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 2))
    with torch.no_grad():
        p, rate = (part[0].numpy() for part in network.momenta(
            torch.tensor(q[None]), torch.tensor(v[None])))
        friction = network.friction(torch.tensor(q[None]), torch.tensor(v[None]))[0].numpy()
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    assert np.abs(dH_dp - v).max() < 1e-12
    assert np.abs(-dH_dq - friction - rate).max() < 1e-12 * max(1.0, np.abs(dH_dq).max())


@pytest.mark.parametrize('text', [
    'family: {kind: rigid_body, file: none.urdf}',
    f'coordinates: [{{name: knee}}]\nfamily: {{kind: rigid_body, file: {ARM}}}',
    f'family: {{kind: rigid_body, file: {ARM}, residual: energy}}',
    f'family: {{kind: rigid_body, file: {ARM.with_name("gripper.urdf")}}}',
    f'family: {{kind: rigid_body, file: {ARM}}}\nloss: {{kind: forward}}',
    f'family: {{kind: rigid_body, file: {ARM}, friction: {{network: true}}}}',
    'family: {kind: mechanical}\ncoordinates: [{name: a}]'], ids=range(7))
def test_configurations_of_no_robot_are_refused_by_name(text, tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(f'data: {{kind: excitation}}\n{text}\n')
    with refused(DataError):
        load_machine(path)


def test_data_that_lack_forces_are_refused_by_name():
    motions = moved(0.0, runs=1, duration=1.0)
    few = [replace(motion, tau=motion.tau[:, :1]) for motion in motions]
    with refused(DataError):
        learn(config_of(), few)
    none = [replace(motion, tau=motion.tau * [1.0, 0.0]) for motion in motions]
    with refused(DataError):
        learn(config_of(), none)


@pytest.mark.parametrize('name, count', [('two_joint_arm', 2), ('six_joint_arm', 6)])
def test_shipped_arms_have_a_training_run(name, count):
    config = load_machine(ROOT / 'config' / 'training' / f'{name}.yaml')
    assert len(config.coordinates) == count
    assert len(config.structure().tree.bodies) == count


@pytest.mark.long
def test_auto_adds_no_networks_to_a_robot_that_is_one():
    config = config_of({'residual': 'auto', 'friction': {'coulomb': 1}}, hidden=[6], loss={
        'kind': 'trajectory', 'batch': 64, 'forward_steps': 20,
        'windows': [{'duration': 0.1, 'steps': 10}]}, data={'kind': 'arrays'})
    assert not config.structure().residual
    chosen, card = selected(config, moved(0.02))
    assert [one.name for one in card.candidates] == [
        RIGID, 'rigid body and a network of V', 'rigid body and networks']
    assert not any(one.failed for one in card.candidates)
    assert (card.chosen, chosen.family.residual) == (RIGID, [])
