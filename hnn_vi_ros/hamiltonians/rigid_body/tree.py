# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reduction of a robot to the bodies of its moving joints; rigidly joined links are one body."""

from collections.abc import Mapping, Sequence
import math
import re
import warnings

from hnn_vi_ros.errors import listed, ModelError
from hnn_vi_ros.hamiltonians.rigid_body.robot import (
    Inertial, Joint, KINDS, Link, RIGID, Robot, SLIDING)
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies, compose, place, Work
import numpy as np

MOST_JOINTS = 12
_NAME = re.compile(r'[^\W\d][\w.-]*\Z')
# Smallest eigenvalue of M, with its diagonal scaled to one, that counts as positive.
_SINGULAR = 1e-13
# Generic configurations at which M is tested.
_PROBES = 4


def tree_of(robot: Robot, joints: Sequence[str] | None, locked: Mapping[str, float],
            gravity: Sequence[float], base: str, rotor_inertia: Mapping[str, float]
            ) -> tuple[Bodies, tuple[Joint, ...]]:
    """
    Return the bodies of a robot, and the joints in the order of the coordinates.

    Parameters
    ----------
    robot : Robot
        A robot; links that are not behind ``base`` are ignored.
    joints : sequence of str or None
        The moving joints in the order of the coordinates; by default all that are not locked, from
        the base to the tips.
    locked : mapping of str to float
        Values of joints that do not move [rad] or [m].
    gravity : sequence of float
        Gravity in the frame of the base [m/s2].
    base : str
        The fixed link.
    rotor_inertia : mapping of str to float
        Inertias of rotors behind joints, reduced to the joint [kg m2] or [kg].

    Raises
    ------
    ModelError
        A link or joint does not exist, a joint cannot be simulated, or parts can move without
        inertia.
    ValueError
        An argument is invalid.

    """
    if base not in robot.links:
        raise ValueError(f'base = {base!r} is no link; links: {listed(robot.links)}')
    builder = _Builder(robot, locked, base)
    moving = {joint.name: joint for joint in builder.joints}
    order = list(moving) if joints is None else list(joints)
    _check_joints(order, moving, builder.met)
    for name, values in (('locked', locked), ('rotor_inertia', rotor_inertia)):
        valid = builder.met if name == 'locked' else moving
        for joint in values:
            if joint not in valid:
                raise ValueError(f'{name} names {joint!r}, which is no joint that moves; valid: '
                                 f'{listed(valid) or "none"}')
    for joint, value in rotor_inertia.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f'rotor_inertia of {joint} = {value} must be a number from 0')
    if len(gravity) != 3 or not all(map(math.isfinite, gravity)):
        raise ValueError(f'gravity = {list(gravity)} must be three numbers [m/s2], such as '
                         '[0, 0, -9.81]')
    places = [order.index(name) for name in moving]
    bodies = builder.bodies(places, [rotor_inertia.get(name, 0.0) for name in moving], gravity)
    if not all(np.isfinite(part).all() for part in bodies):
        raise ModelError(f'{robot.links[base].place}: numbers behind it whose products overflow; '
                         'see their units')
    _check_mass(bodies, builder.joints)
    return bodies, tuple(moving[name] for name in order)


def mass_matrix(bodies: Bodies, q: np.ndarray) -> np.ndarray:
    """Return M(q), shape (d, d), for q of shape (d,), in the arithmetic of q."""
    d = q.size
    work = Work.empty(d)
    place(bodies, work, q, 0)
    compose(bodies, work)
    lower = work.mass + np.tril(work.mass, -1).T
    rows = np.empty(d, dtype=np.int64)
    rows[bodies.coordinate[1:]] = np.arange(d)
    return lower[np.ix_(rows, rows)]


