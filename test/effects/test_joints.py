# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Limits and friction of joints: where their numbers come from, and an arm that falls on them."""

from dataclasses import replace
from pathlib import Path

from helpers import effect, plain_run, Uncompiled
from hnn_vi_ros.effects import EffectError, EFFECTS, EffectState, JointCommand, JointPath
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians import HAMILTONIANS, RigidBodyTree
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import FrictionCard, save_checkpoint
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, Simulation, System
from mechanical_models import random_mechanical
from messages import refused
from numba import typeof
import numpy as np
import pytest
from scene_files import write_scene
from urdf_robots import ROOT, TREE, TREE_ARGUMENTS

ARM = ROOT / 'config' / 'robots' / 'two_joint_arm.urdf'
GRIPPER = ARM.with_name('gripper.urdf')


def scene(folder: Path, *effects: str, h: float = 0.005, file: str = str(ARM)):
    return load_scene(write_scene(
        folder / 'scene.yaml', f'urdf, file: {file}', ', '.join(effects), step_size=h,
        q=[2.0, 0.5], p=[0.0, 0.0]))


def tree(folder: Path, text: str = TREE) -> RigidBodyTree:
    path = folder / 'robot.urdf'
    path.write_text(text)
    return RigidBodyTree(str(path), **TREE_ARGUMENTS)


def stops(robot: RigidBodyTree, *arguments: object) -> set[tuple[str, float, float]]:
    """Return coordinate, position and free side of each stop."""
    own = EFFECTS['joint_limits'](*arguments).resolve(
        robot.coordinates, EffectState.empty(1, robot.dimension))
    return {(robot.coordinates[place].name, position, sign) for place, position, sign in zip(
        own.columns, own.positions, own.signs, strict=True)}


def test_limits_of_the_urdf_are_stops_but_where_the_scene_gives_others(tmp_path):
    robot = tree(tmp_path)
    own = {('wrist', -2.0, 1.0), ('wrist', 1.5, -1.0), ('tail', -1.0, 1.0), ('tail', 1.0, -1.0),
           ('rail', -0.5, 1.0), ('rail', 0.5, -1.0), ('finger', 0.0, 1.0), ('finger', 0.1, -1.0)}
    # Not of the hip, which is continuous, nor of the follower, which is held.
    assert stops(robot, 'urdf') == own
    assert stops(robot, 'urdf', {'hip': -3.0}, {'tail': 0.5}) == (
        own - {('tail', 1.0, -1.0)} | {('hip', -3.0, 1.0), ('tail', 0.5, -1.0)})
    assert stops(robot, None, None, {'tail': 0.5}) == {('tail', 0.5, -1.0)}


def test_limit_that_is_missing_beside_another_is_zero(tmp_path):
    robot = tree(tmp_path, TREE.replace('lower="-0.5" upper="0.5"', 'upper="0.5"').replace(
        'lower="-2" upper="1.5" ', ''))
    ends = {(name, position) for name, position, _ in stops(robot, 'urdf')}
    assert {('rail', 0.0), ('rail', 0.5)} <= ends
    assert 'wrist' not in {name for name, _ in ends}


def test_several_stops_are_compiled_like_one(tmp_path):
    """Arrays of another layout would be another type to the compiler, and 10 s of a start."""
    robot = tree(tmp_path)
    several, one = (EFFECTS['joint_limits'](*arguments).resolve(
        robot.coordinates, EffectState.empty(1, robot.dimension))
        for arguments in (['urdf'], [None, {'wrist': -1.0}]))
    assert several.columns.size > one.columns.size == 1
    assert typeof(several) == typeof(one)


def test_friction_of_the_urdf_acts_but_where_the_scene_gives_other(tmp_path):
    robot = tree(tmp_path)
    names = [coordinate.name for coordinate in robot.coordinates]
    friction = effect('joint_friction', 'urdf', {'hip': 0.7}, {'rail': 0.2}, 0.05)
    own = friction.resolve(robot.coordinates, EffectState.empty(1, 5))
    assert dict(zip(names, own.damping, strict=True)) == {
        'wrist': 0.0, 'tail': 0.0, 'rail': 2.5, 'hip': 0.7, 'finger': 0.0}
    assert dict(zip(names, own.friction, strict=True)) == {
        'wrist': 0.0, 'tail': 0.0, 'rail': 0.2, 'hip': 0.0, 'finger': 0.0}
    velocity, f_q, f_p = np.array([1.0, -2.0, 0.03, 3.0, 1.0]), np.zeros(5), np.zeros(5)
    friction.add_force(own, 0.0, velocity, velocity, velocity, f_q, f_p)
    rail = -2.5 * 0.03 - 0.2 * np.tanh(0.6)
    assert f_p == pytest.approx([0.0, 0.0, rail, -0.7 * 3.0, 0.0], rel=1e-15)
    assert not f_q.any()


