# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""URDF files: what is read of them, and what each mistake is answered with."""

import re
import warnings

from hnn_vi_ros.errors import HnnViRosError, ModelError, SceneError
from hnn_vi_ros.hamiltonians.rigid_body.urdf import parse_urdf
from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
from hnn_vi_ros.scene import load_scene
import numpy as np
import pytest
from urdf_robots import chain, TREE, TREE_ARGUMENTS, with_quaternions

INERTIA = '<inertia ixx="0.2" ixy="0.01" ixz="-0.02" iyy="0.25" iyz="0.03" izz="0.1"/>'


def build(folder, text: str = TREE, **arguments) -> RigidBodyTree:
    path = folder / 'robot.urdf'
    path.write_bytes(text.encode())
    return RigidBodyTree(str(path), **TREE_ARGUMENTS | arguments)


def test_robot_is_read_with_what_effects_will_ask_for():
    robot = parse_urdf(TREE.encode(), 'robot.urdf')
    assert (robot.name, robot.root, len(robot.links)) == ('tree', 'ground', 9)
    assert [joint.name for joint in robot.links['trunk'].joints] == ['rail', 'tail']
    rail, _ = robot.links['trunk'].joints
    assert (rail.limits.lower, rail.limits.upper, rail.limits.velocity, rail.limits.effort,
            rail.damping, rail.friction) == (-0.5, 0.5, 1.0, 90.0, 2.5, 0.5)
    np.testing.assert_allclose(rail.axis, [0.6, 0.0, 0.8], rtol=1e-15)
    (hip,) = robot.links['base'].joints
    assert hip.limits.lower is None and hip.kind == 'continuous' and hip.mimics is None
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


def assert_read_or_refused(folder, text: str, expected: str | None) -> None:
    if expected is None:
        assert build(folder, text).dimension == 5
        return
    with pytest.raises(ModelError, match=expected) as caught:
        build(folder, text)
    assert '\n' not in str(caught.value) and 'robot.urdf:' in str(caught.value)


