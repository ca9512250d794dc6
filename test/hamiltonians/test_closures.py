# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Closed chains in the dialects of Isaac Sim, Gazebo and Drake: read as loops, or refused."""

from pathlib import Path

from hnn_vi_ros.commands.new_scene import write_scene
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build
from messages import refused
import numpy as np
import pytest

# Corners of the linkage at zero of all joints; its shortest bar can turn without end.
CORNERS = np.array([0.0, 0.9, 1.0 + 0.4j, 0.3 + 0.55j, 0.0])
BARS = np.diff(CORNERS)
LENGTHS, ANGLES = np.abs(BARS).tolist(), np.angle(BARS)
ENDS = f'<link1 link="d" xyz="0 {-LENGTHS[3]} 0" rpy="0 0 0"/><link2 link="a"/>'
POINTS = ''.join(f'<drake:ball_constraint_{tag}/>' for tag in (
    'body_A name="d"', 'body_B name="a"', f'p_AP value="0 {-LENGTHS[3]} 0"',
    'p_BQ value="0 0 0"'))
GAZEBO = ('<gazebo><joint name="l" type="{}"><parent>{}</parent><child>{}</child>{}</joint>'
          '</gazebo>')


def four_bar(closing: str) -> str:
    """Return bars along -y, of which the ground a carries those that turn about x."""
    parts = ['<robot name="four" xmlns:drake="http://drake.mit.edu">']
    for name, length in zip('abcd', LENGTHS, strict=True):
        parts.append(
            f'<link name="{name}"><inertial><mass value="2"/><origin xyz="0 {-length / 2} 0"/>'
            '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>')
    for name, other, length, angle in zip(
            'abc', 'bcd', LENGTHS[:3], np.diff(ANGLES), strict=True):
        parts.append(
            f'<joint name="{other}" type="revolute"><axis xyz="1 0 0"/><parent link="{name}"/>'
            f'<child link="{other}"/><origin xyz="0 {-length} 0" '
            f'rpy="{angle} 0 0"/><limit lower="-3" upper="3"/></joint>')
    return ''.join([*parts, closing, '</robot>'])


def read(folder: Path, text: str, **arguments: object) -> RigidBodyTree:
    (folder / 'robot.urdf').write_text(text)
    return RigidBodyTree(str(folder / 'robot.urdf'), **arguments)


@pytest.mark.parametrize('closing', [
    f'<loop_joint name="l" type="revolute">{ENDS}<axis xyz="2 0 0"/></loop_joint>',
    # A sphere and a hinge are the same in a plane.
    f'<loop_joint name="l" type="spherical">{ENDS}</loop_joint>',
    f'<drake:ball_constraint>{POINTS}</drake:ball_constraint>',
    GAZEBO.format('revolute', 'd', 'a', '<axis><xyz>1 0 0</xyz></axis>'),
    # The axis is in the frame of the joint.
    GAZEBO.format('revolute', 'd', 'a', '<pose>0 0 0 0 0 1.5707963267948966</pose><axis><xyz>0 -1 '
                                        '0</xyz></axis>'),
    GAZEBO.format('ball', 'a', 'd', f'<pose>0 {-LENGTHS[3]} 0 0 0 0</pose>'),
    # Isaac's own example names both ends so.
    f'<loop_joint name="l" type="revolute">{ENDS.replace("link2", "link1")}</loop_joint>'])
def test_chains_of_other_dialects_move_as_with_loops(tmp_path, closing):
    (tmp_path / 'robot.urdf').write_text(four_bar(closing))
    scene = load_scene(write_scene(str(tmp_path / 'robot.urdf'), tmp_path / 'new.yaml'))
    loop = {'links': ['d', 'a'], 'joint': 'point',
            'points': [[0.0, -LENGTHS[3], 0.0], [0.0, 0.0, 0.0]]}
    given = scene.changed({'hamiltonian': {**scene.hamiltonian.model_dump(), 'loops': [loop]}})
    simulation = build(scene)
    start = simulation.q.copy()
    found, expected = (one.record(20, round(0.05 / scene.step_size))[0]
                       for one in (simulation, build(given)))
    # Round-off in frames, of a motion that is regular for 1 s.
    assert np.abs(found - expected).max() < 1e-9
    assert np.abs(found - start).max() > 0.1
    turned = ANGLES[1:] + np.cumsum(found, axis=1)
    assert np.abs(LENGTHS[0] + np.exp(1j * turned) @ LENGTHS[1:]).max() < 1e-12


@pytest.mark.parametrize('closing', [
    '<constraint name="l" type="revolute"/>', '<loop name="l" type="revolute"/>',
    '<drake:linear_bushing_rpy/>', '<drake:joint name="l" type="ball"/>',
    f'<loop_joint name="l" type="prismatic">{ENDS}</loop_joint>',
    f'<loop_joint name="l" type="fixed">{ENDS.replace("0 0 0", "0 0 far")}</loop_joint>',
    f'<drake:ball_constraint>{POINTS.replace("d", "none")}</drake:ball_constraint>',
    GAZEBO.format('screw', 'd', 'a', ''), GAZEBO.format('revolute', 'd', 'none', ''),
    GAZEBO.format('ball', 'd', 'a', '<pose relative_to="c">0 0 0 0 0 0</pose>'),
    GAZEBO.format('ball', 'd', 'a', '<pose>0 0 0</pose>'),
    '<gazebo><joint:hinge name="l"><body1>d</body1><body2>a</body2></joint:hinge></gazebo>'],
    ids=range(12))
def test_chain_that_is_no_loop_is_refused_or_opened_by_name(tmp_path, closing):
    with refused(ModelError):
        read(tmp_path, four_bar(closing))
    # Numbers that cannot be read are mistakes.
    if 'far' not in closing and '<pose>0 0 0</pose>' not in closing:
        assert read(tmp_path, four_bar(closing), loops=[]).loops is None


@pytest.mark.parametrize('closing, arguments', [
    # The base rests in the world.
    (GAZEBO.format('fixed', 'world', 'a', ''), {}),
    # A chain of which no joint moves.
    (f'<loop_joint name="l" type="prismatic">{ENDS}</loop_joint>',
     {'locked': {'b': 0.0, 'c': 0.0, 'd': 0.0}, 'base': 'a'}),
    # Behind another base.
    (GAZEBO.format('screw', 'b', 'a', ''), {'base': 'c'}),
    ('<gazebo reference="a"><mu1>0.2</mu1></gazebo>', {})])
def test_elements_that_no_joint_moves_close_nothing(tmp_path, closing, arguments):
    arm = ('<link name="arm"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
           'iyz="0" izz="1"/></inertial></link><joint name="arm" type="continuous"><parent '
           'link="d"/><child link="arm"/></joint>')
    assert read(tmp_path, four_bar(closing + arm), **arguments).loops is None


def test_joints_that_follow_others_stand_for_a_closing_joint(tmp_path):
    """As in the gripper of the PR2, which the first Gazebo closed with <joint:hinge>."""
    text = four_bar('<gazebo><joint:hinge name="l"><body1>d</body1><body2>b</body2></joint:hinge>'
                    '</gazebo>')
    for name in 'cd':
        text = text.replace(f'<child link="{name}"/>', f'<child link="{name}"/><mimic joint="b"/>')
    with pytest.warns(UserWarning, match=r"joint:hinge 'l': left out, because joints that follow"):
        tree = read(tmp_path, text)
    assert tree.loops is None and tree.dimension == 1
