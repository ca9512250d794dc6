# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Input maps of machines that have fewer motors than joints, or motors that move several."""

from dataclasses import replace

from belt import BELT, FAMILY, MAP, MASS, motion_by_a_belt, motions_by_a_belt
from helpers import long
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError, ModelError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import ArraysData, evaluate
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.data.text import LogMotions
from hnn_vi_ros.learning.families.choices import Structure
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.machine import scales_of
from hnn_vi_ros.learning.tasks.machine import learn
from hnn_vi_ros.models import FrictionCard, load_checkpoint, MechanicalCard, save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, Simulation
from machines import compiled, from_file, machine_config, shaken
from mechanical_models import random_mechanical, saved
from messages import misfit, refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch
from trainings import trained


@pytest.mark.parametrize('motors', [long(1), 2, long(3)])
def test_commands_act_in_torch_as_in_the_compiled_effect(tmp_path, motors: int):
    structure = Structure(['continuous', 'revolute', 'prismatic'], [
        [1.0, 0.0, 0.0], [0.0, 1.0, -0.5]], [[0.0, 1.0, 0.0]], friction_features=[[1.0, 0.0, 0.0]])
    rng = np.random.default_rng(motors)
    t = 0.01 * np.arange(60)
    motion = smoothed('random', t, np.sin(rng.uniform(1.0, 5.0, 3) * t[:, None]), None,
                      np.sin(rng.uniform(1.0, 9.0, motors) * t[:, None]), 40.0)
    network = shaken(MechanicalNetwork(structure, [6, 5], scales_of([motion], True), 3))
    hamiltonian, model = compiled(network, [motion], tmp_path, input_map='learned')
    checkpoint = hamiltonian.checkpoint
    input_map = np.array(checkpoint.card.mechanical.input_map)
    # The mean square of its columns is 1.
    assert input_map.shape == (3, motors)
    assert (input_map**2).sum() == pytest.approx(motors, rel=1e-14)
    effects = [EFFECTS['learned_friction'](model), EFFECTS['external_force'](model=model)]
    q, v = rng.uniform(-1.0, 1.0, (2, 4, 3))
    u = rng.uniform(-1.0, 1.0, (4, motors))
    p = momentum(hamiltonian, q, v, np.zeros_like(q))
    with torch.no_grad():
        found = network.accelerations(*map(torch.tensor, (q, v, u))).numpy()
        forces = network.forces(*map(torch.tensor, (q, v, found))).numpy()
    assert np.abs(forces - u @ input_map.T).max() < 1e-12
    simulation = build_simulation(hamiltonian, effects)
    for i in range(len(q)):
        simulation.restart(q[i], p[i])
        simulation.set_command(u[i])
        # dp/dt with all forces, and dq/dt.
        rates = -simulation.dH_dq, simulation.dH_dp
        expected = hamiltonian.hessian_vector(q[i], p[i], rates[1], rates[0])[1]
        assert np.abs(found[i] - expected).max() < 1e-11 * max(1.0, np.abs(expected).max())
    with refused(ValueError):
        simulation.set_command([1.0] * 4)


def build_simulation(hamiltonian: MechanicalHamiltonian, effects: list) -> Simulation:
    d = hamiltonian.dimension
    return Simulation(hamiltonian, INTEGRATORS['implicit_midpoint'](), 0.01, np.zeros(d),
                      np.zeros(d), effects)


@pytest.mark.long
def test_map_of_one_motor_on_two_joints_is_learned():
    config = MachineConfig.model_validate(BELT | {
        'loss': {'kind': 'forward', 'steps': 300, 'lbfgs_steps': 300}})
    network = learn(config, [motion_by_a_belt(seed) for seed in (1, 2)]).module
    with torch.no_grad():
        found = network.input_map().numpy()
        masses = network.masses(torch.zeros(1, 2, dtype=torch.float64))[0].numpy()
    # Accelerations are exact: all is found but what the networks leave of V.
    assert np.abs(found - MAP).max() < 0.02
    assert np.abs(masses - MASS).max() < 0.05