@pytest.mark.parametrize('version, old, new, expected', [
    ('2.0', '', '', r"robot.urdf:1: robot version='2.0' cannot be read; valid: 1.0, 1.1, 1.2"),
    ('1', '', '', "robot version='1' cannot be read"),
    ('1.3', '', '', "robot version='1.3' cannot be read"),
    ('', '', '', "robot version='' cannot be read"),
    ('1.0', '', '', None), ('1.1', '', '', None), ('1.2', '', '', None),
    ('1.0', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"',
     "robot.urdf:8: joint 'hip': origin: quat_xyzw is of version 1.1, and this file of 1.0"),
    (None, 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"', r'write <robot version="1.1">, or rpy'),
    ('1.1', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1"', None),
    ('1.1', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1e-200"', None),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'rpy="0 0 0" quat_xyzw="0 0 0 1"',
     "robot.urdf:7: joint 'hip': origin has rpy and quat_xyzw; leave one of them out"),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 0"', 'quat_xyzw = 0 0 0 0 is no rotation'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 1"', 'quat_xyzw has 3 numbers, expected 4'),
    ('1.2', 'rpy="0.3 0.5 -0.7"', 'quat_xyzw="0 0 0 1 0"', 'has more than 4 numbers, expected 4'),
    ('1.2', 'rpy="0.5 0.1 -0.3"', 'quat_xyzw="0 0 0 nan"', "link 'trunk': origin quat_xyzw = 'na"),
    # What is limited beside these acts on no robot here; version 1.2 asks for both or none.
    ('1.2', LIMIT, f'{LIMIT} acceleration="2" deceleration="3" jerk="40"', None),
    ('1.2', LIMIT, f'{LIMIT} jerk="-40"', "joint 'rail': limit jerk = -40 must not be negative"),
    ('1.2', LIMIT, f'{LIMIT} acceleration="fast"', "limit acceleration = 'fast' must be a finite"),
    ('1.2', LIMIT, 'lower="-0.5"', "joint 'rail': limit without upper; version 1.2 has both"),
    ('1.2', LIMIT, 'effort="90"', "joint 'rail': limit without lower; version 1.2 has both"),
    ('1.1', LIMIT, 'lower="-0.5"', None),
    ('1.2', f'<limit {LIMIT}/>', '', None)])
def test_each_version_of_the_format_is_read_as_urdfdom_reads_it(
        tmp_path, version, old, new, expected):
    assert old in TREE
    text = TREE.replace(old, new, 1) if old else TREE
    if version is not None:
        text = text.replace('<robot ', f'<robot version="{version}" ', 1)
    assert_read_or_refused(tmp_path, text, expected)


@pytest.mark.parametrize('old, new, expected', [
    ('rpy="0.3 0.5', 'ryp="0.3 0.5', "robot.urdf:8: joint 'hip': origin: unknown attribute 'ryp'; "
     r'did you mean rpy\?; valid: xyz, rpy, quat_xyzw'),
    ('damping="2.5"', 'dampnig="2.5"', "joint 'rail': dynamics: .*'dampnig'; did .* damping"),
    ('rpy="0.5 0.1', 'Rpy="0.5 0.1', "robot.urdf:9: link 'trunk': inertial: origin: .*'Rpy'"),
    ('ixz="-0.02"', 'ixz="-0.02" Ixx="1"', "urdf:10: link 'trunk': inertial: inertia: .*Ixx"),
    ('value="3.5"', 'value="3.5" unit="g"', "inertial: mass: unknown attribute 'unit'; valid: v"),
    ('xyz="1 2 -2"', 'xyz="1 2 -2" frame="world"', "axis: unknown attribute 'frame'; valid: xyz"),
    ('effort="90"', 'efort="90"', "joint 'rail': limit: .* 'efort'; did you mean effort"),
    ('<child link="hand"/>', '<child link="hand" joint="x"/>', "child: .* 'joint'; valid: link"),
    ('type="continuous"', 'type="continuous" axis="0 0 1"', "joint 'hip': .* 'axis'; valid: name"),
    ('<link name="base"/>', '<link name="base" mass="1"/>', "link 'base': .*'mass'; valid: name"),
    ('<robot ', '<robot verison="1.0" ', "robot.urdf:1: robot: .*'verison'; did you mean ver"),
    ('<mimic joint="finger"/>', '<mimic joint="finger" offest="1"/>', 'mimic: .* mean offset'),
    ('<mimic joint="finger"/>', '<mimic/>', "joint 'follower': mimic without joint; expected"),
    ('<axis xyz="1 2 -2"/>', '<axis/>', "joint 'hip': axis without xyz; expected <axis xyz="),
    ('<axis xyz="1 2 -2"/>', '<axs xyz="1 2 -2"/>',
     "robot.urdf:8: joint 'hip': <axs> means nothing there; did you mean axis"),
    ('<axis xyz="1 2 -2"/>', '<Axis xyz="1 2 -2"/>', '<Axis> means .* did you mean axis'),
    ('<dynamics ', '<dynamic ', 'did you mean dynamics'),
    ('<mass value="3.5"/>', '<mas value="3.5"/>', "link 'trunk': inertial: <mas> means nothing"),
    ('<link name="base"/>', '<link name="base"/><lnik name="more"/>', '<lnik> .* mean link'),
    ('<link name="base"/>', '<link name="base"><mass value="1"/></link>',
     "link 'base': <mass> means nothing there; valid: inertial"),
    ('<link name="base"/>', '<link name="base"><joint name="x" type="fixed"/></link>', '<joint>'),
    # Extensions are those of others, and so are attributes that published robots have.
    ('<axis xyz="1 2 -2"/>', '<axis xyz="1 2 -2" rpy="0 0 0"/><drake:rotor_inertia value="1"/>'
     '<joint_properties damping="1"/><actuator name="a"/>', None),
    ('<dynamics ', '<dynamics drake:b="1" spring_stiffness="0" mu_coulomb="0" ', None),
    ('<link name="base"/>', '<link name="base" type="x"><visual><orgin/></visual><contact/>'
     '<origin xyz="0 0 0"/><sensor><mas/></sensor></link><gazebo reference="base"><mass/></gazebo>'
     '<transmission><joint name="x"/></transmission><ros2_control><joint name="hip"><limit x="1"/>'
     '</joint></ros2_control><material/><mujoco/><loop_joint/>', None),
    ('<robot ', '<robot xmlns="http://www.ros.org" xmlns:drake="http://drake.mit.edu" ', None)])
def test_misspelt_name_of_what_has_physical_meaning_is_answered_with_the_nearest(
        tmp_path, old, new, expected):
    assert old in TREE
    text = TREE.replace(old, new, 1)
    if 'drake:' in new and 'xmlns' not in new:
        text = text.replace('<robot ', '<robot xmlns:drake="http://drake.mit.edu" ', 1)
    assert_read_or_refused(tmp_path, text, expected)


def test_axis_of_a_joint_that_does_not_move_may_lack_its_direction(tmp_path):
    for axis in ('<axis/>', '<axis xyz="0 0 0"/>'):
        text = TREE.replace('<parent link="hand"/>', f'<parent link="hand"/>{axis}', 1)
        assert text != TREE and build(tmp_path, text).dimension == 5


@pytest.mark.parametrize('old, new, expected', [
    ('<robot name="tree">', '<robot>', None),
    ('<robot name="tree">', '<sdf>', 'no XML: mismatched tag'),
    ('</robot>', '', 'no XML: no element found'),
    (TREE, '<sdf/>', r'robot.urdf:1: <sdf>, expected <robot>: no URDF'),
    (TREE, '<robot/>', 'a robot without links'),
    (TREE, '', 'no XML: no element found'),
    (TREE, '\0', 'no XML: '),
    (TREE, '<?xml version="1.0" encoding="utf-7"?><robot/>', 'robot.urdf:1: '),
    (TREE, '<?xml version="1.0" encoding="no-such"?><robot/>', 'robot.urdf:1: '),
    (TREE, '<a>' * 65, 'elements nested more than 64 deep'),
    (TREE, '<robot>' + '<a/>' * 100_000, 'more than 100000 elements'),
    (TREE, ' ' * (8 << 20) + '<robot/>', 'more than 8 MiB of XML'),
    (TREE, '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;">]><robot name="&c;"/>',
     'robot.urdf:1: a document type declaration'),
    (TREE, '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', 'a document type declaration'),
    ('  <link name="base"/>', '  <xacro:link name="base"/>', r'<xacro:link>: a xacro'),
    ('<link name="base"/>', '<link/>', r"robot.urdf:6: link name='' must be 1 to 200 printable"),
    ('<link name="base"/>', '<link name="hand"/>', "2 links are named 'hand'"),
    ('name="rail"', 'name="wrist"', "2 joints are named 'wrist'"),
    ('<child link="hand"/>', '<child link="hadn"/>',
     r"robot.urdf:17: joint 'wrist': no link 'hadn'; links: ground, base"),
    ('<child link="hand"/>', '', "joint 'wrist': no child; expected"),
    ('<child link="hand"/>', '<child link="hand"/><child link="tip"/>', '2 times <child>'),
    ('<parent link="slider"/><child link="hand"/>', '<parent link="slider"/><child link="tool"/>',
     "joint 'grip': link 'tool' hangs on joint 'wrist' already"),
    ('<link name="base"/>', '<link name="base"/><link name="loose"/>',
     'several links hang on nothing: ground, loose'),
    ('<parent link="base"/><child link="trunk"/>', '<parent link="hand"/><child link="trunk"/>',
     'several links|joints in a circle'),
    ('<parent link="ground"/><child link="base"/>', '<parent link="hand"/><child link="base"/>',
     'joints in a circle|several links'),
    ('type="continuous"', '', "joint 'hip': no type; valid: revolute"),
    ('type="continuous"', 'type="floating"',
     "joint 'hip': type 'floating' cannot be simulated; valid: revolute, .* base: trunk"),
    ('xyz="1 2 -2"', 'xyz="0 0 0"', "joint 'hip': axis xyz = 0 0 0 has no direction"),
    ('xyz="1 2 -2"', 'xyz="1 2"', 'axis xyz has 2 numbers, expected 3'),
    ('xyz="1 2 -2"', 'xyz="1 2 nan"', "axis xyz = 'nan' must be a finite number"),
    ('rpy="0.3 0.5 -0.7"', 'rpy="0.3 inf -0.7"', "origin rpy = 'inf' must be a finite number"),
    ('rpy="0.3 0.5 -0.7"', 'rpy="0.3 1e13 -0.7"', "'1e13' must be a finite number of at most"),
    ('value="3.5"', 'value="3,5"', "link 'trunk': mass value = '3,5' must be a finite number"),
    ('value="3.5"', 'value="1_0"', "mass value = '1_0' must be"),
    ('value="3.5"', 'value="٣"', 'mass value = .* must be'),
    ('value="3.5"', 'value="-3.5"', "link 'trunk': mass = -3.5 kg must not be negative"),
    ('<mass value="3.5"/>', '', "link 'trunk': inertial without mass"),
    (INERTIA, '', "link 'trunk': inertial without inertia"),
    (INERTIA, INERTIA.replace('izz="0.1"', ''), "link 'trunk': inertia without izz"),
    (INERTIA, INERTIA.replace('0.25', '-0.25'), 'moments of inertia .*: none may be negative'),
    (INERTIA, INERTIA.replace('izz="0.1"', 'izz="10"'), 'triangle inequality'),
    ('<mass value="3.5"/>', '<mass value="0"/>', 'kg m2 without mass'),
    ('lower="-0.5" upper="0.5"', 'lower="0.5" upper="-0.5"', 'limits 0.5 to -0.5 leave nothing'),
    ('damping="2.5"', 'damping="-2.5"', "joint 'rail': damping = -2.5 must not be negative"),
    ('effort="90"', 'effort="-90"', 'limit effort = -90 must not be negative'),
    ('effort="90"', 'effort="1e308"', None),
])
def test_mistake_in_a_urdf_is_answered_with_file_line_and_remedy(tmp_path, old, new, expected):
    assert old in TREE
    if expected is None:
        assert build(tmp_path, TREE.replace(old, new, 1)).dimension == 5
        return
    with pytest.raises(ModelError, match=expected) as caught:
        build(tmp_path, TREE.replace(old, new, 1))
    assert '\n' not in str(caught.value) and 'robot.urdf' in str(caught.value)


# No body has these; that of a tip, whose motion is that of its joints, is refused.
FLAT = '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/>'
LONG = FLAT.replace('izz="1e-5"', 'izz="9e-5"')


@pytest.mark.parametrize('old, new, arguments, expected', [
    # What rests, even of a mass that is none.
    ('iyz="0" izz="1"', 'iyz="0" izz="9"', {},
     "robot.urdf:2: link 'ground': principal moments of inertia 1, 1, 9 kg m2: .* since it rest"),
    ('<mass value="9"/>', '<mass value="-9"/>', {}, "'ground': mass = -9 kg .*, since it rests"),
    # Held by locked, in a tool that is a body with it.
    (FLAT, LONG, {'locked': {'follower': 0.0, 'finger': 0.0}, 'joints': None},
     "'tip': principal .*(triangle inequality).* since together with what it is fixed to it is p"),
    # Fixed, and without mass.
    ('<link name="hand"/>',
     f'<link name="hand"><inertial><mass value="0"/>{FLAT}</inertial></link>', {},
     "'hand': principal .* without mass; give .* since together with what it is fixed to"),
    # Behind a joint that is locked.
    (INERTIA, INERTIA.replace('0.1"', '9"'), {'locked': {
        'follower': 0.0, 'hip': 0.0, 'wrist': 0.0, 'finger': 0.0, 'tail': 0.0}, 'joints': ['rail'],
        'rotor_inertia': {}}, "'trunk': principal .* since it rests"),
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


def test_slide_on_what_rests_turns_no_moments_of_inertia(tmp_path):
    text = chain([1.0], [1.0]).replace('continuous', 'prismatic').replace('ixx="0"', 'ixx="-5"')
    arguments = dict.fromkeys(TREE_ARGUMENTS) | {'gravity': [0.0, 0.0, -9.81]}
    with pytest.warns(UserWarning, match="'l1': .* none may be negative; .* it does not turn"):
        robot = build(tmp_path, text, **arguments)
    assert robot.masses(np.zeros((1, 1))).item() == 1.0
    with pytest.raises(ModelError, match="'l1': mass = -1 kg must not be negative"):
        build(tmp_path, text.replace('value="1.0"', 'value="-1"'), **arguments)


def test_many_links_that_no_body_could_be_are_one_warning(tmp_path):
    links = ''.join(f'<link name="odd{i}"><inertial><mass value="1"/>{LONG}</inertial></link>'
                    f'<joint name="fixed{i}" type="fixed"><parent link="ground"/>'
                    f'<child link="odd{i}"/></joint>' for i in range(1000))
    with pytest.warns(UserWarning) as caught:
        build(tmp_path, TREE.replace('</robot>', f'{links}</robot>'))
    (told,) = (str(warning.message) for warning in caught)
    assert told.startswith(str(tmp_path)) and told.endswith(', odd20, ... (979 more)')


@pytest.mark.parametrize('arguments, expected', [
    ({'base': 'floor'}, "base = 'floor' is no link; links: ground, base"),
    ({'joints': ['hip']}, 'joints leaves out rail, wrist, finger, tail; .* locked: {rail: 0.0}'),
    ({'joints': ['hip', 'hip', 'rail', 'wrist', 'finger', 'tail']}, 'joints .* each joint once'),
    ({'joints': ['hpi']}, "joints names 'hpi': no such joint moves; moving joints: hip, rail"),
    ({'joints': ['follower']}, "joints names 'follower': it is locked"),
    ({'joints': ['grip']}, "joints names 'grip': no such joint moves"),
    ({'locked': {}}, r"joint 'follower': joints that mimic .*: follower \(of finger\); .* locked"),
    ({'locked': {'follower': 0.0, 'grip': 1.0}}, "locked names 'grip', which is no joint that"),
    ({'locked': {'follower': float('nan')}}, 'locked at follower = nan must be a finite number'),
    ({'joints': [], 'locked': dict.fromkeys(
        ['follower', 'hip', 'rail', 'wrist', 'finger', 'tail'], 0.0), 'rotor_inertia': {}},
     'joints has none that moves'),
    ({'gravity': [0.0, 9.81]}, 'gravity = .* must be three numbers'),
    ({'gravity': [0.0, 0.0, float('inf')]}, 'gravity = .* must be three numbers'),
    ({'rotor_inertia': {'hip': -1.0}}, 'rotor_inertia of hip = -1.0 must be a number from 0'),
    ({'rotor_inertia': {'follower': 1.0}}, "rotor_inertia names 'follower', which is no joint"),
])
def test_argument_that_does_not_fit_the_robot_is_answered_with_the_valid_ones(
        tmp_path, arguments, expected):
    with pytest.raises((ModelError, ValueError), match=expected) as caught:
        build(tmp_path, **arguments)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('mass, inertia, rotor, singular', [
    # A tip without mass; a point on the axis that it turns about; a rod along it.
    (0.0, 0.0, 0.0, True), (1.0, 0.0, 0.0, True), (1.0, 0.1, 0.0, False), (0.0, 0.0, 0.1, False)])
def test_joint_that_moves_no_inertia_is_named(tmp_path, mass, inertia, rotor, singular):
    text = chain([1.0, 1.0], [1.0, 1.0]).replace('</robot>', f"""
  <joint name="spin" type="continuous"><parent link="l2"/><child link="disc"/>
    <origin xyz="0 0 -1"/><axis xyz="1 0 0"/></joint>
  <link name="disc"><inertial><mass value="{mass}"/><inertia ixx="{inertia}" ixy="0" ixz="0"
    iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link></robot>""")
    arguments = {**dict.fromkeys(TREE_ARGUMENTS), 'gravity': [0.0, 0.0, -9.81],
                 'rotor_inertia': {'spin': rotor}}
    if not singular:
        assert build(tmp_path, text, **arguments).dimension == 3
        return
    with pytest.raises(ModelError, match=r"robot.urdf:2: joint 'spin': spin can move without "
                                         "moving any mass .* link 'disc'"):
        build(tmp_path, text, **arguments)


@pytest.mark.parametrize('number, refused', [(12, False), (13, True)])
def test_robot_moves_up_to_twelve_joints(tmp_path, number, refused):
    text, arguments = chain([1.0] * number, [0.5] * number), dict.fromkeys(TREE_ARGUMENTS)
    arguments['gravity'] = [0.0, 0.0, -9.81]
    if refused:
        with pytest.raises(ValueError, match='joints: 13 move, at most 12 can; .*: j1, j2'):
            build(tmp_path, text, **arguments)
    else:
        assert build(tmp_path, text, **arguments).dimension == 12


def ladder(number: int, tail: str = '') -> str:
    """Return a robot of so many joints, each on the link that the one before carries."""
    return '\n'.join(['<robot name="ladder"><link name="link0"/>', *(
        f'<joint name="joint{i}" type="continuous"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/></joint><link name="link{i}"/>' for i in range(1, number + 1)),
        f'{tail}</robot>'])


ALL = [f'joint{i}' for i in range(1, 1900)]


@pytest.mark.parametrize('number, tail, arguments, expected', [
    # Before any of its joints is looked at: the mistake in the last line is not found.
    (14_000, '<joint/>', {}, 'robot.urdf: 14001 links and 14001 joints, at most 2000 of each'),
    (1900, '', {}, r'joints: 1900 move, at most 12 can; .* joint20, \.\.\. \(1880 more\)'),
    (1900, '', {'joints': ALL}, r'joints leaves out joint1900; name them too'),
    (1900, '', {'joints': [*ALL, *ALL]}, r'joints = \[joint1, .*must name each joint once'),
    (1900, '', {'joints': ['joint5']}, r'leaves out joint1, .* \(1879 more\); name them too'),
    (1900, '', {'joints': ['none']}, r'no such joint moves; moving joints: .* \(1880 more\)'),
    (1900, '', {'base': 'none'}, r'is no link; links: link0, .* \(1881 more\)'),
    (1900, '<link name="loose1"/>', {}, 'several links hang on nothing: link0, loose1'),
    (50, ''.join(f'<link name="loose{i}"/>' for i in range(1800)), {},
     r'several links hang on nothing: link0, .* \(1781 more\)'),
    (1900, '<joint name="j" type="fixed"><parent link="link7"/><child link="none"/></joint>', {},
     r"joint 'j': no link 'none'; links: link0, .* \(1881 more\)"),
    (1900, f'<joint name="j" type="fixed"><parent link="link7"/><child link="{"x" * 10**6}"/>'
     '</joint>', {}, "joint 'j': no link 'xxx.* more"),
    (1900, f'<joint name="j" type="{"x" * 10**6}"><parent link="link7"/><child link="end"/>'
     '</joint><link name="end"/>', {}, "joint 'j': type 'xxx.* cannot be simulated")])
def test_robot_of_very_many_joints_is_refused_in_one_short_line(
        tmp_path, number, tail, arguments, expected):
    arguments = dict.fromkeys(TREE_ARGUMENTS) | {'gravity': [0.0, 0.0, -9.81]} | arguments
    with pytest.raises((ModelError, ValueError), match=expected) as caught:
        build(tmp_path, ladder(number, tail), **arguments)
    assert len(str(caught.value)) < 2100 and '\n' not in str(caught.value)


def test_joint_whose_name_cannot_name_a_coordinate_is_refused_unless_it_is_held(tmp_path):
    text = chain([1.0, 1.0], [1.0, 1.0]).replace('name="j2"', 'name="j 2/x"')
    arguments = dict.fromkeys(TREE_ARGUMENTS) | {'gravity': [0.0, 0.0, -9.81]}
    with pytest.raises(ModelError, match="joint 'j 2/x': the name of a coordinate must be"):
        build(tmp_path, text, **arguments)
    assert build(tmp_path, text, **arguments | {'locked': {'j 2/x': 0.0}}).dimension == 1


SCENE = """\
hamiltonian:
  kind: urdf
  file: robot.urdf
integrator: {kind: generalized_leapfrog}
step_size: 0.01
initial_state: {q: [1.0], p: [0]}
"""


@pytest.mark.parametrize('line, expected', [
    ('file: none.urdf', r"mine.yaml:3: hamiltonian.file: no file '.*none.urdf'; give a path"),
    ('file: package://no_such_package/a.urdf',
     r"mine.yaml:3: hamiltonian.file: package://.*: no package 'no_such_package' is in what"),
    ('file: package://x', r'mine.yaml:3: hamiltonian.file: .* must be package://PACKAGE/PATH'),
    ('file: .', r"mine.yaml:3: hamiltonian.file: '.*' is a folder; give a path"),
    ('file: robot.urdf\n  base: x', r"mine.yaml:4: hamiltonian.base: urdf: base = 'x' is no link"),
    ('file: robot.urdf\n  locked: {x: 0}', 'mine.yaml:4: hamiltonian.locked: urdf: locked names'),
    ('file: robot.urdf\n  gravity: [0]', 'mine.yaml:4: hamiltonian.gravity: urdf: gravity = '),
    ('file: robot.urdf\n  joints: j1', 'mine.yaml:4: hamiltonian.joints: .*list'),
    ('file: robot.urdf\n  locked: {j1: .inf}', 'mine.yaml:4: hamiltonian.locked.j1: .*finite'),
    ('file: robot.urdf\n  joint: [j1]',
     r'mine.yaml:4: hamiltonian.joint: unknown key; did you mean joints\?; valid keys'),
    ('file: bad.urdf', 'mine.yaml:1: hamiltonian: urdf: .*bad.urdf:1: no XML'),
])
def test_mistake_in_a_scene_of_a_robot_is_answered_with_its_line(tmp_path, line, expected):
    (tmp_path / 'robot.urdf').write_text(chain([1.0], [1.0]))
    (tmp_path / 'bad.urdf').write_text('<robot')
    path = tmp_path / 'mine.yaml'
    path.write_text(SCENE.replace('file: robot.urdf', line))
    with pytest.raises(HnnViRosError, match=expected) as caught:
        load_scene(path).create_hamiltonian()
    assert isinstance(caught.value, (SceneError, ModelError)) and '\n' not in str(caught.value)


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