def _check_joints(order: Sequence[str], moving: Mapping[str, Joint], met: Mapping[str, Joint]
                  ) -> None:
    for name in order:
        if name not in moving:
            why = 'it is locked' if name in met else 'no such joint moves'
            raise ValueError(f'joints names {name!r}: {why}; moving joints: '
                             f'{listed(moving) or "none"}')
    if len(set(order)) < len(order):
        raise ValueError(f'joints = [{listed(order)}] must name each joint once')
    named = set(order)
    left = [name for name in moving if name not in named]
    if left:
        raise ValueError(f'joints leaves out {listed(left)}; name them too, or hold them where '
                         f'they are to be: locked: {{{left[0]}: 0.0}}')
    if not order:
        raise ValueError('no joint moves: ' + (
            'all are locked; lock fewer' if met else 'behind the base there is none but fixed '
            'ones; take another base, or a robot with joints'))
    if len(order) > MOST_JOINTS:
        raise ValueError(f'joints: {len(order)} move, at most {MOST_JOINTS} can; lock some, or '
                         f'take another base: {listed(order)}')
    for name in order:
        if not _NAME.match(name):
            raise ModelError(f'{moving[name].place}: the name of a coordinate must be a letter or '
                             'underscore, then letters, digits, underscores, dots, hyphens; '
                             'rename the joint')


def _check_mass(bodies: Bodies, joints: Sequence[Joint]) -> None:
    """Raise unless M is positive definite at some configuration."""
    rng = np.random.default_rng(1)
    for _ in range(_PROBES):
        mass = mass_matrix(bodies._replace(
            coordinate=np.arange(-1, len(joints))), rng.uniform(-1.0, 1.0, len(joints)))
        diagonal = np.diag(mass)
        if (diagonal > 0.0).all():
            scale = np.sqrt(diagonal)
            values, vectors = np.linalg.eigh(mass / scale / scale[:, None])
            if values[0] > _SINGULAR:
                return
            free = np.abs(vectors[:, 0]) > 0.1
        else:
            free = diagonal <= 0.0
    names = [joint.name for joint, one in zip(joints, free, strict=True) if one]
    first = next(joint for joint, one in zip(joints, free, strict=True) if one)
    raise ModelError(f'{first.place}: {listed(names)} can move without moving any mass or '
                     f'inertia; give <inertial> to link {first.child!r} or those behind it, lock '
                     'the joint, or give its rotor_inertia')


class _Body:
    """Rigidly connected links: a row of Bodies under construction."""

    def __init__(self, parent: int, slides: bool, turns: bool, rotation: np.ndarray,
                 origin: np.ndarray):
        self.parent, self.slides, self.turns = parent, slides, turns
        self.rotation, self.origin = rotation, origin
        self.mass, self.first, self.second = 0.0, np.zeros(3), np.zeros((3, 3))
        # Its links in its frame.
        self._links: list[Inertial] = []

    def add(self, link: Inertial, rotation: np.ndarray, origin: np.ndarray) -> None:
        """Add a link, given the pose of its frame in the frame of the body."""
        centre = origin + rotation @ link.centre
        self._links.append(Inertial(link.mass, centre, rotation @ link.moments @ rotation.T))
        self.mass += link.mass
        self.first += link.mass * centre
        self.second += rotation @ link.moments @ rotation.T + link.mass * (
            centre @ centre * np.eye(3) - np.outer(centre, centre))

    @property
    def fault(self) -> str:
        """Return the reason its mass, or its moments if it rotates, are invalid, '' if valid."""
        centre = self.first / self.mass if self.mass > 0.0 else np.zeros(3)
        moments = np.zeros((3, 3))
        for link in self._links if self.turns else ():
            arm = link.centre - centre
            moments += link.moments + link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return Inertial(self.mass, centre, moments).fault


