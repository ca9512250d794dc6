# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reduction of a robot to the bodies of its moving joints; rigidly joined links are one body."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
import re
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import listed, ModelError
from hnn_vi_ros.hamiltonians.rigid_body.robot import (
    Inertial, Joint, KINDS, Link, Mimic, RIGID, Robot, SLIDING)
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import (
    Bodies, fill_frames, fill_mass_matrix, Following, TreeWork)
import numpy as np

MOST_JOINTS, MOST_DRIVEN = 12, 64
_NAME = re.compile(r'[\w/][\w./-]*\Z')
# Smallest eigenvalue of M, with its diagonal scaled to one, that counts as positive.
_MIN_EIGENVALUE = 1e-13
# Condition of M, or ratio of its diagonal, above which half of the digits are lost.
_MAX_CONDITION = 1e8
# Generic configurations at which M is tested.
_PROBES = 4
# Share of a joint's range by which limits of followers may narrow it unsaid.
_ROUNDED = 1e-3


class Tree(NamedTuple):
    """
    A robot as bodies.

    Parameters
    ----------
    robot : Robot
        The robot with the values of all locked joints, and the joints that follow others.
    bodies : Bodies
        Its bodies; with ``following``, the joint of each has a coordinate of its own.
    joints : tuple of Joint
        The joints in the order of the coordinates, with the damping, friction and limits of those
        that follow them.
    following : Following or None
        The values of all joints; None if no joint follows another.

    """

    robot: Robot
    bodies: Bodies
    joints: tuple[Joint, ...]
    following: Following | None


def tree_of(robot: Robot, joints: Sequence[str] | None, locked: Mapping[str, float],
            gravity: Sequence[float], base: str, rotor_inertia: Mapping[str, float]) -> Tree:
    """
    Return the bodies of a robot.

    Parameters
    ----------
    robot : Robot
        A robot; links that are not behind ``base`` are ignored.
    joints : sequence of str or None
        The moving joints in the order of the coordinates; by default all that are not locked and
        follow no other, from the base to the tips.
    locked : mapping of str to float
        Values of joints that do not move [rad] or [m].
    gravity : sequence of float
        Gravity in the frame of the base [m/s2].
    base : str
        The fixed link.
    rotor_inertia : mapping of str to float
        Inertias of rotors behind joints, reduced to the joint, in place of those of the robot
        [kg m2] or [kg].

    Raises
    ------
    ModelError
        A link or joint does not exist, a joint cannot be simulated, or parts can move without
        inertia.
    ValueError
        An argument is invalid.

    """
    if base not in robot.links:
        raise ValueError(f'base = {base!r} is not a link; links: {listed(robot.links)}')
    for joint, value in locked.items():
        if not math.isfinite(value):
            raise ValueError(f'locked of {joint} = {value} must be a finite number')
    builder = _Builder(robot, locked, base)
    driven, followers = {joint.name: joint for joint in builder.joints}, builder.followers
    moving = {name: joint for name, joint in driven.items() if name not in followers}
    order = list(moving) if joints is None else list(joints)
    _check_joints(order, moving, builder.met, followers)
    if len(driven) > MOST_DRIVEN:
        raise ValueError(f'{len(driven)} joints move or follow others, at most {MOST_DRIVEN} are '
                         f'supported; lock some, or use another base: {listed(driven)}')
    for name, values in (('locked', locked), ('rotor_inertia', rotor_inertia)):
        valid = builder.met if name == 'locked' else driven
        for joint in values:
            if joint not in valid:
                raise ValueError(f'{name} names {joint!r}, which is not a movable joint; valid: '
                                 f'{listed(valid) or "none"}')
    for joint, value in rotor_inertia.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f'rotor_inertia of {joint} = {value} must be at least 0 and finite')
    if len(gravity) != 3 or not all(map(math.isfinite, gravity)):
        raise ValueError(f'gravity = {list(gravity)} must be three numbers [m/s2], such as '
                         '[0, 0, -9.81]')
    places, following = [order.index(name) for name in moving], None
    if followers:
        ends = [followers.get(name, Mimic(name, 1.0, 0.0)) for name in driven]
        following = Following(np.array([order.index(end.joint) for end in ends]),
                              *np.array([end[1:] for end in ends]).T.copy())
        places = [*range(len(driven))]
    bodies = builder.bodies(places, [rotor_inertia.get(name, joint.rotor)
                                     for name, joint in driven.items()], gravity)
    if not all(np.isfinite(part).all() for part in (*bodies, *(following or ()))):
        raise ModelError(f'{robot.links[base].place}: products of numbers beyond this link '
                         'overflow; check their units')
    _check_mass(bodies, following, [moving[name] for name in order])
    return Tree(replace(robot, locked={**locked, **builder.held}, followers=followers), bodies,
                _with_followers([moving[name] for name in order], driven, followers), following)


