# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tasks: their files, what is wrong with some, and the state that a late command finds."""

import json

from hnn_vi_ros import load_scene
from hnn_vi_ros.commands.new_scene import write_scene
from hnn_vi_ros.control import assign, BatchStep, velocity
from hnn_vi_ros.control.task import CommandPrediction, load_task, Task
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import json_schema, share_folder, shipped_file, shipped_names
from hnn_vi_ros.simulation import build
from messages import refused
import numpy as np
import pytest
from urdf_robots import chain
import yaml

GOOD = yaml.safe_load(shipped_file('task', 'swing_up').read_text())
ILQR = {'kind': 'ilqr', 'horizon': 10, 'budget': 0.01, 'running': [{'kind': 'effort'}],
        'final': [{'kind': 'kinetic'}]}


@pytest.mark.parametrize('name', shipped_names('task'))
def test_every_shipped_task_names_its_schema_and_a_scene_that_takes_its_inputs(name):
    text = shipped_file('task', name).read_text()
    assert text.startswith('# yaml-language-server: $schema=../task.schema.json\n')
    task, _, folder = load_task(name)
    path = folder / task.scene
    scene = load_scene(path if path.is_file() else task.scene)
    force, = (effect for effect in scene.effects if effect.kind == 'external_force')
    assert set(task.inputs) <= set(force.coordinates) and task.silence >= force.timeout


def test_a_controller_takes_the_scene_that_is_written_for_an_arm(tmp_path):
    """Its stops and its dry friction, about an axis on which no weight acts, included."""
    limit = '<limit lower="-3" upper="3" effort="9" velocity="9"/>'
    text = chain([1.0, 1.0], [0.5, 0.5]).replace('"continuous">', f'"revolute">{limit}').replace(
        '<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/><dynamics damping="0.1" friction="0.2"/>', 1)
    (tmp_path / 'arm.urdf').write_text(text.replace('<origin xyz="0 0 -0.5"/>',
                                                    '<origin xyz="0.5 0 -0.5"/>', 1))
    scene = write_scene(str(tmp_path / 'arm.urdf'), tmp_path / 'arm.yaml')
    assert [effect.kind for effect in load_scene(scene).effects] == [
        'joint_friction', 'joint_limits']
    (tmp_path / 'task.yaml').write_text(yaml.safe_dump({
        'scene': 'arm.yaml', 'inputs': {'j1': 9.0, 'j2': 9.0}, 'period': load_scene(
            scene).step_size, 'goal': {'near': {'j1': 0.5, 'j2': 2.0}, 'held': True},
        'controller': {'kind': 'lqr'}}))
    assigned = assign(tmp_path / 'task.yaml')
    assert assigned.left_out == ['joint_limits']
    # At the goal the command is the weight of the second bob alone.
    u = assigned.controller(np.array([0.5, 2.0]), np.zeros(2), 0.0)
    assert u == pytest.approx([0.0, 9.81 * 0.5 * np.sin(2.0)], abs=1e-9)


def test_schema_of_tasks_is_the_shipped_one():
    shipped = (share_folder() / 'config' / 'task.schema.json').read_text(encoding='utf-8')
    assert shipped == json_schema(Task, 'A task of the controller node') + '\n'
    json.loads(shipped)


@pytest.mark.parametrize('changes', [
    {'scene': 'motor_pendlum'}, {'inputs': {'angel': 4.0}}, {'inputs': {}},
    {'inputs': {'angle': float('nan')}}, {'period': 0.0111}, {'period': 1e-4, 'delay': 1.0},
    {'silence': 0.0}, {'on_silence': 'panic'}, {'goal': None}, {'goal': {'near': {'angel': 3.1}}},
    {'goal': {'near': {'angle': 3.1}, 'position': [1.0, 2.0]}},
    {'stepping': {'integrator': 'rk5', 'step_size': 0.01}},
    {'stepping': {'integrator': 'discrete_gradient', 'step_size': 0.01}},
    {'controller': {'kind': 'energy_shapping'}},
    {'controller': {'kind': 'energy_shaping', 'gian': 1.0}},
    {'controller': {'kind': 'hover', 'place': [0.0, 0.0, 1.0]}},
    {'controller': ILQR | {'final': [{'kind': 'point', 'link': 'tool', 'goal': [0.0] * 3}]}},
    {'controller': ILQR | {'running': []}},
    {'controller': ILQR | {'running': [{'kind': 'quadratic', 'position': [1.0, 2.0]}]}},
    {'controller': ILQR | {'horizon': 1}},
    {'stepping': {'integrator': 'rk4', 'step_size': 1e-12}},
    {'controller': {'kind': 'mppi', 'horizon': 10_000, 'samples': 100_000, 'temperature': 1.0,
                    'running': ILQR['running'], 'final': ILQR['final']}}], ids=str)
def test_task_that_cannot_be_used_is_one_line_with_its_place(tmp_path, changes):
    data = {key: value for key, value in (GOOD | changes).items() if value is not None}
    (tmp_path / 'task.yaml').write_text(yaml.safe_dump(data, sort_keys=False))
    with refused(DataError):
        assign(tmp_path / 'task.yaml')


def test_task_of_another_scene_needs_its_coordinates_by_name():
    with refused(DataError):
        assign('swing_up', 'cart_pole')
    # The real one has friction and another step; the task's inputs and steps replace its own.
    assigned = assign('swing_up', load_scene('exact_pendulum').with_overrides(0.005, 'rk4'))
    assert (assigned.scene.step_size, assigned.numbers) == (0.005, ['angle'])
    assert [effect.kind for effect in assigned.scene.effects] == ['external_force']


def test_prediction_is_the_run_under_the_commands_that_are_under_way():
    scene, delay, chance = load_scene('motor_pendulum'), 0.03, np.random.default_rng(1)
    run, predict = build(scene), CommandPrediction(BatchStep(scene), delay)
    steps, told, wanted = BatchStep(scene), [], []
    for k in range(20):
        # A command to the state of k * 0.01 s acts from 0.03 s later on.
        if k >= 3:
            run.set_command(told[k - 3])
        z = np.concatenate([run.q, run.p])
        for index, expected in [one for one in wanted if one[0] == k]:
            assert np.abs(expected - z).max() < 1e-12, index
        q, v = predict(k * 0.01, run.q, velocity(steps, run.q, run.p))
        wanted.append((k + 3, np.array([q[0], v[0]])))
        told.append(chance.uniform(-4.0, 4.0, 1))
        predict.send(k * 0.01, told[-1])
        run.advance(5)
    predict.reset()
    assert predict(0.0, np.array([np.pi]), np.zeros(1))[0] == pytest.approx(np.pi)


def test_every_controller_of_a_task_commands_within_its_limits(tmp_path):
    for controller in ({'kind': 'lqr'}, ILQR, {'kind': 'mppi', 'temperature': 1.0, 'samples': 4}
                       | {key: ILQR[key] for key in ('horizon', 'running', 'final')}):
        (tmp_path / 'task.yaml').write_text(yaml.safe_dump(GOOD | {'controller': controller}))
        assigned = assign(tmp_path / 'task.yaml')
        u = assigned.controller(np.array([3.0]), np.array([0.1]), 0.0)
        assert u.shape == (1,) and np.abs(u) <= assigned.limits
