# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot in the rerun viewer, as the SDK reads its URDF, with joints that move."""

from collections.abc import Sequence
from typing import final

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.hamiltonians.rigid_body.robot import Joint, Robot, SLIDING
import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree
from scipy.spatial.transform import Rotation

# The entity whose frame holds the root of the robot, and the entities that move its joints.
_WORLD, _JOINTS, _ROOT = '/world', '/joints', '/joints/root'
# Below the world, which the view of the mechanism shows.
_EFFORTS = '/world/efforts'
# An arrow at the limit of the effort is this share of the reach long; its colours (red, green,
# blue) at no effort and at the limit.
_ARROW, _IDLE, _FULL = 0.4, np.array([60.0, 200.0, 255.0]), np.array([235.0, 20.0, 60.0])
_GRAVITY = 9.81


@final
class RobotPicture:
    """
    A robot in a recording.

    Parameters
    ----------
    robot : Robot
        Read from a file, from which its shapes and meshes are read too.
    coordinates : sequence of str
        The joints that move, in the order of q; the others are held.
    recording : rerun.RecordingStream
        What takes the data.

    Raises
    ------
    RecordingError
        The SDK cannot read the file.

    """

    def __init__(self, robot: Robot, coordinates: Sequence[str], recording: rr.RecordingStream):
        self._recording = recording
        try:
            tree = UrdfTree.from_file_path(robot.where, entity_path_prefix=_WORLD[1:])
            tree.log_urdf_to_recording(recording)
        except (OSError, RuntimeError, ValueError) as problem:
            raise RecordingError(f'{robot.where}: rerun cannot show this robot: '
                                 f'{one_line(problem)}') from problem
        recording.log(_ROOT, rr.Transform3D(
            translation=[0.0, 0.0, 0.0], parent_frame=f'tf#{_WORLD}',
            child_frame=tree.root_link().name), static=True)
        own = {joint.name: joint for link in robot.links.values() for joint in link.joints}
        # Its path, and which coordinate it is, or where it is held.
        self._joints = [
            (own[name], f'{_JOINTS}/{rr.escape_entity_path_part(name)}',
             list(coordinates).index(name) if name in coordinates else None,
             robot.locked.get(name, 0.0))
            for name in {**dict.fromkeys(coordinates), **robot.locked} if name in own]
        self._moving = [own[name] for name in coordinates if name in own]
        self._reach, self._usual = _reach_of(robot), _usual_effort(robot)

    def send(self, times: list[rr.TimeColumn], q: np.ndarray, efforts: np.ndarray | None = None
             ) -> None:
        """
        Move the joints to q at n times.

        Parameters
        ----------
        times : list of rerun.TimeColumn
            Of n samples.
        q : np.ndarray, shape (n, d)
            Coordinates [rad], [m].
        efforts : np.ndarray, shape (n, d), optional
            Efforts of motors [N m], [N]: an arrow along each joint's axis, by the right-hand
            rule, longer and redder the nearer the effort is to the joint's limit. A joint without
            a limit takes the robot's weight at its reach, or its weight.

        """
        for joint, path, column, held in self._joints:
            values = np.full(len(q), held) if column is None else q[:, column]
            # Not as the SDK moves it, whose axes are not brought to length one.
            places, turns = _moved(joint, values)
            self._recording.send_columns(path, times, rr.Transform3D.columns(
                translation=places, quaternion=turns.as_quat(),
                parent_frame=[joint.parent] * len(values),
                child_frame=[joint.child] * len(values)), strict=True)
        if efforts is not None:
            for joint, effort in zip(self._moving, efforts.T, strict=True):
                self._send_effort(times, joint, effort)

    def _send_effort(self, times: list[rr.TimeColumn], joint: Joint, effort: np.ndarray) -> None:
        path = f'{_EFFORTS}/{rr.escape_entity_path_part(joint.name)}'
        # In the frame of the link that the joint moves, in which its axis stays.
        self._recording.log(path, rr.CoordinateFrame(joint.child), static=True)
        usual = self._usual / (self._reach if joint.kind == SLIDING else 1.0)
        share = np.clip(effort / (joint.limits.effort or usual), -1.0, 1.0)
        vectors = (_ARROW * self._reach * share)[:, None] * joint.axis
        colors = _IDLE + np.abs(share)[:, None] * (_FULL - _IDLE)
        self._recording.send_columns(path, times, rr.Arrows3D.columns(
            vectors=vectors, colors=colors.astype(np.uint8),
            radii=np.full(len(share), 0.012 * self._reach)), strict=True)


