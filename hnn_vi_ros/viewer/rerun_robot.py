# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot in the rerun viewer, as the SDK reads its URDF, with joints that move."""

from collections.abc import Sequence
from typing import final

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.hamiltonians.rigid_body.robot import Robot, SLIDING
import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree

# The entity whose frame the root of the robot stands in, and those that its joints move by.
_WORLD, _JOINTS, _ROOT = '/world', '/joints', '/joints/root'


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
        # Its path, and which coordinate it is, or where it is held.
        self._joints = [
            (joint, f'{_JOINTS}/{rr.escape_entity_path_part(joint.name)}',
             list(coordinates).index(joint.name) if joint.name in coordinates else None,
             robot.locked.get(joint.name, 0.0))
            for joint in tree.joints() if joint.name in {*coordinates, *robot.locked}]

    def send(self, times: list[rr.TimeColumn], q: np.ndarray) -> None:
        """Move the joints to q, shape (n, d), at n times."""
        for joint, path, column, held in self._joints:
            values = np.full(len(q), held) if column is None else q[:, column]
            # Limits act where the scene says so: the picture shows what is simulated.
            self._recording.send_columns(
                path, times, joint.compute_transform_columns(values.tolist(), clamp=False),
                strict=True)


def collisions_of(robot: Robot) -> str:
    """Return the entity below which the SDK puts shapes for collisions, which hide the others."""
    return f'{_WORLD}/{rr.escape_entity_path_part(robot.name)}/collision_geometries'


def bounds_of_robot(robot: Robot) -> np.ndarray:
    """
    Return two corners of what a view of a robot has to show, shape (2, 3) [m].

    It is the cube within the sphere that the robot stays in whatever its joints do: from the
    distance from which all corners of it are seen, the sphere is.
    """
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
    half = reach / np.sqrt(3.0) if reach > 0.0 else 1.0
    return np.array([[-half] * 3, [half] * 3])
