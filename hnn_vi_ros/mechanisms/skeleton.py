# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Skeletons of robots: a bone from each joint of a URDF to the next, whatever shapes it names."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files.resources import package_file, SCHEME
from hnn_vi_ros.files.xml_text import parse_xml
from hnn_vi_ros.hamiltonians.rigid_body.robot import Joint, Link, Robot, SLIDING
from hnn_vi_ros.mechanisms.parts import AMBER, Ball, Line, Mechanism, Part, SILVER
import numpy as np

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# Radii of bones and joints, over the size of the robot.
_BONE, _JOINT = 0.012, 0.025


def moved(joint: Joint, values: np.ndarray) -> tuple[np.ndarray, 'Rotation']:
    """
    Return where the child of a joint is in the frame of its parent.

    Parameters
    ----------
    joint : Joint
        Of a URDF.
    values : np.ndarray, shape (n,)
        Its coordinate [rad], [m].

    Returns
    -------
    tuple of (np.ndarray, shape (n, 3), Rotation)
        Place [m] and attitudes.

    """
    from scipy.spatial.transform import Rotation  # slow to import
    motion, frame = values[:, None] * joint.axis, Rotation.from_matrix(joint.rotation)
    if joint.kind == SLIDING:
        return joint.origin + frame.apply(motion), Rotation.concatenate([frame] * len(values))
    return np.tile(joint.origin, (len(values), 1)), frame * Rotation.from_rotvec(motion)


def tip_of(link: Link) -> np.ndarray | None:
    """Return about where a link ends that carries none: twice as far as its mass; else None."""
    return None if link.inertial is None or link.joints else 2.0 * link.inertial.centre


def bones(robot: Robot, coordinates: Sequence[str], q: np.ndarray) -> dict[str, np.ndarray]:
    """
    Return where bones begin and end on a path, by the joint or the last link that they lead to.

    Parameters
    ----------
    robot : Robot
        Its links; a joint that is no coordinate is where it is held, or at zero.
    coordinates : sequence of str
        The joints that move, in the order of q.
    q : np.ndarray, shape (n, d)
        The path [rad], [m].

    Returns
    -------
    dict of str to np.ndarray, shape (n, 2, 3)
        Places [m].

    """
    from scipy.spatial.transform import Rotation  # slow to import
    found, columns = {}, {name: column for column, name in enumerate(coordinates)}
    waiting = [(robot.root, np.zeros((len(q), 3)), Rotation.identity(len(q)))]
    while waiting:
        name, place, turn = waiting.pop()
        link, tip = robot.links[name], tip_of(robot.links[name])
        if tip is not None:
            found[f'end of {name}'] = np.stack([place, place + turn.apply(tip)], axis=1)
        for joint in link.joints:
            values = (q[:, columns[joint.name]] if joint.name in columns
                      else np.full(len(q), robot.locked.get(joint.name, 0.0)))
            offset, own = moved(joint, values)
            end = place + turn.apply(offset)
            found[joint.name] = np.stack([place, end], axis=1)
            waiting.append((joint.child, end, turn * own))
    return found


def skeleton(robot: Robot, coordinates: Sequence[str]) -> Mechanism:
    """Return what draws a robot as lines, with a ball at each joint that moves; see bones."""
    return partial(_draw, robot, [*coordinates])


def _draw(robot: Robot, coordinates: Sequence[str], q: np.ndarray, reach: float
          ) -> dict[str, Part]:
    q = np.asarray(q, dtype=np.float64)
    places = bones(robot, coordinates, q.reshape(-1, q.shape[-1]))
    size = float(np.ptp([*places.values()], axis=(0, 1, 2)).max()) or 1.0
    parts: dict[str, Part] = {}
    for name, ends in places.items():
        ends = ends.reshape(*q.shape[:-1], 2, 3)
        parts[name] = Line(ends, _BONE * size, SILVER)
        if name in coordinates:
            parts[f'{name} joint'] = Ball(ends[..., 1, :], _JOINT * size, AMBER)
    return parts


def lacking_shapes(robot: Robot) -> str:
    """Return in a line that a robot has no shapes, or meshes that are not there; else nothing."""
    shapes = [shape for link in parse_xml(robot.text.encode(), robot.where, ModelError).named(
        'link') for visual in link.named('visual') for geometry in visual.named('geometry')
        for shape in geometry.children]
    if not shapes:
        return f'{robot.where}: no <visual> to draw; its skeleton is shown'
    meshes = [shape.attributes.get('filename', '') for shape in shapes if shape.tag == 'mesh']
    gone = [name for name in meshes if not _is_there(name, Path(robot.where).parent)]
    return '' if not gone else (f'{robot.where}: {len(gone)} of {len(meshes)} meshes are not '
                                f'there, as {gone[0]}; its skeleton is shown')


def _is_there(name: str, folder: Path) -> bool:
    try:
        path = package_file(name) if name.startswith(SCHEME) else \
            folder / name.removeprefix('file://')
    except ValueError:
        return False
    return path.is_file()