def test_friction_grows_with_the_commanded_force_while_it_acts(tmp_path):
    robot, state = tree(tmp_path), EffectState.empty(1, 5)
    (plain, own), velocity = ([EFFECTS['joint_friction'](
        None, {'hip': 0.7}, {'rail': 0.2}, 0.05, load).resolve(robot.coordinates, state)
        for load in (None, {'rail': 0.1})]), np.array([1.0, -2.0, 0.03, 3.0, 1.0])

    def force(parameters: object) -> np.ndarray:
        f_q, f_p = np.zeros((2, 5))
        EFFECTS['joint_friction'].add_force(parameters, 0.0, f_q, f_q, velocity, f_q, f_p)
        return f_p
    rest = force(plain)
    assert (force(own) == rest).all()
    for pull in (4.0, -4.0):
        state.command[2], state.command[-1] = pull, 1.0
        assert (force(plain) == rest).all()
        assert force(own) - rest == pytest.approx([0, 0, -0.4 * np.tanh(0.6), 0, 0], rel=1e-14)
    # Expired.
    state.clock[0] = 1.0
    assert (force(own) == rest).all()


@pytest.mark.parametrize('kind, arguments', [
    ('joint_limits', {'from_': 'urdf', 'upper': {'tail': -1.0}}),
    ('joint_friction', {'damping': {'tail': 0.0}})])
def test_numbers_that_do_not_fit_the_robot_are_refused(kind, arguments, tmp_path):
    with refused(EffectError):
        System(tree(tmp_path), [EFFECTS[kind](**arguments)], INTEGRATORS['gauss4']())


def test_friction_and_limits_of_followers_act_on_their_leader():
    robot = RigidBodyTree(str(GRIPPER))
    assert stops(robot, 'urdf') == {('finger_left', 0.0, 1.0), ('finger_left', 0.9, -1.0)}
    own = EFFECTS['joint_friction']('urdf').resolve(robot.coordinates, EffectState.empty(1, 1))
    assert [*own.damping, *own.friction] == pytest.approx([0.006, 0.006])


@pytest.mark.parametrize('given', [
    JointCommand(('finger_left', 'tip_left'), np.array([0.1, 0.2]), *np.full((2, 2), np.nan)),
    JointPath(('tip_right',), 0.0, np.ones(1), np.ones((1, 1)))])
def test_command_to_a_follower_is_refused_with_its_leader(given):
    robot, servo = RigidBodyTree(str(GRIPPER)), EFFECTS['servo'](['finger_left'], 1.0)
    simulation = plain_run(Uncompiled(robot), 'generalized_leapfrog', 0.001, [0.1], [0.0], servo)
    with refused(ValueError):
        simulation.set_command(given)
    # As ros2_control sends joints that it does not command.
    simulation.set_command(JointCommand(
        ('finger_left', 'tip_left'), np.array([0.3, np.nan]), *np.full((2, 2), np.nan)))
    assert simulation.motors.servo_target.targets[0] == [0.3]


def test_effect_on_a_follower_is_refused_with_its_leader():
    with refused(EffectError):
        System(RigidBodyTree(str(GRIPPER)), [EFFECTS['servo'](['tip_left'], 1.0)],
               INTEGRATORS['gauss4']())


@pytest.mark.parametrize('friction', ['joint', 'learned'])
def test_friction_under_load_reads_commands_as_the_force_does(friction, tmp_path):
    path, hamiltonian = tmp_path / 'map.safetensors', HAMILTONIANS['pendulum']()
    model = random_mechanical('joint', input_map=[[1.4]])
    save_checkpoint(path, replace(model, card=model.card.model_copy(update={
        'mechanical': model.card.mechanical.model_copy(update={
            'friction': FrictionCard(viscous=[0.1], switch=[0.1], load=[0.2])})})))
    by_motors = EFFECTS['external_force'](model=str(path))
    by_names = EFFECTS['external_force'](['angle'])
    if friction == 'joint':
        own, fits, other = EFFECTS['joint_friction'](load={'angle': 0.2}), by_names, by_motors
    else:
        own, fits, other = EFFECTS['learned_friction'](str(path)), by_motors, by_names
    System(hamiltonian, [fits, own], INTEGRATORS['rk4']())
    with refused(EffectError):
        System(hamiltonian, [other, own], INTEGRATORS['rk4']())