def mass_matrix(bodies: Bodies, q: np.ndarray, following: Following | None = None) -> np.ndarray:
    """Return M(q), shape (d, d), for q of shape (d,), in the arithmetic of q."""
    if following is not None:
        G = following.matrix()
        half = 0.5 * G.T @ mass_matrix(bodies, G @ q + following.offset) @ G
        return half + half.T
    d = q.size
    work = TreeWork.empty(d)
    fill_frames(bodies, work, q, 0)
    fill_mass_matrix(bodies, work)
    lower = work.mass + np.tril(work.mass, -1).T
    rows = np.empty(d, dtype=np.int64)
    rows[bodies.coordinate[1:]] = np.arange(d)
    return lower[np.ix_(rows, rows)]


def _with_followers(joints: Sequence[Joint], driven: Mapping[str, Joint],
                    followers: Mapping[str, Mimic]) -> tuple[Joint, ...]:
    """Return joints with damping, friction and limits of those that follow them, and tell."""
    found, told = {joint.name: joint for joint in joints}, []
    for name, (leader, multiplier, offset) in followers.items():
        joint, own = found[leader], driven[name]
        joint = replace(joint, damping=joint.damping + multiplier * multiplier * own.damping,
                        friction=joint.friction + abs(multiplier) * own.friction)
        found[leader], (first, last) = joint, own.bounds
        if first is None or last is None or multiplier == 0.0:
            continue
        # Limits of a joint that follows are limits of its leader.
        lower, upper = sorted(((first - offset) / multiplier, (last - offset) / multiplier))
        low, high = (end if end is not None else infinite for end, infinite in zip(
            joint.bounds, (-math.inf, math.inf), strict=True))
        least, most = max(low, lower), min(high, upper)
        if not least < most:
            told.append((own, f'those of {name} leave {leader} no room and are ignored'))
            continue
        if max(least - low, high - most) > _ROUNDED * (most - least):
            told.append((own, f'{leader} moves from {least:g} to {most:g} because of {name}'))
        found[leader] = replace(
            joint, kind='revolute' if joint.kind == 'continuous' else joint.kind,
            limits=replace(joint.limits, lower=least, upper=most))
    if told:
        warnings.warn(f'{told[0][0].place}: limits of joints that mimic others: '
                      f'{listed(text for _, text in told)}', stacklevel=4)
    return tuple(found.values())


def _check_joints(order: Sequence[str], moving: Mapping[str, Joint], met: Mapping[str, Joint],
                  followers: Mapping[str, Mimic]) -> None:
    for name in order:
        if name not in moving:
            why = 'it is locked' if name in met else 'it is not a movable joint'
            if name in followers:
                why = f'it follows {followers[name].joint}'
            raise ValueError(f'joints names {name!r}: {why}; moving joints: '
                             f'{listed(moving) or "none"}')
    if len(set(order)) < len(order):
        raise ValueError(f'joints = [{listed(order)}] must name each joint once')
    named = set(order)
    left = [name for name in moving if name not in named]
    if left:
        raise ValueError(f'joints does not contain {listed(left)}; add them, or lock them, for '
                         f'example with locked: {{{left[0]}: 0.0}}')
    if not order:
        raise ValueError('no joint moves: ' + (
            'all are locked; lock fewer' if met else 'those beyond the base are fixed; use '
            'another base, or a robot with movable joints'))
    if len(order) > MOST_JOINTS:
        raise ValueError(f'{len(order)} joints move, at most {MOST_JOINTS} are supported; lock '
                         f'some, or use another base: {listed(order)}')
    for name in order:
        if not _NAME.match(name):
            raise ModelError(f'{moving[name].place}: the name of a coordinate must be letters, '
                             'digits, underscores, slashes, dots, hyphens, and not begin with a '
                             'dot or hyphen; rename the joint')


