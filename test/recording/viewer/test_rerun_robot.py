# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot of a URDF in a rerun recording: its shapes, and joints that move as simulated."""

import os
from pathlib import Path

from hnn_vi_ros.hamiltonians import bones, parse_urdf, RigidBodyTree, skeleton
from hnn_vi_ros.recording import box_of, RerunSink, Sample
from hnn_vi_ros.recording.viewer.rerun_entities import (
    bounds_of_path, bounds_of_robot, collisions_of)
import numpy as np
import pytest
from rerun.chunk import RrdReader
from rerun_reader import assert_verified, read, still_entities
from scipy.spatial.transform import Rotation
from urdf_robots import chain, ROOT, TREE, TREE_ARGUMENTS, with_quaternions

ARM = ROOT / 'config' / 'robots' / 'two_joint_arm.urdf'


def robot_of(folder: Path, text: str, **arguments: object) -> RigidBodyTree:
    """Return the robot of the text of a URDF, which is a file of a folder."""
    (folder / 'robot.urdf').write_text(text)
    return RigidBodyTree(str(folder / 'robot.urdf'), **arguments)


def assert_turned(rows: dict[str, list], expected: np.ndarray) -> None:
    """Compare quaternions, whose signs do not count, and which are stored as float32."""
    turns = np.array(rows['Transform3D:quaternion']).reshape(-1, 4)
    assert np.abs((turns * expected).sum(axis=1)) == pytest.approx(
        np.ones(len(expected)), abs=1e-6)


def record(path: Path, robot: RigidBodyTree, q: np.ndarray, efforts: np.ndarray | None = None
           ) -> dict[str, dict[str, list]]:
    """Return what has a time in a recording of so many samples."""
    sink = RerunSink('arm', path, robot, q[0], np.zeros(q.shape[1]), interval=0,
                     box=box_of(q, np.zeros(q.shape)))
    for n, row in enumerate(q):
        rest = np.zeros(len(row))
        sink.write(Sample(n, n * 1000, row, rest, rest, rest, 1.0, np.nan, 0.0,
                          motors=None if efforts is None else efforts[n]))
    sink.close()
    return read(path)


