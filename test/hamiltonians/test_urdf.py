# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""URDF files: what is read of them, and what each mistake is answered with."""

import re
import warnings

from hnn_vi_ros.errors import HnnViRosError, ModelError
from hnn_vi_ros.hamiltonians import parse_urdf, RigidBodyTree
from hnn_vi_ros.scene import load_scene
from messages import assert_message, refused
import numpy as np
import pytest
from urdf_robots import chain, TREE, TREE_ARGUMENTS, with_quaternions

INERTIA = '<inertia ixx="0.2" ixy="0.01" ixz="-0.02" iyy="0.25" iyz="0.03" izz="0.1"/>'


def build(folder, text: str = TREE, **arguments) -> RigidBodyTree:
    path = folder / 'robot.urdf'
    path.write_bytes(text.encode())
    return RigidBodyTree(str(path), **TREE_ARGUMENTS | arguments)


# In place of the arguments of TREE, of a robot that has none of its joints.
PLAIN = dict.fromkeys(TREE_ARGUMENTS) | {'gravity': [0.0, 0.0, -9.81]}


def test_robot_is_read_with_what_effects_will_ask_for():
    robot = parse_urdf(TREE.encode(), 'robot.urdf')
    assert (robot.name, robot.root, len(robot.links)) == ('tree', 'ground', 9)
    assert [joint.name for joint in robot.links['trunk'].joints] == ['rail', 'tail']
    rail, _ = robot.links['trunk'].joints
    assert (rail.limits.lower, rail.limits.upper, rail.limits.velocity, rail.limits.effort,
            rail.damping, rail.friction) == (-0.5, 0.5, 1.0, 90.0, 2.5, 0.5)
    np.testing.assert_allclose(rail.axis, [0.6, 0.0, 0.8], rtol=1e-15)
    (hip,) = robot.links['base'].joints
    assert hip.limits.lower is None and hip.kind == 'continuous' and hip.mimic is None
    np.testing.assert_allclose(hip.rotation @ hip.rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(robot.links['trunk'].inertial.moments.trace(), 0.55, rtol=1e-15)


def test_rotation_is_about_fixed_axes_in_turn():
    robot = parse_urdf(b'<robot name="r"><link name="a"/><link name="b"/><joint name="j" '
                       b'type="fixed"><parent link="a"/><child link="b"/><origin rpy="'
                       b'1.5707963267948966 0 1.5707963267948966"/></joint></robot>', 'x')
    # y is turned to z by the first, x to y and z stays by the second.
    np.testing.assert_allclose(robot.links['a'].joints[0].rotation,
                               [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize('version', ['1.1', '1.2'])
def test_quaternions_turn_as_the_angles_that_they_stand_for(version):
    frames, turned = (parse_urdf(text.encode(), 'robot.urdf').links
                      for text in (TREE, with_quaternions(TREE, version)))
    assert turned.keys() == frames.keys()
    # Of rotations: some units of round-off.
    for name, link in frames.items():
        for own, other in zip(link.joints, turned[name].joints, strict=True):
            np.testing.assert_allclose(other.rotation, own.rotation, rtol=0, atol=2e-15)
        if link.inertial is not None:
            np.testing.assert_allclose(turned[name].inertial.moments, link.inertial.moments,
                                       rtol=0, atol=1e-15 * np.trace(link.inertial.moments))


LIMIT = 'lower="-0.5" upper="0.5" velocity="1" effort="90"'


def replaced(folder, old: str, new: str, attribute: str = '') -> None:
    """Compare what a part of TREE is answered with, or how many joints move."""
    assert old in TREE
    text = TREE.replace(old, new, 1) if old else TREE
    if attribute:
        text = text.replace('<robot ', f'<robot {attribute}', 1)
    try:
        assert_message(f'{build(folder, text).dimension} joints move')
    except ModelError as problem:
        assert_message(f'ModelError: {problem}')


@pytest.mark.parametrize('version, old, new', [
    ('2.0', '', ''), ('1', '', ''), ('1.3', '', ''), ('', '', ''), ('1.0', '', ''),
    ('1.1', '', ''), ('1.2', '', ''), ('1.0', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"'),
    (None, 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"'),
    ('1.1', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"'),
    ('1.1', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1e-200"'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'rpy="0 0 0" quat_xyzw="0 0 0 1"'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 0"'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 1"'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1 0"'),
    ('1.2', 'rpy="0.5 0.1 -0.3"', 'quat_xyzw="0 0 0 nan"'),
    ('1.2', LIMIT, f'{LIMIT} acceleration="2" deceleration="3" jerk="40"'),
    ('1.2', LIMIT, f'{LIMIT} jerk="-40"'), ('1.2', LIMIT, f'{LIMIT} acceleration="fast"'),
    ('1.2', LIMIT, 'lower="-0.5"'), ('1.2', LIMIT, 'effort="90"'), ('1.1', LIMIT, 'lower="-0.5"'),
    ('1.2', f'<limit {LIMIT}/>', '')])
def test_each_version_of_the_format_is_read_as_urdfdom_reads_it(tmp_path, version, old, new):
    replaced(tmp_path, old, new, '' if version is None else f'version="{version}" ')


@pytest.mark.parametrize('old, new', [
    ('rpy="0.3 0.5', 'ryp="0.3 0.5'), ('damping="2.5"', 'dampnig="2.5"'),
    ('rpy="0.5 0.1', 'Rpy="0.5 0.1'), ('ixz="-0.02"', 'ixz="-0.02" Ixx="1"'),
    ('value="3.5"', 'value="3.5" unit="g"'), ('xyz="1 2 -2"', 'xyz="1 2 -2" frame="world"'),
    ('effort="90"', 'efort="90"'), ('<child link="hand"/>', '<child link="hand" joint="x"/>'),
    ('type="continuous"', 'type="continuous" axis="0 0 1"'),
    ('<link name="base"/>', '<link name="base" mass="1"/>'), ('<robot ', '<robot verison="1.0" '),
    ('<mimic joint="finger"/>', '<mimic joint="finger" offest="1"/>'),
    ('<mimic joint="finger"/>', '<mimic/>'), ('<axis xyz="1 2 -2"/>', '<axis/>'),
    ('<axis xyz="1 2 -2"/>', '<axs xyz="1 2 -2"/>'),
    ('<axis xyz="1 2 -2"/>', '<Axis xyz="1 2 -2"/>'), ('<dynamics ', '<dynamic '),
    ('<mass value="3.5"/>', '<mas value="3.5"/>'),
    ('<link name="base"/>', '<link name="base"/><lnik name="more"/>'),
    ('<link name="base"/>', '<link name="base"><mass value="1"/></link>'),
    ('<link name="base"/>', '<link name="base"><joint name="x" type="fixed"/></link>'),
    ('<axis xyz="1 2 -2"/>', '<axis xyz="1 2 -2" rpy="0 0 0"/><drake:rotor_inertia value="1"/>'
     '<joint_properties damping="1"/><actuator name="a"/>'),
    ('<dynamics ', '<dynamics drake:b="1" spring_stiffness="0" mu_coulomb="0" '),
    ('<link name="base"/>', '<link name="base" type="x"><visual><orgin/></visual><contact/>'
     '<origin xyz="0 0 0"/><sensor><mas/></sensor></link><gazebo reference="base"><mass/></gazebo>'
     '<transmission><joint name="x"/></transmission><ros2_control><joint name="hip"><limit x="1"/>'
     '</joint></ros2_control><material/><mujoco/>'),
    ('<robot ', '<robot xmlns="http://www.ros.org" xmlns:drake="http://drake.mit.edu" ')])
def test_misspelt_name_of_what_has_physical_meaning_is_answered_with_the_nearest(
        tmp_path, old, new):
    replaced(tmp_path, old, new, 'xmlns:drake="http://drake.mit.edu" ' if (
        'drake:' in new and 'xmlns' not in new) else '')


@pytest.mark.parametrize('old, new', [
    ('<link name="base"', '<link drake_ignore="true" name="base"'),
    ('<joint name="hip"', '<joint drake_ignore="true" colour="blue" name="hip"'),
    ('<axis xyz="1 2 -2"', '<axis xyz="1 2 -2" gazebo_frame="hip"')])
def test_attributes_of_other_tools_are_skipped_and_told(old, new):
    assert old in TREE
    with pytest.warns(UserWarning, match='extensions of other tools, ignored'):
        robot = parse_urdf(TREE.replace(old, new).encode(), 'robot.urdf')
    assert [*robot.links] == [*parse_urdf(TREE.encode(), 'robot.urdf').links]


@pytest.mark.parametrize('old, new', [
    ('<link name="base"/>', '<link name="base"/><fixed_frame name="tcp"/><deformable/>'),
    ('<axis xyz="1 2 -2"/>', '<axis xyz="1 2 -2"/><axis xyz="1 0 0"/>'),
    ('<mass value="3.5"/>', '<mass value="3.5"/><origin xyz="9 9 9"/>'),
    (LIMIT, f'{LIMIT}/><limit lower="0" upper="1"')])
def test_elements_of_other_tools_and_repeated_ones_are_told(old, new):
    """Of repeated elements urdfdom and Bullet read the first."""
    robot = parse_urdf(TREE.encode(), 'robot.urdf')
    with pytest.warns(UserWarning, match='<fixed_frame> and 1 more.* ignored|2 times .* first'):
        other = parse_urdf(TREE.replace(old, new, 1).encode(), 'robot.urdf')
    assert other.numbers() == robot.numbers()
    for name, joint in robot.joints.items():
        np.testing.assert_array_equal(other.joints[name].axis, joint.axis)
        assert other.joints[name].limits == joint.limits


HIP, BASE = '<axis xyz="1 2 -2"/>', '<link name="base"/>'


@pytest.mark.parametrize('old, new', [
    (HIP, f'{HIP}<xacro:insert_block name="origin"/>'), (HIP, f'{HIP}<pose>0 0 1 0 0 0</pose>'),
    (BASE, f'<link name="base"><visual><inertial><mass value="1"/>{INERTIA}</inertial></visual>'
     '</link>'),
    ('<dynamics damping="2.5" friction="0.5"/>', '<dynamics><damping>2.5</damping></dynamics>'),
    (HIP, f'<origin>0 0 1</origin>{HIP}'), (HIP, f'{HIP}<joint_properties damping="1"/>'),
    ('<dynamics ', '<dynamics mu_viscous="2" mu_coulomb="1" '),
    ('<dynamics ', '<dynamics spring_stiffness="50" spring_reference="0.2" '),
    (BASE, f'{BASE}<gazebo reference="hip"><springStiffness>30</springStiffness></gazebo>'),
    (BASE, f'{BASE}<gazebo reference="base"><turnGravityOff>true</turnGravityOff></gazebo>'),
    (BASE, f'{BASE}<gazebo><plugin name="m" filename="x.so"><joint>hip</joint><mimicJoint>tail'
     '</mimicJoint></plugin></gazebo>'),
    (BASE, f'{BASE}<ros2_control name="s" type="system"><joint name="tail"><param name="mimic">hip'
     '</param></joint></ros2_control>'),
    (BASE, f'{BASE}<transmission name="t"><actuator name="m"><mechanicalReduction>100'
     '</mechanicalReduction></actuator><joint name="hip"/></transmission>'),
    (BASE, f'{BASE}<transmission name="t"><drake:rotor_inertia value="-1"/><joint name="hip"/>'
     '</transmission>'),
    # These mean nothing.
    (BASE, f'{BASE}<gazebo reference="hip"><springStiffness>0</springStiffness></gazebo>'
     '<transmission><actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator>'
     '</transmission>')])
def test_text_below_the_root_that_means_something_is_answered_in_one_line(tmp_path, old, new):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        replaced(tmp_path, old, new, 'xmlns:xacro="x" xmlns:drake="x" ')
    assert_message('; '.join(str(warning.message) for warning in caught) or 'no warning')


@pytest.mark.parametrize('given, expected', [({}, 160.0**2 * 3.46e-4), ({'j1': 0.5}, 0.5)])
@pytest.mark.parametrize('place', ['</robot>', '<axis xyz="0 1 0"/>'])
def test_rotor_inertia_of_drake_counts_times_the_ratio_squared(tmp_path, given, expected, place):
    rotor = '<drake:gear_ratio value="160"/><drake:rotor_inertia value="3.46e-4"/>'
    if place == '</robot>':
        rotor = ('<transmission name="t"><actuator name="m"><mechanicalReduction>160'
                 f'</mechanicalReduction>{rotor}</actuator><joint name="j1"/></transmission>')
    text = chain([1.0], [1.0])
    assert place in text
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        robot = build(tmp_path, text.replace(place, f'{rotor}{place}'), **{
            **PLAIN, 'rotor_inertia': given})
    assert robot.masses(np.zeros((1, 1))).item() == pytest.approx(1.0 + expected, rel=1e-15)


def test_axis_of_a_joint_that_does_not_move_may_lack_its_direction(tmp_path):
    for axis in ('<axis/>', '<axis xyz="0 0 0"/>'):
        text = TREE.replace('<parent link="hand"/>', f'<parent link="hand"/>{axis}', 1)
        assert text != TREE and build(tmp_path, text).dimension == 5


@pytest.mark.parametrize('old, new', [
    ('<robot name="tree">', '<robot>'), ('<robot name="tree">', '<sdf>'), ('</robot>', ''),
    (TREE, '<sdf/>'), (TREE, '<mujoco/>'), (TREE, '<robot/>'), (TREE, ''), (TREE, '\0'),
    (TREE, '<?xml version="1.0" encoding="utf-7"?><robot/>'),
    (TREE, '<?xml version="1.0" encoding="no-such"?><robot/>'), (TREE, '<a>' * 65),
    (TREE, '<robot>' + '<a/>' * 100_000), (TREE, ' ' * (8 << 20) + '<robot/>'),
    (TREE, '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;">]><robot name="&c;"/>'),
    (TREE, '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>'),
    ('  <link name="base"/>', '  <xacro:link name="base"/>'), ('<link name="base"/>', '<link/>'),
    ('<link name="base"/>', '<link name="hand"/>'), ('name="rail"', 'name="wrist"'),
    ('<child link="hand"/>', '<child link="hadn"/>'), ('<child link="hand"/>', ''),
    ('<child link="hand"/>', '<child link="hand"/><child link="tip"/>'),
    ('<parent link="slider"/><child link="hand"/>', '<parent link="slider"/><child link="tool"/>'),
    ('<link name="base"/>', '<link name="base"/><link name="loose"/>'),
    ('<parent link="base"/><child link="trunk"/>', '<parent link="hand"/><child link="trunk"/>'),
    ('<parent link="ground"/><child link="base"/>', '<parent link="hand"/><child link="base"/>'),
    ('type="continuous"', ''), ('type="continuous"', 'type="floating"'),
    ('xyz="1 2 -2"', 'xyz="0 0 0"'), ('xyz="1 2 -2"', 'xyz="1 2"'),
    ('xyz="1 2 -2"', 'xyz="1 2 nan"'), ('rpy="0.3 0.5 -0.7"', 'rpy="0.3 inf -0.7"'),
    ('rpy="0.3 0.5 -0.7"', 'rpy="0.3 1e13 -0.7"'), ('value="3.5"', 'value="3,5"'),
    ('value="3.5"', 'value="1_0"'), ('value="3.5"', 'value="٣"'), ('value="3.5"', 'value="-3.5"'),
    ('<mass value="3.5"/>', ''), (INERTIA, ''), (INERTIA, INERTIA.replace('izz="0.1"', '')),
    (INERTIA, INERTIA.replace('0.25', '-0.25')),
    (INERTIA, INERTIA.replace('izz="0.1"', 'izz="10"')),
    ('<mass value="3.5"/>', '<mass value="0"/>'),
    ('lower="-0.5" upper="0.5"', 'lower="0.5" upper="-0.5"'), ('damping="2.5"', 'damping="-2.5"'),
    ('effort="90"', 'effort="-90"'), ('effort="90"', 'effort="1e308"')])
def test_mistake_in_a_urdf_is_answered_with_file_line_and_remedy(tmp_path, old, new):
    replaced(tmp_path, old, new)


# No body has these; that of a tip, whose motion is that of its joints, is refused.
FLAT = '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/>'
LONG = FLAT.replace('izz="1e-5"', 'izz="9e-5"')


@pytest.mark.parametrize('old, new, arguments, expected', [
    # What rests, even of a mass that is none.
    ('iyz="0" izz="1"', 'iyz="0" izz="9"', {},
     "robot.urdf:2: link 'ground': principal moments of inertia 1, 1, 9 kg m2: .* is at rest"),
    ('<mass value="9"/>', '<mass value="-9"/>', {}, "'ground': mass = -9 kg .* is at rest"),
    # Held by locked, in a tool that is a body with it.
    (FLAT, LONG, {'locked': {'follower': 0.0, 'finger': 0.0}, 'joints': None},
     "'tip': principal .*(triangle inequality).* because the body that it is fixed to is"),
    # Fixed, and without mass.
    ('<link name="hand"/>',
     f'<link name="hand"><inertial><mass value="0"/>{FLAT}</inertial></link>', {},
     "'hand': principal .* without mass; give .* because the body that it is fixed to is valid"),
    # Behind a joint that is locked.
    (INERTIA, INERTIA.replace('0.1"', '9"'), {'locked': {
        'follower': 0.0, 'hip': 0.0, 'wrist': 0.0, 'finger': 0.0, 'tail': 0.0}, 'joints': ['rail'],
        'rotor_inertia': {}}, "'trunk': principal .* because it is at rest"),
    # Behind the base.
    ('<mass value="9"/>', '<mass value="-9"/>', {'base': 'base'}, None),
])
def test_link_that_no_body_could_be_is_told_where_it_does_not_matter(
        tmp_path, old, new, arguments, expected):
    assert old in TREE
    arguments = TREE_ARGUMENTS | arguments
    if arguments['joints'] is None:
        arguments['joints'] = ['wrist', 'tail', 'rail', 'hip']
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        robot = build(tmp_path, TREE.replace(old, new, 1), **arguments)
    told = [str(warning.message) for warning in caught]
    assert len(told) == (expected is not None) and not any('\n' in line for line in told)
    assert all(re.search(expected, line) for line in told)
    # What is told changes nothing: the body is as heavy as its links together.
    assert (np.linalg.eigvalsh(robot.masses(np.zeros((1, robot.dimension)))[0]) > 0.0).all()


@pytest.mark.parametrize('excess', [0.0018, 0.04])
def test_moments_that_miss_the_triangle_inequality_by_rounding_are_taken_and_told(
        tmp_path, excess):
    """As of Romeo (0.18 %), xArm 6 (0.7 %) and the MIT mini cheetah (4 %)."""
    def text(largest: float) -> str:
        return chain([1.0], [1.0]).replace(
            'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"',
            f'ixx="0.1" ixy="0" ixz="0" iyy="{largest!r}" iyz="0" izz="0.1"')
    with pytest.warns(UserWarning, match=f"'l1': .* others by {excess:.2g} of it, as after"):
        robot = build(tmp_path, text(0.2 / (1.0 - excess)), **PLAIN)
    # The moments of the file, about the joint.
    assert robot.masses(np.zeros((1, 1))).item() == pytest.approx(
        1.0 + 0.2 / (1.0 - excess), rel=1e-15)
    with refused(ModelError):
        build(tmp_path, text(0.2 / (1.0 - 0.06)), **PLAIN)


@pytest.mark.parametrize('masses, lengths, told', [
    ([1.0, 1e-9], [1.0, 1e-3], "joint 'j2': has next to no inertia beside .*condition 1e.15 of"),
    # In mm and g: 0.3 m, 2 kg, 0.01 kg m2.
    ([2e3, 2e3], [300.0, 300.0], "link 'l2': centre of mass of 300 m: .* in mm and g"),
    # Moments in kg mm2 with lengths in m.
    ([1.0, 1.0], [1.0, 1.0], "link 'l1': radius of gyration of 100 m"),
    ([1.0, 1e-3], [1.0, 0.1], None)])
def test_light_joints_and_lengths_in_mm_are_told(tmp_path, masses, lengths, told):
    text = chain(masses, lengths)
    if 'gyration' in (told or ''):
        text = text.replace('ixx="0" ixy="0" ixz="0" iyy="0"',
                            'ixx="5e3" ixy="0" ixz="0" iyy="5e3"', 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        build(tmp_path, text, **PLAIN)
    assert len(caught) == (told is not None)
    assert all(re.search(told, str(one.message)) for one in caught)


def test_slide_on_what_rests_turns_no_moments_of_inertia(tmp_path):
    text = chain([1.0], [1.0]).replace('continuous', 'prismatic').replace('ixx="0"', 'ixx="-5"')
    with pytest.warns(UserWarning, match="'l1': .* must not be negative; .* it does not rotate"):
        robot = build(tmp_path, text, **PLAIN)
    assert robot.masses(np.zeros((1, 1))).item() == 1.0
    with refused(ModelError):
        build(tmp_path, text.replace('value="1.0"', 'value="-1"'), **PLAIN)


def test_many_links_that_no_body_could_be_are_one_warning(tmp_path):
    links = ''.join(f'<link name="odd{i}"><inertial><mass value="1"/>{LONG}</inertial></link>'
                    f'<joint name="fixed{i}" type="fixed"><parent link="ground"/>'
                    f'<child link="odd{i}"/></joint>' for i in range(1000))
    with pytest.warns(UserWarning) as caught:
        build(tmp_path, TREE.replace('</robot>', f'{links}</robot>'))
    (told,) = (str(warning.message) for warning in caught)
    assert told.startswith(str(tmp_path)) and told.endswith(', odd20, ... (979 more)')


@pytest.mark.parametrize('arguments', [
    {'base': 'floor'}, {'joints': ['hip']},
    {'joints': ['hip', 'hip', 'rail', 'wrist', 'finger', 'tail']}, {'joints': ['hpi']},
    {'joints': ['follower']}, {'joints': ['grip']}, {'joints': ['follower'], 'locked': {}},
    {'locked': {'follower': 0.0, 'grip': 1.0}}, {'locked': {'follower': float('nan')}},
    {'joints': [], 'locked': dict.fromkeys(
        ['follower', 'hip', 'rail', 'wrist', 'finger', 'tail'], 0.0), 'rotor_inertia': {}},
    {'gravity': [0.0, 9.81]}, {'gravity': [0.0, 0.0, float('inf')]},
    {'rotor_inertia': {'hip': -1.0}}, {'rotor_inertia': {'follower': 1.0}}])
def test_argument_that_does_not_fit_the_robot_is_answered_with_the_valid_ones(tmp_path, arguments):
    with refused(ModelError, ValueError):
        build(tmp_path, **arguments)


MIMIC = '<mimic joint="finger"/>'


@pytest.mark.parametrize('old, new', [
    (MIMIC, '<mimic joint="fingr"/>'), (MIMIC, '<mimic joint="follower"/>'),
    (MIMIC, '<mimic joint="grip"/>'), (MIMIC, MIMIC * 2),
    (MIMIC, '<mimic joint="tail"/>'), (MIMIC, '<mimic joint="finger" multiplier="x"/>'),
    (MIMIC, '<mimic joint="finger" multiplier="1e13"/>'),
    (MIMIC, '<mimic joint="finger" offset="nan"/>'),
    ('<limit lower="0" upper="0.1"', f'{MIMIC.replace("finger", "follower")}'
     '<limit lower="0" upper="0.1"')])
def test_mistake_in_what_a_joint_follows_is_answered_with_file_line_and_remedy(
        tmp_path, old, new):
    assert old in TREE
    text = TREE.replace(old, new, 1)
    if new == '<mimic joint="tail"/>':
        # Which the base does not carry.
        text = text.replace('<parent link="trunk"/><child link="end"/>',
                            '<parent link="ground"/><child link="end"/>')
    with refused(ModelError):
        build(tmp_path, text, joints=None, locked={}, rotor_inertia={}, base='base')


@pytest.mark.parametrize('number', [15, 40])
def test_numbers_of_a_long_chain_of_followers_that_overflow_are_refused(tmp_path, number):
    text = chain([1.0] * number, [1.0] * number)
    for i in range(1, number):
        text = text.replace(f'<child link="l{i}"/>', f'<child link="l{i}"/><mimic joint='
                            f'"j{i + 1}" multiplier="1e12"/>', 1)
    with refused(ModelError):
        build(tmp_path, text, **PLAIN)


@pytest.mark.parametrize('finger, follower, mimic, expected, told', [
    # The same range, a wider one, one that narrows it, one that leaves no room, and none.
    ((0.0, 0.1), (-0.3, 0.1), 'multiplier="-4" offset="0.1"', (0.0, 0.1), ''),
    ((0.0, 0.1), (-9.0, 9.0), '', (0.0, 0.1), ''),
    ((0.0, 0.1), (0.0, 0.1), 'multiplier="2"', (0.0, 0.05),
     'finger moves from 0 to 0.05 because of follower'),
    ((0.0, 0.1), (0.0, 0.1), 'multiplier="-1"', (0.0, 0.1),
     'those of follower leave finger no room and are ignored'),
    ((0.0, 0.1), (2.0, 3.0), 'multiplier="0" offset="9"', (0.0, 0.1), '')])
def test_limits_of_a_follower_are_limits_of_its_leader(
        tmp_path, recwarn, finger, follower, mimic, expected, told):
    limits = '<limit lower="0" upper="0.1" velocity="1" effort="1"/>'
    text = TREE
    for name, (low, high) in {'finger': finger, 'follower': follower}.items():
        before, after = text.split(f'<joint name="{name}"')
        text = f'{before}<joint name="{name}"' + after.replace(limits, limits.replace(
            '"0"', f'"{low}"').replace('"0.1"', f'"{high}"'), 1)
    robot = build(tmp_path, text.replace(MIMIC, f'<mimic joint="finger" {mimic}/>'), locked={})
    assert robot.joints[4].bounds == pytest.approx(expected, abs=1e-15)
    warned = [str(warning.message) for warning in recwarn]
    assert warned == [f"{tmp_path}/robot.urdf:29: joint 'follower': limits of joints that mimic "
                      f'others: {told}'] * bool(told)


def test_continuous_leader_has_the_limits_and_the_friction_of_a_slide_that_follows(tmp_path):
    text = TREE.replace(MIMIC, '<mimic joint="hip" multiplier="-0.1" offset="0.05"/>'
                               '<dynamics damping="3" friction="7"/>')
    with pytest.warns(UserWarning, match='hip moves from -0.5 to 0.5 because of follower'):
        robot = build(tmp_path, text, locked={})
    hip = robot.joints[3]
    assert hip.bounds == pytest.approx((-0.5, 0.5)) and hip.units.q == 'rad'
    # [N s/m] times [m/rad]^2, and [N] times [m/rad].
    assert (hip.damping, hip.friction) == pytest.approx((0.03, 0.7))


def test_follower_of_a_locked_joint_is_locked(tmp_path):
    text = TREE.replace(MIMIC, '<mimic joint="tail" multiplier="0.1" offset="0.02"/>')
    joints, rotors = ['wrist', 'rail', 'hip', 'finger'], {'hip': 0.3}
    own = build(tmp_path, text, joints=joints, locked={'tail': 0.4}, rotor_inertia=rotors)
    both = build(tmp_path, text, joints=joints, rotor_inertia=rotors,
                 locked={'tail': 0.4, 'follower': 0.06})
    assert own.robot.locked == pytest.approx({'tail': 0.4, 'follower': 0.06})
    np.testing.assert_allclose(own.bodies.inertia, both.bodies.inertia, rtol=1e-15, atol=1e-18)
    assert own.following is None


def test_robot_without_joints_is_answered_by_what_it_lacks(tmp_path):
    with refused(ValueError):
        build(tmp_path, '<robot name="base"><link name="base"/></robot>', **PLAIN)


@pytest.mark.parametrize('mass, inertia, rotor, singular', [
    # A tip without mass; a point on the axis that it turns about; a rod along it.
    (0.0, 0.0, 0.0, True), (1.0, 0.0, 0.0, True), (1.0, 0.1, 0.0, False), (0.0, 0.0, 0.1, False)])
def test_joint_that_moves_no_inertia_is_named(tmp_path, mass, inertia, rotor, singular):
    text = chain([1.0, 1.0], [1.0, 1.0]).replace('</robot>', f"""
  <joint name="spin" type="continuous"><parent link="l2"/><child link="disc"/>
    <origin xyz="0 0 -1"/><axis xyz="1 0 0"/></joint>
  <link name="disc"><inertial><mass value="{mass}"/><inertia ixx="{inertia}" ixy="0" ixz="0"
    iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link></robot>""")
    arguments = PLAIN | {'rotor_inertia': {'spin': rotor}}
    if not singular:
        assert build(tmp_path, text, **arguments).dimension == 3
        return
    with refused(ModelError):
        build(tmp_path, text, **arguments)


def test_robot_moves_up_to_twelve_joints(tmp_path):
    assert build(tmp_path, chain([1.0] * 12, [0.5] * 12), **PLAIN).dimension == 12
    with refused(ValueError):
        build(tmp_path, chain([1.0] * 13, [0.5] * 13), **PLAIN)


def ladder(number: int, tail: str = '') -> str:
    """Return a robot of so many joints, each on the link that the one before carries."""
    return '\n'.join(['<robot name="ladder"><link name="link0"/>', *(
        f'<joint name="joint{i}" type="continuous"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/></joint><link name="link{i}"/>' for i in range(1, number + 1)),
        f'{tail}</robot>'])


ALL = [f'joint{i}' for i in range(1, 1900)]


@pytest.mark.parametrize('number, tail, arguments', [
    # Before any of its joints is looked at: the mistake in the last line is not found.
    (14_000, '<joint/>', {}), (1900, '', {}), (1900, '', {'joints': ALL}),
    (1900, '', {'joints': [*ALL, *ALL]}), (1900, '', {'joints': ['joint5']}),
    (1900, '', {'joints': ['none']}), (1900, '', {'base': 'none'}),
    (1900, '<link name="loose1"/>', {}),
    (50, ''.join(f'<link name="loose{i}"/>' for i in range(1800)), {}),
    (1900, '<joint name="j" type="fixed"><parent link="link7"/><child link="none"/></joint>', {}),
    (1900, f'<joint name="j" type="fixed"><parent link="link7"/><child link="{"x" * 10**6}"/>'
     '</joint>', {}),
    (1900, f'<joint name="j" type="{"x" * 10**6}"><parent link="link7"/><child link="end"/>'
     '</joint><link name="end"/>', {})], ids=range(12))
def test_robot_of_very_many_joints_is_refused_in_one_short_line(tmp_path, number, tail, arguments):
    with refused(ModelError, ValueError):
        build(tmp_path, ladder(number, tail), **PLAIN | arguments)


def test_robot_of_very_many_followers_is_refused_in_one_short_line(tmp_path):
    text = ladder(1900, '<joint name="lead" type="continuous"><parent link="link0"/>'
                        '<child link="end"/></joint><link name="end"/>')
    with refused(ValueError):
        build(tmp_path, text.replace(
            '<child link="link', '<mimic joint="lead"/><child link="link'), **PLAIN)


def test_joint_whose_name_cannot_name_a_coordinate_is_refused_unless_it_is_held(tmp_path):
    text = chain([1.0, 1.0], [1.0, 1.0]).replace('name="j2"', 'name="j 2.x"')
    with refused(ModelError):
        build(tmp_path, text, **PLAIN)
    assert build(tmp_path, text, **PLAIN | {'locked': {'j 2.x': 0.0}}).dimension == 1


SCENE = """\
hamiltonian:
  kind: urdf
  file: robot.urdf
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [1.0], p: [0]}
"""


@pytest.mark.parametrize('line', [
    'file: none.urdf', 'file: package://no_such_package/a.urdf', 'file: package://x', 'file: .',
    'file: robot.urdf\n  base: x', 'file: robot.urdf\n  locked: {x: 0}',
    'file: robot.urdf\n  gravity: [0]', 'file: robot.urdf\n  joints: j1',
    'file: robot.urdf\n  locked: {j1: .inf}', 'file: robot.urdf\n  joint: [j1]', 'file: bad.urdf'])
def test_mistake_in_a_scene_of_a_robot_is_answered_with_its_line(tmp_path, line):
    (tmp_path / 'robot.urdf').write_text(chain([1.0], [1.0]))
    (tmp_path / 'bad.urdf').write_text('<robot')
    path = tmp_path / 'mine.yaml'
    path.write_text(SCENE.replace('file: robot.urdf', line))
    with refused(HnnViRosError):
        load_scene(path).create_hamiltonian()


def test_robot_of_an_installed_package_is_found(tmp_path, monkeypatch):
    share = tmp_path / 'share'
    index = share / 'ament_index' / 'resource_index' / 'packages'
    for folder in (index, share / 'my_robot' / 'urdf'):
        folder.mkdir(parents=True)
    (index / 'my_robot').touch()
    (share / 'my_robot' / 'urdf' / 'arm.urdf').write_text(chain([1.0], [1.0]))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path / "other"}:{tmp_path}')
    path = tmp_path / 'mine.yaml'
    path.write_text(SCENE.replace('robot.urdf', 'package://my_robot/urdf/arm.urdf'))
    scene = load_scene(path)
    assert scene.create_hamiltonian().robot.name == 'chain'
    assert re.fullmatch('[0-9a-f]{64}', scene.model_digests['package://my_robot/urdf/arm.urdf'])