@pytest.mark.long
def test_map_is_learned_with_a_prior_whose_scale_its_norm_fixes():
    """Of a pendulum of 1 kg and 1 m under commands of half of its torques."""
    t = 0.01 * np.arange(400)
    z = solve_ivp(lambda t, z: [z[1], 4.0 * np.sin(2.0 * t) - 9.81 * np.sin(z[0])],
                  (0.0, t[-1]), [0.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y.T
    motion = smoothed('run', t, z[:, :1], z[:, 1:], -2.0 * np.sin(2.0 * t)[:, None], 40.0)
    config = machine_config(more={'loss': {
        'kind': 'trajectory', 'windows': [{'duration': 0.1, 'steps': 1}]}}, prior='pendulum',
        residual=False, input_map='learned', friction={'coulomb': 0})
    network = learn(config, [motion]).module
    with torch.no_grad():
        assert network.input_map().tolist() == [[-1.0]]
        # In units of twice the torque. The midpoint rule at 10 ms is off by (0.01 omega)^2 / 12.
        assert network.prior.values().numpy() == pytest.approx([0.5, 0.5 * 9.81], rel=5e-3)


def test_arrays_with_one_motor_become_a_model_a_scene_and_a_verdict(
        tmp_path, pytestconfig, capsys):
    made = trained(pytestconfig, 'belt', BELT | {
        'baseline': True, 'data': {'kind': 'arrays', 'test_runs': ['3', '4', '5', '6']}, 'loss': {
            'kind': 'trajectory', 'forward_steps': 200, 'forward_lbfgs_steps': 0,
            'windows': [{'duration': 0.1, 'steps': 5}]}}, motions_by_a_belt)
    data, out = made.data, made.model
    # A rigid body has motors at its joints.
    assert '| plain network |' in made.said and '| rigid body |' not in made.said
    card = load_checkpoint(out).card
    assert 'the mean square of its columns is 1' in card.dataset
    assert np.shape(card.mechanical.input_map) == (2, 1)
    evaluate.main([str(out), '--data', f'{data}:3', '--horizons', '0.1', '--baselines',
                   f'{data}:1'])
    assert 'The model follows the machine for' in capsys.readouterr().out
    scene = {'hamiltonian': {'kind': 'learned', 'model': str(out)},
             'integrator': {'kind': 'implicit_midpoint'}, 'step_size': 0.01,
             'initial_state': {'q': [0.1, 0.0], 'p': [0.0, 0.0]},
             'effects': [{'kind': 'learned_friction', 'model': str(out)},
                         {'kind': 'external_force', 'model': str(out), 'timeout': 10.0}]}
    (tmp_path / 'scene.yaml').write_text(dump_yaml(scene))
    simulation = build(load_scene(tmp_path / 'scene.yaml'))
    simulation.set_command([1.0])
    simulation.advance(100)
    assert abs(simulation.works['external_force']) > 1e-3
    evaluate.main([str(tmp_path / 'scene.yaml'), '--data', f'{data}:3', '--horizons', '0.1'])
    assert 'The model follows the machine for' in capsys.readouterr().out
    # Commands of the motors are no forces on the joints.
    scene['effects'][1] = {'kind': 'external_force', 'coordinates': ['a', 'b']}
    (tmp_path / 'joints.yaml').write_text(dump_yaml(scene))
    with refused(DataError):
        evaluate.main([str(tmp_path / 'joints.yaml'), '--data', f'{data}:3'])


@pytest.mark.parametrize('changes', [{'prior': 'henon_heiles'}, {'input_map': 'network'}])
def test_configuration_refuses_maps_that_cannot_be_learned(changes):
    with misfit():
        MachineConfig.model_validate(BELT | {'family': FAMILY | changes})
    with misfit():
        MachineConfig.model_validate(BELT | {'loss': {'kind': 'inverse'}})


@pytest.mark.parametrize('commands', [0.0, 1.0])
def test_commands_that_tell_nothing_of_a_map_are_refused(commands):
    motion = motion_by_a_belt(1, 1.0)
    motion = replace(motion, tau=commands * np.hstack([motion.tau, 2.0 * motion.tau]))
    with refused(DataError):
        learn(MachineConfig.model_validate(BELT), [motion])


def test_fewer_motors_than_joints_need_a_learned_map():
    config = MachineConfig.model_validate(
        BELT | {'family': FAMILY | {'input_map': 'identity'}})
    with refused(DataError):
        learn(config, [motion_by_a_belt(1, 1.0)])


@pytest.mark.parametrize('input_map', [[[1.0]], [[1.0], [1.0, 2.0]], [[], []], [[1.0] * 3] * 2])
def test_card_refuses_a_map_that_fits_no_coordinates(input_map):
    with misfit():
        MechanicalCard(kinds=['revolute'] * 2, features=[[1.0, 0.0]], mass_features=[], floor=0.1,
                       mass_scale=[1.0, 1.0], friction=FrictionCard(viscous=[0.0, 0.0]),
                       input_map=input_map)


def test_external_force_names_models_that_have_a_map(tmp_path):
    with refused(ModelError):
        EFFECTS['external_force'](model=saved(tmp_path, 'arm'))
    card = random_mechanical('arm').card
    model = replace(random_mechanical('arm'), card=card.model_copy(update={
        'mechanical': card.mechanical.model_copy(update={'input_map': [[1.0], [2.0]]})}))
    save_checkpoint(tmp_path / 'belt.safetensors', model)
    effect = EFFECTS['external_force'](model=str(tmp_path / 'belt.safetensors'))
    hamiltonian = MechanicalHamiltonian(random_mechanical('three'))
    with refused(ValueError):
        build_simulation(hamiltonian, [effect])


def test_logs_and_arrays_may_hold_fewer_motors_than_joints(tmp_path):
    columns = ['t', 'a', 'b', 'u']
    assert LogMotions(columns=columns, time='t', q=['a', 'b'], tau=['u']).tau == ['u']
    for key, names in (('v', ['u']), ('tau', ['u', 'v', 'w'])):
        with misfit():
            LogMotions(columns=[*columns, 'v', 'w'], time='t', q=['a', 'b'], **{key: names})
    t = 0.01 * np.arange(40)
    q, v = (np.stack(part, axis=1) for part in (
        (np.sin(t), np.cos(t)), (np.cos(t), -np.sin(t))))
    for shape, fits in (((40, 1), True), ((40, 2), True), ((40, 3), False), ((40, 0), False)):
        np.savez(tmp_path / 'belt.npz', t=t, q=q, dq=v, tau=np.ones(shape))
        if fits:
            (motion,), _ = from_file(tmp_path / 'belt.npz', ArraysData(), 2)
            assert motion.tau.shape == shape
            continue
        with refused(DataError):
            from_file(tmp_path / 'belt.npz', ArraysData(), 2)