@pytest.mark.parametrize('kind', ['joint_limits', 'joint_friction'])
def test_coordinates_that_are_no_joints_have_no_numbers_of_a_urdf(kind):
    with refused(EffectError):
        System(HAMILTONIANS['pendulum'](), [EFFECTS[kind]('urdf')], INTEGRATORS['gauss4']())


@pytest.mark.parametrize('upper, missing', [
    ('', 'lower="-2.6" upper="2.6" '), (', upper: {shoulder: 1.5}', '')],
    ids=['a URDF without limits', 'a state beyond a limit'])
def test_limits_that_a_scene_cannot_have_are_refused_with_its_line(tmp_path, upper, missing):
    file = tmp_path / 'robot.urdf'
    file.write_text(ARM.read_text().replace(missing, ''))
    with refused(SceneError):
        build(scene(tmp_path, f'{{kind: joint_limits, from: urdf{upper}}}', file=str(file)))


@pytest.mark.parametrize('method, h', [('stormer_verlet', 0.05), ('gauss4', 0.2)])
@pytest.mark.parametrize('restitution', [0.0, 0.6, 1.0])
def test_one_stop_is_the_wall_of_an_impact(method, h, restitution):
    """Found, turned and held alike: what is left is rounding, which each impact makes larger."""
    states = []
    for one in (effect('impact', 'angle', 0.3, 'above', restitution), effect(
            'joint_limits', None, {'angle': 0.3}, {'angle': 3.0}, restitution)):
        simulation = plain_run('pendulum', method, h, [1.0], [0.0], one, on_failure='stop')
        q, p = simulation.record(round(4.0 / h), 1)
        states.append(np.hstack([q, p]))
        assert simulation.works.popitem()[1] == pytest.approx(simulation.work)
    np.testing.assert_allclose(states[0], states[1], rtol=0.0, atol=1e-9)


@pytest.mark.long
def test_arm_falls_on_its_stops_and_comes_to_rest_there(tmp_path):
    """Its energy balance closes with order 2, and no joint leaves its range."""
    lower, upper = np.array([0.4, -0.2]), np.array([2.5, 2.6])
    effects = ('{kind: joint_friction, from: urdf, speed: 0.5}',
               '{kind: joint_limits, from: urdf, lower: {shoulder: 0.4, elbow: -0.2}, '
               'upper: {shoulder: 2.5}, restitution: 0.3}')
    balances = []
    for h in (0.005, 0.0025):
        simulation = build(scene(tmp_path, *effects, h=h))
        q, _ = simulation.record(round(2.0 / h), 1)
        assert (q >= lower - 1e-12).all() and (q <= upper + 1e-12).all()
        assert (q.min(axis=0) <= lower + 1e-9).all()
        balances.append(abs(simulation.energy_balance))
        works = simulation.works
        assert set(works) == {'joint_friction', 'joint_limits'}
        assert all(work < -0.01 for work in works.values())
    simulation.advance(round(8.0 / h))
    assert simulation.q == pytest.approx(lower, abs=1e-6)
    assert np.abs(simulation.dH_dp).max() < 1e-6
    assert balances[1] < 0.5 * balances[0] < 0.01


def test_arm_at_rest_on_two_stops_leaves_one_of_them(tmp_path):
    """With the other joint held by its stop it moves as if that were locked."""
    at_rest = '{kind: joint_limits, upper: {shoulder: 2.0, elbow: 0.5}}'
    held = scene(tmp_path, at_rest, '{kind: external_force, coordinates: [shoulder, elbow], '
                 'initial: [-20.0, 60.0], timeout: 1.0}')
    alone = scene(tmp_path, '{kind: external_force, coordinates: [shoulder], initial: [-20.0], '
                  'timeout: 1.0}').changed({
                      'hamiltonian': {'kind': 'urdf', 'file': str(ARM), 'locked': {'elbow': 0.5}},
                      'initial_state': {'q': [2.0], 'p': [0.0]}})
    q, expected = (Simulation(
        Uncompiled(one.create_hamiltonian()), one.create_integrator(), 0.005, one.initial_state.q,
        one.initial_state.p, one.create_effects()).record(40, 1)[0] for one in (held, alone))
    assert (q[:, 1] == 0.5).all() and q[-1, 0] < 1.5
    # Impulses put it on its stop to eight roundings in a step, whose velocity acts for 40 steps.
    np.testing.assert_allclose(q[:, 0], expected[:, 0], rtol=0.0, atol=1e-12)