def _check_mass(bodies: Bodies, following: Following | None, joints: Sequence[Joint]) -> None:
    """Raise unless M is positive definite at some configuration; warn if it barely is."""
    rng = np.random.default_rng(1)
    for _ in range(_PROBES):
        with np.errstate(all='ignore'):
            mass = mass_matrix(bodies, rng.uniform(-1.0, 1.0, len(joints)), following)
        if not np.isfinite(mass).all():
            raise ModelError(f'{joints[0].place}: products of masses and multipliers of joints '
                             'overflow; check their units')
        diagonal = np.diag(mass)
        if (diagonal > 0.0).all():
            scale = np.sqrt(diagonal)
            values, vectors = np.linalg.eigh(mass / scale / scale[:, None])
            if values[0] > _MIN_EIGENVALUE:
                # Masses of slides and moments of inertia have different units.
                slides = np.array([joint.kind == SLIDING for joint in joints])
                most = np.where(slides, *(diagonal[own].max(initial=0.0)
                                          for own in (slides, ~slides)))
                condition = max(1.0 / values[0], (most / diagonal).max())
                if condition > _MAX_CONDITION:
                    lightest = joints[int(np.argmax(most / diagonal))]
                    warnings.warn(
                        f'{lightest.place}: has next to no inertia beside the others (condition '
                        f'{condition:.2g} of the mass matrix): it needs tiny steps, and digits '
                        'are lost; give its rotor_inertia, or lock it', stacklevel=5)
                return
            free = np.abs(vectors[:, 0]) > 0.1
        else:
            free = diagonal <= 0.0
    names = [joint.name for joint, one in zip(joints, free, strict=True) if one]
    first = next(joint for joint, one in zip(joints, free, strict=True) if one)
    raise ModelError(f'{first.place}: {listed(names)} can move without moving any mass or '
                     f'inertia; give <inertial> to link {first.child!r} or to links beyond it, '
                     'lock the joint, or give its rotor_inertia')


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
    def row(self) -> list[float]:
        """Return m, h and I; see Bodies."""
        return [self.mass, *self.first, *self.second[np.tril_indices(3)]]

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
        # Body of each link, and the pose of its frame in that of the body.
        self.links: dict[str, tuple[int, np.ndarray, np.ndarray]] = {}
        # Physically impossible links, with their rows and the reason; and those by rounding.
        self._odd: list[tuple[Link, int, str]] = []
        self._rounded: list[tuple[Link, float]] = []
        # The moving joints, in the order of the bodies; and all joints that could move.
        self.joints: list[Joint] = []
        self.met: dict[str, Joint] = {}
        # Joints that follow moving ones; and the values of those that follow locked ones.
        self.followers: dict[str, Mimic] = {}
        self.held: dict[str, float] = {}
        # Joints to visit, with the body that carries them and the pose of their link's frame in
        # the frame of the body.
        self._waiting: list[tuple[Joint, int, np.ndarray, np.ndarray]] = []
        self._reach(base, 0, np.eye(3), np.zeros(3))
        while self._waiting:
            self._pass(*self._waiting.pop())
        self._judge()
        for name, mimic in self.followers.items():
            if mimic.joint not in self.met:
                raise ModelError(f'{self.met[name].place}: mimics {mimic.joint}, which is not '
                                 f'beyond the base {base}; use another base, or lock the joint '
                                 f'with locked: {{{name}: 0.0}}')

    def _reach(self, name: str, row: int, rotation: np.ndarray, origin: np.ndarray) -> None:
        link, self.links[name] = self._robot.links[name], (row, rotation, origin)
        if link.inertial is not None:
            if fault := link.inertial.fault:
                self._odd.append((link, row, fault))
            elif row > 0 and link.inertial.excess > 0.0:
                self._rounded.append((link, link.inertial.excess))
            # A fixed link may have any mass.
            if row > 0:
                self._rows[row].add(link.inertial, rotation, origin)
        # The first one is visited next.
        self._waiting += [(joint, row, rotation, origin) for joint in reversed(link.joints)]

    def _judge(self) -> None:
        """Raise for an impossible link that affects the motion, and warn about all others."""
        for link, row, fault in self._odd:
            assert link.inertial is not None, 'only an inertial that is given can be invalid'
            if row > 0 and (link.inertial.mass < 0.0 or self._rows[row].fault):
                raise ModelError(f'{link.place}: {fault}')
        for link, row, fault in self._odd[:1]:
            why = 'the body that it is fixed to is valid as a whole'
            if not self._rows[row].turns:
                why = 'it does not rotate' if row > 0 else 'it is at rest'
            others = listed(other.name for other, *_ in self._odd[1:])
            warnings.warn(f'{link.place}: {fault}; simulated nevertheless, because {why}'
                          f'{"; likewise " * bool(others)}{others}', stacklevel=5)
        for link, excess in self._rounded[:1]:
            others = listed(f'{other.name} by {more:.2g}' for other, more in self._rounded[1:])
            warnings.warn(
                f'{link.place}: the largest moment of inertia exceeds the sum of the others by '
                f'{excess:.2g} of it, as after rounding; simulated as given'
                f'{"; likewise " * bool(others)}{others}', stacklevel=5)

    def _pass(self, joint: Joint, row: int, rotation: np.ndarray, origin: np.ndarray) -> None:
        origin = origin + rotation @ joint.origin
        rotation = rotation @ joint.rotation
        if joint.kind not in KINDS:
            raise ModelError(f'{joint.place}: type {joint.kind!r} is not supported; valid: '
                             f'{", ".join(KINDS)}; or use a base beyond it: base: {joint.child}')
        if joint.moves:
            self.met[joint.name] = joint
        if joint.kind == RIGID:
            self._reach(joint.child, row, rotation, origin)
        elif (value := self._fixed_value(joint)) is not None:
            if joint.kind == SLIDING:
                origin = origin + value * (rotation @ joint.axis)
            else:
                from scipy.spatial.transform import Rotation  # slow to import
                rotation = rotation @ Rotation.from_rotvec(value * joint.axis).as_matrix()
            self._reach(joint.child, row, rotation, origin)
        else:
            frame = frame_of(joint.axis)
            self.joints.append(joint)
            slides = joint.kind == SLIDING
            turns = self._rows[row].turns or not slides
            self._rows.append(_Body(row, slides, turns, rotation @ frame, origin))
            self._reach(joint.child, len(self._rows) - 1, frame.T, np.zeros(3))

    def _fixed_value(self, joint: Joint) -> float | None:
        """Return the value of a joint that is locked or follows a locked one; None if it moves."""
        if joint.name in self._locked or joint.mimic is None:
            return self._locked.get(joint.name)
        mimic = self._robot.followed(joint, self._locked)
        if mimic.joint not in self._locked:
            self.followers[joint.name] = mimic
            return None
        value = mimic.multiplier * self._locked[mimic.joint] + mimic.offset
        self.held[joint.name] = value
        return value

    def bodies(self, places: Sequence[int], armature: Sequence[float], gravity: Sequence[float]
               ) -> Bodies:
        """Return the bodies, given the coordinate of each one's joint."""
        rows = self._rows
        placement = [[*body.rotation.ravel(), *body.origin] for body in rows]
        return Bodies(
            np.array([body.parent for body in rows]), np.array([0, *places]),
            np.array([int(body.slides) for body in rows]), np.array(placement),
            np.array([body.row for body in rows]), np.array([0.0, *armature]),
            np.array(gravity, dtype=np.float64), np.zeros(len(rows)))


def links_of(robot: Robot, locked: Mapping[str, float], base: str
             ) -> dict[str, tuple[int, np.ndarray, np.ndarray]]:
    """Return the body of each link, and the pose of its frame in that of the body."""
    return _Builder(robot, locked, base).links


def inertia_row(link: Inertial, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return m, h and I of a link, given the pose of its frame in the frame of its body."""
    body = _Body(0, False, True, np.eye(3), np.zeros(3))
    body.add(link, rotation, origin)
    return np.array(body.row)


def frame_of(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is a unit vector; exact for an axis of the frame."""
    other = np.zeros(3)
    other[np.argmin(np.abs(axis))] = 1.0
    first = np.cross(other, axis)
    first /= math.sqrt(first @ first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)