def test_robot_is_drawn_and_its_joints_move_as_simulated(tmp_path: Path):
    path = tmp_path / 'arm.rrd'
    # Beyond the limits of the elbow too, which act only where a scene says so.
    q = np.array([[0.0, 0.0], [0.3, -1.0], [-2.0, 3.0]])
    robot = RigidBodyTree(str(ARM))
    found = record(path, robot, q)
    for column, (name, origin) in enumerate({
            'shoulder': [0.0, 0.08, 0.0], 'elbow': [0.0, 0.045, -0.4]}.items()):
        rows = found[f'/joints/{name}']
        assert rows['step'] == [0, 1, 2]
        half = 0.5 * q[:, column]
        assert_turned(rows, np.stack(
            [0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1))
        assert np.array(rows['Transform3D:translation']).reshape(3, 3) == pytest.approx(
            np.tile(origin, (3, 1)), abs=1e-7)
    still = still_entities(path)
    assert any(entity.startswith('/world/two_joint_arm') and 'forearm' in entity
               for entity in still)
    hidden = f'{collisions_of(robot.robot)}/'
    assert any(entity.startswith(hidden) and 'forearm' in entity for entity in still)
    assert_verified(path)


@pytest.mark.parametrize('drives', [{}, {'elbow': {'stiffness': 30.0, 'rotor_inertia': 0.1}}])
def test_efforts_of_motors_are_arrows_along_the_axes_up_to_the_limit(tmp_path: Path, drives):
    path, robot = tmp_path / 'arm.rrd', RigidBodyTree(str(ARM), drives=drives)
    limits = np.array([joint.limits.effort for joint in robot.joints])
    efforts = np.zeros((2, robot.dimension))
    # The last column is that of the elbow, or of its rotor.
    efforts[:, [0, -1]] = np.array([[0.0, -0.5], [1.0, 3.0]]) * limits
    found = record(path, robot, np.zeros_like(efforts), efforts)
    longest = 0.4 * np.linalg.norm(bounds_of_robot(robot.robot)[1])
    for column, (joint, shares) in enumerate(zip(
            robot.joints, ([0.0, 1.0], [-0.5, 1.0]), strict=True)):
        arrows = found[f'/world/efforts/{joint.name}']
        # Stored as float32.
        assert np.array(arrows['Arrows3D:vectors']).reshape(2, 3) == pytest.approx(
            longest * np.outer(shares, robot.joints[column].axis), abs=1e-6)
        # Red from blue: of the same colour only where they are of the same size.
        colors = np.array(arrows['Arrows3D:colors']).ravel()
        assert len(set(colors.tolist())) == 2
    # Without motors there are none.
    assert not any('efforts' in name for name in
                   record(tmp_path / 'free.rrd', robot, np.zeros_like(efforts)))


def test_joints_that_are_held_are_drawn_where_they_are(tmp_path: Path):
    found = record(tmp_path / 'tree.rrd', robot_of(tmp_path, TREE, **TREE_ARGUMENTS),
                   np.zeros((2, 5)))
    assert {name for name in found if name.startswith('/joints/')} == {
        f'/joints/{name}' for name in (*TREE_ARGUMENTS['joints'], 'follower')}
    # It slides along -y, by 0.03 m.
    assert np.array(found['/joints/follower']['Transform3D:translation']).reshape(2, 3) == \
        pytest.approx(np.array([[0.0, -0.03, 0.0]] * 2), abs=1e-7)


def test_joints_that_follow_others_move_with_them(tmp_path: Path):
    robot = RigidBodyTree(str(ROOT / 'config' / 'robots' / 'gripper.urdf'))
    angles = np.array([0.1, 0.7])
    found = record(tmp_path / 'gripper.rrd', robot, angles[:, None])
    for name, sign in (('finger_left', 1), ('finger_right', -1), ('tip_left', -1),
                       ('tip_right', 1)):
        half = 0.5 * sign * angles
        assert_turned(found[f'/joints/{name}'], np.stack(
            [np.sin(half), 0.0 * half, 0.0 * half, np.cos(half)], axis=1))
    # The tips stay upright: their ends are 0.02 m beside the ends of the fingers, and 0.04 below.
    ends = bones(robot.robot, ['finger_left'], angles[:, None])['end of left_tip'][:, 1]
    np.testing.assert_allclose(ends, np.stack([
        0.0 * angles, 0.01 + 0.08 * np.sin(angles), -0.04 - 0.08 * np.cos(angles)], axis=1),
        atol=1e-15)


def test_joints_move_about_and_along_axes_of_any_length(tmp_path: Path):
    text, q = TREE.replace('xyz="0 1 0"', 'xyz="0 5 0"'), np.array([[0.05] * 5, [2.0] * 5])
    found = record(tmp_path / 'tree.rrd', robot_of(tmp_path, text, **TREE_ARGUMENTS), q)
    # About (1, 2, -2) / 3.
    frame = Rotation.from_euler('xyz', [0.3, 0.5, -0.7])
    expected = frame * Rotation.from_rotvec(np.outer([0.05, 2.0], [1.0, 2.0, -2.0]) / 3.0)
    assert_turned(found['/joints/hip'], expected.as_quat())
    places = np.array(found['/joints/finger']['Transform3D:translation']).reshape(2, 3)
    assert places == pytest.approx(np.array([[0.0, 0.05, 0.0], [0.0, 2.0, 0.0]]), abs=1e-6)


def test_robot_of_version_1_2_is_drawn_as_the_same_one_of_version_1_0(tmp_path: Path):
    capsule = ('<link name="base"><visual><geometry><capsule radius="0.1" length="0.5"/>'
               '</geometry></visual></link>')
    found = []
    for name, text in (('old', TREE), ('new', with_quaternions(TREE).replace(
            '<link name="base"/>', capsule))):
        robot = robot_of(tmp_path, text, **TREE_ARGUMENTS)
        found.append(record(tmp_path / f'{name}.rrd', robot, np.full((2, 5), 0.05)))
    for name in (*TREE_ARGUMENTS['joints'], 'follower'):
        old, new = (one[f'/joints/{name}'] for one in found)
        assert_turned(old, np.array(new['Transform3D:quaternion']).reshape(2, 4))
    assert 'TextLog:text' not in found[1].get('/events', {})


@pytest.mark.parametrize('visual, said', [
    ('', 'there is no <visual>'),
    ('<visual><geometry><mesh filename="package://nowhere/arm.dae"/></geometry></visual>',
     '2 of 2 meshes cannot be shown, as package://nowhere/arm.dae: package://nowhere/arm.dae: the '
     "package 'nowhere'"),
    ('<visual><geometry><mesh filename="gone.stl"/></geometry></visual>',
     '2 of 2 meshes cannot be shown, as gone.stl: no such file')])
def test_robot_without_its_meshes_is_drawn_as_its_skeleton(visual, said, tmp_path: Path):
    text = chain([1.0, 1.0], [0.7, 0.5]).replace('<inertial>', f'{visual}<inertial>')
    with pytest.warns(UserWarning, match=f'{said}.*; a skeleton is shown'):
        found = record(tmp_path / 'arm.rrd', robot_of(tmp_path, text), np.zeros((2, 2)))
    assert said in found['/events']['TextLog:text'][0][0]
    still = still_entities(tmp_path / 'arm.rrd')
    assert {f'/world/skeleton/{link}' for link in ('l1', 'l2')} <= still


TRIANGLE = """\
solid one
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid one
"""


@pytest.mark.parametrize('name', ['arm.stl', 'file://{folder}/arm.stl', 'meshes/&#97;rm.stl'])
def test_meshes_in_the_folder_of_the_urdf_are_recorded(name, tmp_path: Path):
    (tmp_path / 'meshes').mkdir()
    for folder in (tmp_path, tmp_path / 'meshes'):
        (folder / 'arm.stl').write_text(TRIANGLE)
    assert recorded_meshes(tmp_path, name.format(folder=tmp_path)) == [TRIANGLE.encode()]


@pytest.mark.parametrize('kind, said', [
    ('other', 'not in the folder of the URDF, nor in its package'),
    ('link', 'not in the folder of the URDF, nor in its package'),
    ('link in a package', 'not in the folder of the URDF, nor in its package'),
    ('link to a folder', 'not in the folder of the URDF, nor in its package'),
    ('link to a description', 'not in the folder of the URDF, nor in its package'),
    ('fifo', 'is not a regular file'), ('device', 'not in the folder'),
    ('large', '300 MB, limit 256 MB')])
def test_files_that_are_no_meshes_of_the_robot_are_not_opened(kind, said, tmp_path: Path):
    """A file elsewhere may be a secret; a FIFO, a device or a huge file would not end."""
    folder = tmp_path / 'robot'
    folder.mkdir()
    (tmp_path / 'secret.stl').write_text(TRIANGLE)
    name = {'other': '../secret.stl', 'device': 'file:///dev/zero'}.get(kind, 'arm.stl')
    if kind == 'fifo':
        os.mkfifo(folder / 'arm.stl')
    elif kind == 'link to a folder':
        (folder / 'package.xml').write_text('<package/>')
        (folder / 'meshes').symlink_to(tmp_path)
        name = 'meshes/secret.stl'
    elif kind.startswith('link'):
        (folder / 'arm.stl').symlink_to(tmp_path / 'secret.stl')
        if kind == 'link in a package':
            (folder / 'package.xml').write_text('<package/>')
        elif kind == 'link to a description':
            (folder / 'package.xml').symlink_to(tmp_path / 'secret.stl')
    elif kind == 'large':
        with (folder / 'arm.stl').open('wb') as stream:
            stream.truncate(300_000_000)
    with pytest.warns(UserWarning, match=said):
        assert recorded_meshes(folder, name) == []


def test_meshes_of_the_package_that_holds_the_urdf_are_recorded(tmp_path: Path):
    (tmp_path / 'package.xml').write_text('<package/>')
    for folder in ('urdf', 'meshes'):
        (tmp_path / folder).mkdir()
    (tmp_path / 'meshes' / 'arm.stl').write_text(TRIANGLE)
    assert recorded_meshes(tmp_path / 'urdf', '../meshes/arm.stl') == [TRIANGLE.encode()]


def test_meshes_of_a_package_installed_by_links_are_recorded(tmp_path: Path, monkeypatch):
    source, share = tmp_path / 'src' / 'arm_description', tmp_path / 'share' / 'arm_description'
    index = tmp_path / 'share/ament_index/resource_index/packages'
    for folder in (source / 'meshes', share / 'meshes', index):
        folder.mkdir(parents=True)
    (index / 'arm_description').write_text('')
    for name, text in (('package.xml', '<package/>'), ('meshes/arm.stl', TRIANGLE)):
        (source / name).write_text(text)
        (share / name).symlink_to(source / name)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    (tmp_path / 'elsewhere').mkdir()
    assert recorded_meshes(tmp_path / 'elsewhere', 'package://arm_description/meshes/arm.stl') \
        == [TRIANGLE.encode()]


def recorded_meshes(folder: Path, name: str) -> list[bytes]:
    """Return the files that a recording holds of a robot with a mesh of that name."""
    visual = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    text = chain([1.0], [0.7]).replace('<inertial>', f'{visual}<inertial>')
    record(folder / 'robot.rrd', robot_of(folder, text), np.zeros((2, 1)))
    batches = [chunk.to_record_batch() for chunk in RrdReader(folder / 'robot.rrd').stream()]
    return [bytes(blob) for batch in batches if 'Asset3D:blob' in batch.schema.names
            for row in batch.column('Asset3D:blob').to_pylist() for blob in row]


def test_bones_lead_from_joint_to_joint():
    robot = parse_urdf(chain([1.0, 1.0], [0.7, 0.5]).encode(), 'chain')
    q = np.array([[0.0, 0.0], [np.pi, 0.0]])
    parts = skeleton(robot, ['j1', 'j2'])(q, 1.0)
    lower = parts['j2']
    assert lower.points.shape == (2, 2, 3) and lower.moves
    # It hangs, and stands after half a turn.
    assert lower.points[:, 1] == pytest.approx(
        np.array([[0.0, 0.0, -0.7], [0.0, 0.0, 0.7]]), abs=1e-12)
    assert parts['j2 joint'].center == pytest.approx(lower.points[:, 1])


def test_robot_that_rerun_cannot_read_is_told_and_the_rest_is_shown(tmp_path: Path):
    # Shapes are not looked at here.
    robot = robot_of(tmp_path, ARM.read_text().replace(
        '<geometry>', '<geometry><box size="no"/>', 1))
    # It is shown as it was read.
    (tmp_path / 'robot.urdf').unlink()
    found = record(tmp_path / 'arm.rrd', robot, np.zeros((2, 2)))
    (text,), (level,) = (found['/events'][f'TextLog:{name}'][0] for name in ('text', 'level'))
    assert level == 'WARN' and 'rerun cannot show this robot' in text
    assert len(found['/state/q']['step']) == 2


def test_bounds_of_a_robot_hold_all_of_it():
    low, high = bounds_of_robot(parse_urdf(chain([1.0, 1.0], [0.7, 0.5]).encode(), 'chain'))
    # Its links weigh at their ends, and may go on as far beyond.
    assert (high == -low).all() and 1.2 <= np.linalg.norm(high) <= 2.4


def test_bounds_of_a_path_hold_where_the_links_were():
    robot = RigidBodyTree(str(ARM))
    names = [joint.name for joint in robot.joints]
    down, up, both = (bounds_of_path(bones(robot.robot, names, np.array(path))) for path in (
        [[0.0, 0.0]], [[np.pi, 0.0]], [[0.0, 0.0], [np.pi, 0.0]]))
    # The elbow is 0.4 m below the shoulder, and above it after half a turn about y.
    assert down[0, 2] < -0.4 and up[1, 2] > 0.4
    assert (both[0] <= np.minimum(down[0], up[0])).all()
    assert (both[1] >= np.maximum(down[1], up[1])).all()
    # Nearer than the sphere that holds every path.
    assert np.ptp(both, axis=0).prod() < 0.5 * (2.0 * np.linalg.norm(
        bounds_of_robot(robot.robot)[1])) ** 3