class _Builder:
    """Traversal of a robot from a link to the tips."""

    def __init__(self, robot: Robot, locked: Mapping[str, float], base: str):
        self._robot, self._locked = robot, locked
        self._rows = [_Body(0, False, False, np.eye(3), np.zeros(3))]
        # Physically impossible links, with their rows and the reason.
        self._odd: list[tuple[Link, int, str]] = []
        # The moving joints, in the order of the bodies; and all joints that could move.
        self.joints: list[Joint] = []
        self.met: dict[str, Joint] = {}
        self._mimics: list[Joint] = []
        # Joints to visit, with the body that carries them and the pose of their link's frame in
        # the frame of the body.
        self._waiting: list[tuple[Joint, int, np.ndarray, np.ndarray]] = []
        self._reach(base, 0, np.eye(3), np.zeros(3))
        while self._waiting:
            self._pass(*self._waiting.pop())
        self._judge()
        if self._mimics:
            text = listed(f'{joint.name} (of {joint.mimics})' for joint in self._mimics)
            held = listed(f'{joint.name}: 0.0' for joint in self._mimics)
            raise ModelError(f'{self._mimics[0].place}: joints that mimic others are not '
                             f'simulated: {text}; hold them where they are to be: '
                             f'locked: {{{held}}}')

    def _reach(self, name: str, row: int, rotation: np.ndarray, origin: np.ndarray) -> None:
        link = self._robot.links[name]
        if link.inertial is not None:
            if fault := link.inertial.fault:
                self._odd.append((link, row, fault))
            # A fixed link may have any mass.
            if row > 0:
                self._rows[row].add(link.inertial, rotation, origin)
        # The first one is visited next.
        self._waiting += [(joint, row, rotation, origin) for joint in reversed(link.joints)]

    def _judge(self) -> None:
        """Raise for an impossible link that affects the motion, and warn about all others."""
        for link, row, fault in self._odd:
            assert link.inertial is not None, 'only what is there can be odd'
            if row > 0 and (link.inertial.mass < 0.0 or self._rows[row].fault):
                raise ModelError(f'{link.place}: {fault}')
        for link, row, fault in self._odd[:1]:
            why = 'together with what it is fixed to it is possible'
            if not self._rows[row].turns:
                why = 'it does not turn' if row > 0 else 'it rests'
            others = listed(other.name for other, *_ in self._odd[1:])
            warnings.warn(f'{link.place}: {fault}; simulated as it is, since {why}'
                          f'{"; likewise " * bool(others)}{others}', stacklevel=5)

    def _pass(self, joint: Joint, row: int, rotation: np.ndarray, origin: np.ndarray) -> None:
        origin = origin + rotation @ joint.origin
        rotation = rotation @ joint.rotation
        if joint.kind not in KINDS:
            raise ModelError(f'{joint.place}: type {joint.kind!r} cannot be simulated; valid: '
                             f'{", ".join(KINDS)}; or take a base behind it: base: {joint.child}')
        if joint.moves:
            self.met[joint.name] = joint
        if joint.kind == RIGID:
            self._reach(joint.child, row, rotation, origin)
        elif joint.name in self._locked:
            value = self._locked[joint.name]
            if not math.isfinite(value):
                raise ValueError(f'locked at {joint.name} = {value} must be a finite number')
            if joint.kind == SLIDING:
                origin = origin + value * (rotation @ joint.axis)
            else:
                from scipy.spatial.transform import Rotation  # slow to import
                rotation = rotation @ Rotation.from_rotvec(value * joint.axis).as_matrix()
            self._reach(joint.child, row, rotation, origin)
        elif joint.mimics is not None:
            self._mimics.append(joint)
            self._reach(joint.child, row, rotation, origin)
        else:
            frame = frame_of(joint.axis)
            self.joints.append(joint)
            slides = joint.kind == SLIDING
            turns = self._rows[row].turns or not slides
            self._rows.append(_Body(row, slides, turns, rotation @ frame, origin))
            self._reach(joint.child, len(self._rows) - 1, frame.T, np.zeros(3))

    def bodies(self, places: Sequence[int], armature: Sequence[float], gravity: Sequence[float]
               ) -> Bodies:
        """Return the bodies, given the coordinate of each one's joint."""
        rows = self._rows
        placement = [[*body.rotation.ravel(), *body.origin] for body in rows]
        inertia = [[body.mass, *body.first, *body.second[np.tril_indices(3)]] for body in rows]
        return Bodies(
            np.array([body.parent for body in rows]), np.array([0, *places]),
            np.array([int(body.slides) for body in rows]), np.array(placement),
            np.array(inertia), np.array([0.0, *armature]), np.array(gravity, dtype=np.float64),
            np.zeros(len(rows)))


def frame_of(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is a unit vector; exact for an axis of the frame."""
    other = np.zeros(3)
    other[np.argmin(np.abs(axis))] = 1.0
    first = np.cross(other, axis)
    first /= math.sqrt(first @ first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)