def collisions_of(robot: Robot) -> str:
    """Return the entity below which the SDK puts shapes for collisions, which hide the others."""
    return f'{_WORLD}/{rr.escape_entity_path_part(robot.name)}/collision_geometries'


def bounds_of_robot(robot: Robot) -> np.ndarray:
    """
    Return two corners of the space that a view of a robot has to show, shape (2, 3) [m].

    It is the cube within the sphere that the robot stays in whatever its joints do: from the
    distance from which all corners of it are seen, the sphere is.
    """
    half = _reach_of(robot) / np.sqrt(3.0)
    return np.array([[-half] * 3, [half] * 3])


def bounds_of_path(robot: Robot, coordinates: Sequence[str], q: np.ndarray) -> np.ndarray:
    """
    Return two corners of the space that a robot fills on a path, shape (2, 3) [m].

    They hold the origins of its links and, twice as far from that as its centre of mass, about
    where one without joints ends, and a twentieth of the largest edge on each side: links are not
    thin.

    Parameters
    ----------
    robot : Robot
        Its links; a joint that is no coordinate is where it is held, or at zero.
    coordinates : sequence of str
        The joints that move, in the order of q.
    q : np.ndarray, shape (n, d)
        The path [rad], [m].

    """
    points, still = [], (np.zeros((len(q), 3)), Rotation.identity(len(q)))
    waiting = [(robot.root, *still)]
    while waiting:
        name, place, turn = waiting.pop()
        link = robot.links[name]
        points.append(place)
        if link.inertial is not None and not link.joints:
            points.append(place + turn.apply(2.0 * link.inertial.centre))
        for joint in link.joints:
            value = (q[:, list(coordinates).index(joint.name)] if joint.name in coordinates
                     else np.full(len(q), robot.locked.get(joint.name, 0.0)))
            offset, own = _moved(joint, value)
            waiting.append((joint.child, place + turn.apply(offset), turn * own))
    corners = np.array([np.min(points, axis=(0, 1)), np.max(points, axis=(0, 1))])
    margin = 0.05 * (np.ptp(corners, axis=0).max() or 1.0)
    return corners + margin * np.array([[-1.0], [1.0]])


def _moved(joint: Joint, values: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """Return where the child of a joint is in the frame of its parent, at n values of it."""
    motion, frame = values[:, None] * joint.axis, Rotation.from_matrix(joint.rotation)
    if joint.kind == SLIDING:
        return joint.origin + frame.apply(motion), Rotation.concatenate([frame] * len(values))
    return np.tile(joint.origin, (len(values), 1)), frame * Rotation.from_rotvec(motion)


def _reach_of(robot: Robot) -> float:
    """Return the radius of a sphere about the root that all of a robot stays in [m]."""
    reach, waiting = 0.0, [(robot.root, 0.0)]
    while waiting:
        name, distance = waiting.pop()
        link = robot.links[name]
        tip = 0.0 if link.inertial is None else float(np.linalg.norm(link.inertial.centre))
        reach = max(reach, distance + 2.0 * tip)
        for joint in link.joints:
            slide = max(map(abs, filter(None, joint.bounds)), default=0.0)
            waiting.append((joint.child, distance + float(np.linalg.norm(joint.origin))
                            + slide * (joint.kind == SLIDING)))
    return reach if reach > 0.0 else np.sqrt(3.0)


def _usual_effort(robot: Robot) -> float:
    """Return the moment of the weight of all links at the reach [N m]."""
    mass = sum(link.inertial.mass for link in robot.links.values() if link.inertial is not None)
    return _GRAVITY * max(mass, 1e-3) * _reach_of(robot)
