# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Skeletons of robots: a bone from each joint of a URDF to the next, without its shapes."""

from collections.abc import Sequence
from functools import partial
import html
import os
from pathlib import Path
import re
from typing import TYPE_CHECKING

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import no_file, package_file, parse_xml, SCHEME
from hnn_vi_ros.hamiltonians.mechanisms.parts import AMBER, Ball, Line, Mechanism, Part, SILVER
from hnn_vi_ros.hamiltonians.rigid_body.robot import Joint, Link, Robot, SLIDING
import numpy as np

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# Radii of bones and joints, relative to the size of the robot.
_BONE_RADIUS, _JOINT_RADIUS = 0.012, 0.025
# Maximum size of a shape file [bytes].
_MAX_SHAPE_BYTES = 256_000_000
_FILENAME = re.compile(r'\bfilename\s*=\s*("[^"]*"|\'[^\']*\')')


def joint_pose(joint: Joint, values: np.ndarray) -> tuple[np.ndarray, 'Rotation']:
    """
    Return the pose of the child of a joint in the frame of its parent.

    Parameters
    ----------
    joint : Joint
        A joint of a URDF.
    values : np.ndarray, shape (n,)
        Values of its coordinate [rad], [m].

    Returns
    -------
    tuple of (np.ndarray, shape (n, 3), Rotation)
        Positions [m] and attitudes.

    """
    from scipy.spatial.transform import Rotation  # slow to import
    motion, frame = values[:, None] * joint.axis, Rotation.from_matrix(joint.rotation)
    if joint.kind == SLIDING:
        return joint.origin + frame.apply(motion), Rotation.concatenate([frame] * len(values))
    return np.tile(joint.origin, (len(values), 1)), frame * Rotation.from_rotvec(motion)


def tip_of(link: Link) -> np.ndarray | None:
    """Return the estimated end of a link without joints, twice its centre of mass; else None."""
    return None if link.inertial is None or link.joints else 2.0 * link.inertial.centre


def bones(robot: Robot, coordinates: Sequence[str], q: np.ndarray) -> dict[str, np.ndarray]:
    """
    Return the ends of bones on a path, by the joint or the last link at their end.

    Parameters
    ----------
    robot : Robot
        Its links; a joint that neither is a coordinate nor follows one is locked, or at zero.
    coordinates : sequence of str
        The joints that move, in the order of q.
    q : np.ndarray, shape (n, d)
        The path [rad], [m].

    Returns
    -------
    dict of str to np.ndarray, shape (n, 2, 3)
        Positions [m].

    """
    from scipy.spatial.transform import Rotation  # slow to import
    found, factors, offsets = {}, *robot.driven([*robot.joints], coordinates)
    positions = dict(zip(robot.joints, factors @ q.T + offsets[:, None], strict=True))
    waiting = [(robot.root, np.zeros((len(q), 3)), Rotation.identity(len(q)))]
    while waiting:
        name, place, turn = waiting.pop()
        link, tip = robot.links[name], tip_of(robot.links[name])
        if tip is not None:
            found[f'end of {name}'] = np.stack([place, place + turn.apply(tip)], axis=1)
        for joint in link.joints:
            offset, own = joint_pose(joint, positions[joint.name])
            end = place + turn.apply(offset)
            found[joint.name] = np.stack([place, end], axis=1)
            waiting.append((joint.child, end, turn * own))
    return found


def skeleton(robot: Robot, coordinates: Sequence[str]) -> Mechanism:
    """Return the mechanism of a robot: lines, with a ball at each moving joint; see bones."""
    return partial(_draw, robot, [*coordinates])


def _draw(robot: Robot, coordinates: Sequence[str], q: np.ndarray, reach: float
          ) -> dict[str, Part]:
    q = np.asarray(q, dtype=np.float64)
    places = bones(robot, coordinates, q.reshape(-1, q.shape[-1]))
    size = float(np.ptp([*places.values()], axis=(0, 1, 2)).max()) or 1.0
    parts: dict[str, Part] = {}
    for name, ends in places.items():
        ends = ends.reshape(*q.shape[:-1], 2, 3)
        parts[name] = Line(ends, _BONE_RADIUS * size, SILVER)
        if name in coordinates:
            parts[f'{name} joint'] = Ball(ends[..., 1, :], _JOINT_RADIUS * size, AMBER)
    return parts


def shapes_of(robot: Robot) -> tuple[str, str]:
    """
    Return the URDF of a robot with only its meshes and textures as files, and a warning.

    Files are replaced by absolute paths. Only regular files of limited size are accepted, in the
    folder of the URDF or in a package that contains it or that they name: a viewer that opened
    others would wait for a FIFO, read a device without end, or show any file of this machine.

    Parameters
    ----------
    robot : Robot
        A robot read from a file.

    Returns
    -------
    tuple of (str, str)
        The text, and a line on missing shapes, '' if there are none.

    """
    from xml.sax.saxutils import quoteattr  # slow to import
    files = {name: _shape_file(name, Path(robot.where))
             for name in {html.unescape(found[1:-1]) for found in _FILENAME.findall(robot.text)}}

    def whole(found: re.Match[str]) -> str:
        path, fault = files[html.unescape(found[1][1:-1])]
        return f'filename={quoteattr("" if fault else str(path))}'

    shapes = [shape for link in parse_xml(robot.text.encode(), robot.where, ModelError).named(
        'link') for visual in link.named('visual') for geometry in visual.named('geometry')
        for shape in geometry.children]
    meshes = [shape.attributes.get('filename', '') for shape in shapes if shape.tag == 'mesh']
    lacking, problem = [name for name in meshes if files.get(name, ('', 'unnamed'))[1]], ''
    if lacking:
        problem = (f'{len(lacking)} of {len(meshes)} meshes cannot be shown, as {lacking[0]}: '
                   f'{files.get(lacking[0], ("", "no filename"))[1]}')
    elif not shapes:
        problem = 'there is no <visual>'
    return _FILENAME.sub(whole, robot.text), (
        f'{robot.where}: {problem}; a skeleton is shown instead' if problem else '')


def _packages(folder: Path) -> list[Path]:
    """Return the packages that contain a folder, the innermost first."""
    return [one for one in (folder, *folder.parents) if (one / 'package.xml').is_file()]


def _shape_file(name: str, urdf: Path) -> tuple[Path, str]:
    """Return the file of a shape, and the reason it cannot be used, '' if it can."""
    folder = Path(os.path.abspath(urdf)).parent
    try:
        path = package_file(name) if name.startswith(SCHEME) else \
            folder / name.removeprefix('file://')
    except ValueError as problem:
        return Path(), str(problem)
    source = urdf.resolve().parent
    roots = [folder, *_packages(folder)[:1], *_packages(source)[:1]]
    if name.startswith(SCHEME):
        # In a workspace built with links, files of a package are links to its sources.
        package = package_file('/'.join([*name.split('/')[:3], 'package.xml']))
        roots += [package.parent, package.resolve().parent]
    path = path.resolve()
    if not any(root.resolve() in path.parents for root in roots):
        return path, 'not in the folder of the URDF, nor in its package'
    if not path.is_file():
        return path, no_file(path)
    size = path.stat().st_size
    return path, '' if size <= _MAX_SHAPE_BYTES else (
        f'{size / 1e6:.0f} MB, limit {_MAX_SHAPE_BYTES / 1e6:.0f} MB')
