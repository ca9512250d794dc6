# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Elements that close chains, which URDF has not, in the dialects of Isaac Sim, Gazebo and Drake.

``<loop_joint>``, ``<joint>`` in ``<gazebo>`` and ``<drake:ball_constraint>`` become loops. Others,
such as ``<constraint>`` and the compliant ``<drake:linear_bushing_rpy>``, are only noted.
"""

from collections.abc import Iterator, Mapping, Sequence
import re
from typing import Any
import warnings

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import Element
from hnn_vi_ros.hamiltonians.rigid_body.elements import only_child, place_of, vector_of
from hnn_vi_ros.hamiltonians.rigid_body.loops import ClosingJoint
from hnn_vi_ros.hamiltonians.rigid_body.robot import Closure, Robot
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies, Following
from hnn_vi_ros.hamiltonians.rigid_body.tree import frame_of
import numpy as np

# Elements of <robot> that act between links: <drake:joint>, <loop>, <constraint>, ...
_ACTING = re.compile(r'drake:joint|.*(loop|constraint|bushing|coupling|spring)', re.IGNORECASE)
_KINDS = {'revolute': 'hinge', 'continuous': 'hinge', 'hinge': 'hinge', 'spherical': 'point',
          'ball': 'point', 'fixed': 'weld'}
_ZEROS = (0.0, 0.0, 0.0)
Pose = tuple[np.ndarray, np.ndarray]


def is_closure(tag: str) -> bool:
    """Return True for elements of <robot> that may close a chain."""
    return _ACTING.match(tag) is not None


def loops_in(robot: Robot, rows: Mapping[str, int], bodies: Bodies, following: Following | None
             ) -> list[ClosingJoint]:
    """
    Return the loops of a robot.

    Parameters
    ----------
    robot : Robot
        The robot.
    rows : mapping of str to int
        Body of each link behind the base.
    bodies, following : Bodies, Following or None
        The tree, and the joints that follow others.

    Raises
    ------
    ModelError
        An element acts between bodies that move, and is not a loop.

    """
    found = []
    for place, links, loop in robot.closures:
        known = [rows[link] for link in links if link in rows]
        between = _between(bodies, known)
        if len(links) == 2 and robot.links.keys() >= {*links} and (not known or (
                len(known) == 2 and not between)):
            # Joints between them are locked, or they are not behind the base.
            continue
        if following and len(known) == 2 and len(between) > 1 and len(
                {following.leader[joint] for joint in between}) == 1:
            warnings.warn(f'{place}: left out, because joints that follow one another already '
                          f'determine how {links[0]} moves against {links[1]}', stacklevel=4)
            continue
        if loop is None or len(known) < 2:
            raise ModelError(
                f'{place}: acts between links in a way that is not supported, and without it the '
                'chain would be open; write it as <loop_joint>, as loops in hamiltonian, or give '
                'loops: [] to leave it out; see docs/how-to/robots.md')
        found.append(ClosingJoint(**loop))
    return found


def _between(bodies: Bodies, rows: Sequence[int]) -> set[int]:
    """Return the joints between two bodies, by their columns."""
    joints: set[int] = set()
    for row in rows:
        while row > 0:
            joints ^= {int(bodies.coordinate[row])}
            row = bodies.parent[row]
    return joints


def closures_in(root: Element, robot: Robot) -> Iterator[Closure]:
    """
    Yield the elements of a robot that close chains.

    Raises
    ------
    ModelError
        Numbers of an element cannot be read.

    """
    for element in root.children:
        place = place_of(element, robot.where)
        if element.tag == 'loop_joint':
            yield _of_isaac(element, place)
        elif element.tag == 'drake:ball_constraint':
            yield _of_drake(element, place)
        elif is_closure(element.tag):
            yield Closure(place, (), None)
        for inner in element.children if element.tag == 'gazebo' else ():
            if inner.tag == 'joint':
                yield _of_gazebo(inner, robot)
            elif inner.tag.startswith('joint:'):
                yield Closure(place_of(inner, robot.where), tuple(
                    one.text for one in inner.children if one.tag in ('body1', 'body2')), None)


def _of_isaac(element: Element, place: str) -> Closure:
    """Read <loop_joint>: a frame in each link, and an axis in both frames."""
    ends = [child for child in element.children if child.tag in ('link1', 'link2')]
    links = tuple(end.attributes.get('link', '') for end in ends)
    axis = vector_of(only_child(element, 'axis', place), 'xyz', place, (1.0, 0.0, 0.0))
    poses = [(_turn(vector_of(end, 'rpy', place, _ZEROS)), vector_of(end, 'xyz', place, _ZEROS))
             for end in ends]
    return Closure(place, links, _loop(element, links, poses, axis))


def _of_drake(element: Element, place: str) -> Closure:
    """Read <drake:ball_constraint>: a point in each link."""
    inner = {child.tag.removeprefix('drake:ball_constraint_'): child for child in element.children}
    links = tuple(inner[end].attributes.get('name', '') for end in ('body_A', 'body_B')
                  if end in inner)
    points = [vector_of(inner.get(end), 'value', place, _ZEROS).tolist()
              for end in ('p_AP', 'p_BQ')]
    return Closure(place, links, {'links': [*links], 'joint': 'point', 'points': points})


def _of_gazebo(element: Element, robot: Robot) -> Closure:
    """
    Read <joint> of SDF in <gazebo>: its frame, in that of the child, and an axis in this frame.

    The frame on the parent is where this one is at zero of all joints.
    """
    place = place_of(element, robot.where)
    parent, child, pose, axis = (only_child(element, tag, place) or Element(tag, {}, element.line)
                                 for tag in ('parent', 'child', 'pose', 'axis'))
    xyz = only_child(axis, 'xyz', place)
    # The base does not move in the world.
    links = tuple(robot.root if one.text == 'world' and 'world' not in robot.links else one.text
                  for one in (parent, child))
    if any(link not in robot.links for link in links) or pose.attributes or axis.named(
            'use_parent_model_frame') or (xyz is not None and xyz.attributes):
        # Frames of the whole model, for example.
        return Closure(place, links, None)
    if axis.named('limit') or axis.named('dynamics'):
        warnings.warn(f'{place}: limits and friction of joints that close chains do not act',
                      stacklevel=2)
    frame = _numbers(pose, place, (*_ZEROS, *_ZEROS))
    own = _turn(frame[3:]), frame[:3]
    (turn, at), (other, origin) = (_zero_poses(robot)[link] for link in links)
    shift = turn.T @ (origin + other @ own[1] - at)
    direction = np.array([0.0, 0.0, 1.0]) if xyz is None else _numbers(xyz, place, _ZEROS)
    return Closure(place, links, _loop(
        element, links, [(turn.T @ other @ own[0], shift), own], direction))


def _loop(element: Element, links: tuple[str, ...], poses: list[Pose], axis: np.ndarray
          ) -> dict[str, Any] | None:
    """Return the loop with poses of its frames in the links; None for other joints."""
    # Imported lazily: the import is slow, and scenes without robots do not need it.
    from scipy.spatial.transform import Rotation
    kind, length = _KINDS.get(element.attributes.get('type', '')), np.linalg.norm(axis)
    if kind is None or len(links) != 2 or not length > 0.0:
        return None
    loop = {'links': [*links], 'joint': kind}
    if kind == 'point':
        return loop | {'points': [origin.tolist() for _, origin in poses]}
    turn = frame_of(axis / length) if kind == 'hinge' else np.eye(3)
    with warnings.catch_warnings():
        # Any of the angles of one rotation will do.
        warnings.filterwarnings('ignore', 'Gimbal lock')
        angles = [Rotation.from_matrix(rotation @ turn).as_euler('xyz') for rotation, _ in poses]
    return loop | {'frames': [[*origin.tolist(), *rpy.tolist()] for (_, origin), rpy in zip(
        poses, angles, strict=True)]}


def _zero_poses(robot: Robot) -> dict[str, Pose]:
    """Return rotation and origin of each link in the frame of the root, at zero of all joints."""
    poses, waiting = {robot.root: (np.eye(3), np.zeros(3))}, [robot.root]
    while waiting:
        name = waiting.pop()
        rotation, origin = poses[name]
        for joint in robot.links[name].joints:
            poses[joint.child] = rotation @ joint.rotation, origin + rotation @ joint.origin
            waiting.append(joint.child)
    return poses


def _turn(rpy: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation  # slow to import
    return Rotation.from_euler('xyz', rpy).as_matrix()


def _numbers(element: Element, place: str, default: tuple[float, ...]) -> np.ndarray:
    """Return the numbers in the text of an element."""
    return vector_of(Element(element.tag, {'text': element.text} if element.text else {}, 0),
                     'text', place, default)
