# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The scene that is written for a robot: valid, in motion, and never over another file unasked."""

from pathlib import Path
import re
import shutil

from hnn_vi_ros.commands import new_scene as new_scene_module
from hnn_vi_ros.commands.new_scene import fixed_joints, resting_state, write_scene
from hnn_vi_ros.commands.scene_tool import main
from hnn_vi_ros.errors import ModelError, SceneError
from hnn_vi_ros.hamiltonians import parse_urdf
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, simulate
from messages import refused
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros.recorded import record_run, recorded_messages
from sensor_msgs.msg import JointState
from urdf_robots import chain, SHIPPED, TREE

TREE_FILE = 'tree: 1.urdf'


# The larger ones compile for longer, and no other code.
@pytest.fixture(params=[TREE_FILE, *(pytest.param(
    path.name, marks=() if path.name == 'two_joint_arm.urdf' else pytest.mark.long)
    for path in SHIPPED)])
def robot(request, tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / 'robots' / request.param
    path.parent.mkdir()
    if request.param == TREE_FILE:
        path.write_text(TREE)
    else:
        shutil.copy(next(file for file in SHIPPED if file.name == request.param), path)
    return path


def test_new_scene_of_a_robot_is_valid_and_moves_at_once(robot, capsys):
    assert main(['--new', 'new', '--robot', str(robot)]) == 0
    assert capsys.readouterr().out.startswith('new.yaml\n')
    simulation = build(load_scene('new.yaml'))
    start = simulation.q.copy()
    simulation.advance(round(0.5 / simulation.step_size))
    # Gravity alone would move a free joint by g t^2 / 2 = 1.2 in that time.
    assert np.abs(simulation.q - start).max() > 1e-2
    scale = simulation.hamiltonian.kernel.energy_scale
    # A method of order 2, with 100 steps in the fastest period.
    assert abs(simulation.energy_balance) < (2.0 * np.pi / 100.0)**2 * scale + 1e-8


def test_robot_stays_where_it_is_said_to_rest(robot):
    scene = load_scene(write_scene(str(robot), Path('new.yaml')))
    q = resting_state(build(scene).hamiltonian)
    simulation = build(scene.model_copy(update={
        'initial_state': scene.initial_state.model_copy(update={'q': q.tolist()})}))
    simulation.advance(round(0.5 / simulation.step_size))
    assert simulation.rescued == 0
    # The state has six digits: what is left of forces are 1e-6 of the weights.
    assert np.abs(simulation.q - q).max() < 1e-4


def new_scene(folder: Path, robot: str) -> Path:
    """Write the scene of a robot, given as the text of its URDF; return its path."""
    (folder / 'robot.urdf').write_text(robot)
    return write_scene(str(folder / 'robot.urdf'), folder / 'new.yaml', force=True)


def test_joint_that_moves_next_to_nothing_gets_a_rotor(tmp_path):
    scene = load_scene(new_scene(tmp_path, chain([1.0, 1e-6], [1.0, 0.1])))
    # Both joints turn: the unit of all is told once.
    assert 'q: [0.3, 0.3]   # [rad]\n' in (tmp_path / 'new.yaml').read_text()
    # The first link has m l^2 = 1 kg m2, of which the second one feels 1e-8.
    assert scene.hamiltonian.rotor_inertia == {'j2': pytest.approx(1e-3, rel=1.0)}
    # As above without rotors: two small motions, of which the faster one has 3.2 rad/s.
    assert scene.step_size == 0.01


def test_damping_that_stops_a_joint_at_once_gets_a_rotor(tmp_path):
    """As hands and grippers have it: 1 N m s/rad on a finger of 1e-4 kg m2."""
    text = chain([1.0, 0.01], [1.0, 0.1]).replace(
        '<child link="l2"/>', '<child link="l2"/><dynamics damping="1.0"/>')
    scene = load_scene(new_scene(tmp_path, text))
    # The time of damping is that of the rotor: 1 ms.
    assert scene.hamiltonian.rotor_inertia == {'j2': 1e-3}
    assert scene.step_size >= 0.5 * 1e-3


def test_new_scene_has_a_step_size_that_resolves_its_first_second(tmp_path, monkeypatch, capsys):
    """A light link between heavy ones whips: the small motions about equilibrium are slower."""
    scene = load_scene(new_scene(tmp_path, chain([0.01, 1.0], [0.1, 1.0])))

    def error(step_size: float) -> float:
        """Return the change by an eighth of the step, relative to the motion."""
        coarse, fine = (build(scene.model_copy(update={'step_size': step_size / k})).record(
            20, k * round(0.05 / step_size))[0] for k in (1, 8))
        return np.abs(coarse - fine).max() / np.ptp(fine, axis=0).max()
    # Half the step changes it by 1 %, of which the sum of 1, 1/4, 1/16 ... is 4/3.
    assert error(scene.step_size) < 4.0 / 3.0 * 0.01 < error(2.5 * scene.step_size)
    assert capsys.readouterr().err == 'moves: j1, j2\n'
    monkeypatch.setattr(new_scene_module, '_MAX_CHANGE', 1e-9)
    new_scene(tmp_path, chain([1.0, 1.0], [1.0, 1.0]))
    assert re.search(r'step_size: 0.001 s changes the first second by 0.00\d+ %',
                     capsys.readouterr().err)


def test_names_with_slashes_and_digits_are_those_of_joint_states(tmp_path):
    """As the Robonaut has them, and quadrupeds that number their joints."""
    names = ['/r2/waist.joint-0', '8', '1e5']
    text = chain([1.0] * 3, [1.0] * 3)
    for k, name in enumerate(names, 1):
        text = text.replace(f'name="j{k}"', f'name="{name}"')
    scene = load_scene(new_scene(tmp_path, text))
    assert scene.hamiltonian.joints == names
    record_run(tmp_path / 'bag', scene, 3)
    last = recorded_messages(tmp_path / 'bag')['/joint_states'][-1]
    assert deserialize_message(last, JointState).name == names


def test_new_scene_names_joints_limits_and_tells_what_follows_another(tmp_path, capsys):
    path = new_scene(tmp_path, TREE)
    assert capsys.readouterr().err == (
        'moves: hip, rail, wrist, finger, tail\nfollows: follower = 1 * finger + 0 m\n')
    scene, text = load_scene(path), path.read_text()
    assert ('- rail     # prismatic, -0.5 to 0.5 m, damping 2.5 N s/m, friction 0.5 N\n'
            '    - wrist    # revolute, -2 to 1.5 rad\n') in text
    assert '  # Follows another: follower = 1 * finger + 0 m\n' in text
    assert 'ratio squared [kg m2], [kg].\n' in text
    assert 'one number per joint [N m], [N], [N m], [N], [N m]:\n' in text
    assert 'speed: 0.01}   # [rad/s], [m/s]\n' in text
    assert scene.hamiltonian.file == 'robot.urdf'
    assert scene.hamiltonian.joints == ['hip', 'rail', 'wrist', 'finger', 'tail']
    assert scene.hamiltonian.locked is None
    assert [effect.kind for effect in scene.effects] == ['joint_friction', 'joint_limits']


def test_robot_that_stands_upright_at_zero_rests_hanging(tmp_path):
    """The lengths are turned over: both rods point up where the angles are zero."""
    scene = load_scene(new_scene(tmp_path, chain([1.0, 1.0], [-1.0, -0.7])))
    rest = resting_state(build(scene).hamiltonian)
    assert np.abs(rest) == pytest.approx([np.pi, 0.0], abs=2e-6)
    assert scene.effects == []
    text = (tmp_path / 'new.yaml').read_text()
    assert f'  # Off equilibrium, which is {rest.tolist()}.\n' in text
    # Its faster small motion has 6.6 rad/s, and 100 steps in a period.
    assert scene.step_size == 0.005


def test_new_scene_names_stops_and_its_servo_holds_the_initial_state(tmp_path):
    # Light enough for the motors.
    robot = chain([0.3, 0.3], [-1.0, -0.7]).replace('"j1" type="continuous">', (
        '"j1" type="revolute"><limit lower="-3" upper="3" effort="1" velocity="1"/>'))
    path = new_scene(tmp_path, robot)
    text = path.read_text()
    assert ', with j1 at a stop.\n' in text
    path.write_text(re.sub(r'# (- {kind: servo.*\n  )# ', r'\1  ', text))
    run = simulate(path, 0.1)
    assert run.scene.effects[-1].kind == 'servo' and np.ptp(run.q, axis=0).max() < 1e-12


def test_joints_that_cannot_move_or_are_too_many_are_held():
    text = chain([1.0] * 14, [1.0] * 14).replace(
        'name="j2" type="continuous"', 'name="j2" type="revolute"').replace(
        '<parent link="l1"/>', '<parent link="l1"/><limit lower="0.5" upper="0.5"/>')
    assert fixed_joints(parse_urdf(text.encode(), 'robot')) == {
        'j2': (0.5, 'its limits 0.5 and 0.5 are equal'),
        'j14': (0.0, 'at most 12 joints move')}


@pytest.mark.parametrize('mimic, told', [
    ('joint="hip" multiplier="-0.1" offset="0.05"',
     'follows: follower = -0.1 m/rad * hip + 0.05 m'),
    ('joint="rail"', 'fixed (see locked in the scene): rail at 0.5: its limits 0.5 and 0.5 are '
     'equal\nfixed with its leader: follower at 0.5'),
    ('joint="thumb"', 'fixed (see locked in the scene): follower at 0: it mimics thumb, which is '
     'not a joint that can lead it')])
@pytest.mark.filterwarnings('ignore:.*limits of joints that mimic others')
def test_new_scene_tells_what_a_joint_follows(tmp_path, capsys, mimic, told):
    text = TREE.replace('joint="finger"', mimic)
    if 'rail' in mimic:
        text = text.replace('lower="-0.5" upper="0.5"', 'lower="0.5" upper="0.5"')
    load_scene(new_scene(tmp_path, text))
    assert capsys.readouterr().err.split('\n', 1)[1] == f'{told}\n'


def test_guessed_inertia_of_a_rotor_is_printed(tmp_path, capsys):
    """A tool of 4e-4 kg m2 on an arm of 1.55 kg m2."""
    inertia = 'ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"'
    text = chain([4.0, 0.25], [0.5, 0.0]).replace(inertia.format(0), inertia.format(0.3), 1)
    text = text.replace(inertia.format(0), inertia.format(4e-4))
    new_scene(tmp_path, text)
    assert capsys.readouterr().err.splitlines()[1] == (
        'rotor inertia guessed (see rotor_inertia in the scene): j2 0.002 kg m2, beside 0.0004 of '
        'its links')


# As exports of CAD have limits where none were set.
NO_ROOM = '<limit lower="0" upper="0" effort="0" velocity="0"/>'


@pytest.mark.parametrize('joints', [1, 2])
def test_joint_with_limits_of_zero_is_named_with_what_was_done(joints, tmp_path, capsys):
    text = chain([1.0] * joints, [1.0] * joints).replace(
        f'name="j{joints}" type="continuous">', f'name="j{joints}" type="revolute">{NO_ROOM}')
    if joints == 1:
        with refused(ModelError):
            new_scene(tmp_path, text)
    else:
        new_scene(tmp_path, text)
        assert capsys.readouterr().err == (
            'moves: j1\nfixed (see locked in the scene): j2 at 0: its limits 0 and 0 are equal\n')


def test_units_of_slides_are_those_of_lengths(tmp_path):
    text = TREE.replace('type="revolute"', 'type="prismatic"').replace(
        '"continuous">', '"prismatic">')
    text = new_scene(tmp_path, text).read_text()
    assert 'rad' not in text and 'N m' not in text and 'kg m2' not in text
    assert '# [m/s]\n' in text and 'squared [kg].' in text
    assert 'joint [N]:' in text


def test_new_scene_takes_the_place_of_no_file(tmp_path):
    (tmp_path / 'robot.urdf').write_text(TREE)
    mine = tmp_path / 'mine.yaml'
    mine.write_text('mine')
    with refused(SceneError):
        write_scene(str(tmp_path / 'robot.urdf'), mine)
    assert mine.read_text() == 'mine'
    assert main(['--new', str(mine), '--robot', str(tmp_path / 'robot.urdf'), '--force']) == 0
    assert load_scene(mine).hamiltonian.kind == 'urdf'


def test_robot_that_is_not_there_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ('none.urdf', 'package://none/robot.urdf'):
        with refused(ModelError):
            write_scene(file, None)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('masses, lengths', [
    ([1e-300, 1e-300], [1.0, 1.0]), ([1.0, 1.0], [1e12, 1e-12]), ([1e-300, 1e12], [1.0, 1e-9])])
def test_scene_of_a_robot_of_any_sizes_is_valid_or_refused_in_a_line(masses, lengths, tmp_path):
    try:
        scene = new_scene(tmp_path, chain(masses, lengths))
    except ModelError as refused:
        assert 'robot.urdf: at equilibrium' in str(refused) and '\n' not in str(refused)
    else:
        build(load_scene(scene))
