# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot from a URDF: links and the joints between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

from hnn_vi_ros.errors import did_you_mean, listed, ModelError
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Joints with one coordinate, and without.
TURNING, SLIDING, RIGID = ('revolute', 'continuous'), 'prismatic', 'fixed'
KINDS = (*TURNING, SLIDING, RIGID)
# Tolerance for rounded digits in a file: relative to the largest moment of inertia, and [kg m2].
_RELATIVE_TOLERANCE, _ABSOLUTE_TOLERANCE = 1e-6, 1e-12
# Share of the largest moment that rounded or fitted ones of published robots miss.
_MAX_EXCESS = 0.05

_NUMBERS = ('mass', 'centre_x', 'centre_y', 'centre_z', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_MOMENTS = np.triu_indices(3)


class JointUnits(NamedTuple):
    """Units of a joint: of q and p, of its force, of its viscous friction, and of a rotor."""

    q: str
    p: str
    force: str
    damping: str
    rotor: str

    @classmethod
    def of(cls, kind: str) -> 'JointUnits':
        """Return the units of a kind of joint."""
        return cls('m', 'kg m/s', 'N', 'N s/m', 'kg') if kind == SLIDING else \
            cls('rad', 'kg m2/s', 'N m', 'N m s/rad', 'kg m2')


@dataclass(frozen=True, eq=False)
class Inertial:
    """
    Inertia of a link.

    Parameters
    ----------
    mass : float
        Mass [kg].
    centre : np.ndarray, shape (3,)
        Centre of mass in the frame of the link [m].
    moments : np.ndarray, shape (3, 3)
        Inertia about the centre of mass, in the axes of the link [kg m2].

    """

    mass: float
    centre: np.ndarray
    moments: np.ndarray

    @classmethod
    def of(cls, numbers: Sequence[float]) -> 'Inertial':
        """Return the inertia with these ``numbers``."""
        (mass, *centre), moments = numbers[:4], np.zeros((3, 3))
        moments[_MOMENTS] = moments[_MOMENTS[::-1]] = numbers[4:]
        return cls(mass, np.array(centre), moments)

    def numbers(self) -> list[float]:
        """Return mass, centre and moments in sequence, in the order of _NUMBERS."""
        return [self.mass, *self.centre, *self.moments[_MOMENTS]]

    @property
    def excess(self) -> float:
        """Return the share of the largest moment above the sum of the others, 0 if rounding."""
        low, middle, high = np.linalg.eigvalsh(self.moments)
        room = _ABSOLUTE_TOLERANCE + _RELATIVE_TOLERANCE * abs(high)
        return float((high - low - middle) / high) if high - low - middle > room else 0.0

    @property
    def fault(self) -> str:
        """Return the reason no body has this mass and these moments of inertia, '' if one has."""
        low, middle, high = np.linalg.eigvalsh(self.moments)
        room = _ABSOLUTE_TOLERANCE + _RELATIVE_TOLERANCE * abs(high)
        text = f'principal moments of inertia {low:g}, {middle:g}, {high:g} kg m2'
        if self.mass < 0.0:
            return f'mass = {self.mass:g} kg must not be negative'
        if low < -room:
            return f'{text}: must not be negative; see ixx to izz'
        if self.excess > _MAX_EXCESS:
            return (f'{text}: the largest must not exceed the sum of the others (triangle '
                    'inequality); see ixx to izz, and their unit')
        if self.mass == 0.0 and high > room:
            return f'{text} without mass; give the mass, or remove inertial'
        return ''


@dataclass(frozen=True)
class Limits:
    """
    Limits of a joint; None if not in the file.

    Parameters
    ----------
    lower, upper : float or None
        Limits of the coordinate [rad] or [m].
    velocity : float or None
        Velocity limit [rad/s] or [m/s].
    effort : float or None
        Effort limit [N m] or [N].

    """

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None


class Mimic(NamedTuple):
    """Rule of a joint: multiplier times the value of another joint, plus an offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """
    A joint between two links.

    Parameters
    ----------
    name : str
        Its name.
    kind : str
        The URDF's type, which may be missing in KINDS.
    place : str
        ``file:line: joint 'name'``, for errors.
    parent, child : str
        The links that it connects.
    origin : np.ndarray, shape (3,)
        Origin of the child in the frame of the parent [m], at coordinate zero.
    rotation : np.ndarray, shape (3, 3)
        Rotation of the child's frame from the parent's.
    axis : np.ndarray, shape (3,)
        Unit vector in the child's frame.
    limits : Limits
        Limits; like damping and friction they act only through an effect of a scene.
    damping : float
        Coefficient of the force -damping q' [N m s/rad] or [N s/m].
    friction : float
        Static friction [N m] or [N].
    mimic : Mimic or None
        The joint that this one follows.
    rotor : float
        Inertia of its rotor, reduced to the joint [kg m2] or [kg].

    """

    name: str
    kind: str
    place: str
    parent: str
    child: str
    origin: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray
    limits: Limits
    damping: float
    friction: float
    mimic: Mimic | None
    rotor: float = 0.0

    @property
    def units(self) -> JointUnits:
        """Return the units of the joint."""
        return JointUnits.of(self.kind)

    @property
    def moves(self) -> bool:
        """Return True if it has a coordinate."""
        return self.kind in (*TURNING, SLIDING)

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Return the limits of its coordinate, None where it has none."""
        lower, upper = self.limits.lower, self.limits.upper
        if self.kind == 'continuous' or (lower is None and upper is None):
            return None, None
        # A single missing limit is 0 in the format.
        return lower or 0.0, upper or 0.0


@dataclass(frozen=True, eq=False)
class Link:
    """
    A rigid body.

    Parameters
    ----------
    name : str
        Its name.
    place : str
        ``file:line: link 'name'``, for errors.
    inertial : Inertial or None
        Inertia; None for a massless link.
    joints : tuple of Joint
        Joints on it that carry other links.

    """

    name: str
    place: str
    inertial: Inertial | None
    joints: tuple[Joint, ...]


class Closure(NamedTuple):
    """
    An element of another dialect that closes a chain.

    Parameters
    ----------
    place : str
        ``file:line: element 'name'``, for errors.
    links : tuple of str
        The links at both ends; fewer if the element does not tell.
    loop : dict or None
        Arguments of a ClosingJoint; None if it is not one.

    """

    place: str
    links: tuple[str, ...]
    loop: dict[str, Any] | None


@dataclass(frozen=True, eq=False)
class Robot:
    """
    A tree of links.

    Parameters
    ----------
    name : str
        Name in the file.
    links : dict of str to Link
        Links by name.
    root : str
        The link that is not carried by a joint.
    where, text : str
        The file, and its text.
    locked : mapping of str to float
        Joints that do not move, and their values [rad], [m].
    followers : mapping of str to Mimic
        Joints that follow others, and the moving joint at the end of each chain of mimics.
    closures : tuple of Closure
        Elements that close chains.

    """

    name: str
    links: dict[str, Link]
    root: str
    where: str
    text: str
    locked: Mapping[str, float] = field(default_factory=dict)
    followers: Mapping[str, Mimic] = field(default_factory=dict)
    closures: tuple[Closure, ...] = ()

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Return all joints by name."""
        return {joint.name: joint for link in self.links.values() for joint in link.joints}

    def followed(self, joint: Joint, locked: Mapping[str, float]) -> Mimic:
        """
        Return the end of a joint's chain of mimics: a joint that is locked, or follows no other.

        Raises
        ------
        ModelError
            A joint of the chain follows itself, or one that cannot move.

        """
        multiplier, offset, chain = 1.0, 0.0, {joint.name}
        while joint.mimic is not None and joint.name not in locked:
            name, own, shift = joint.mimic
            multiplier, offset = multiplier * own, multiplier * shift + offset
            leader = self.joints.get(name)
            if leader is None or not leader.moves:
                valid = [other.name for other in self.joints.values() if other.moves]
                raise ModelError(f'{joint.place}: mimics {name[:80]!r}, which is not a movable '
                                 f'joint{did_you_mean(name[:80], valid)}; correct it, or lock the '
                                 f'joint with locked: {{{joint.name}: 0.0}}; movable joints: '
                                 f'{listed(valid)}')
            if name in chain:
                raise ModelError(f'{joint.place}: mimics {name!r}, which follows this joint: the '
                                 f'circle has no leader; remove a mimic, or lock the joint with '
                                 f'locked: {{{joint.name}: 0.0}}')
            chain.add(name)
            joint = leader
        return Mimic(joint.name, multiplier, offset)

    def driven(self, joints: Sequence[str], coordinates: Sequence[str]
               ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return G and c of the values G q + c of n joints, shapes (n, d) and (n,).

        Joints that neither are coordinates nor follow one have their locked value, or zero.
        """
        factors, offsets = np.zeros((len(joints), len(coordinates))), np.zeros(len(joints))
        columns = {name: column for column, name in enumerate(coordinates)}
        for row, name in enumerate(joints):
            leader, multiplier, offset = self.followers.get(name, Mimic(name, 1.0, 0.0))
            if leader in columns:
                factors[row, columns[leader]], offsets[row] = multiplier, offset
            else:
                offsets[row] = self.locked.get(name, 0.0)
        return factors, offsets

    def numbers(self) -> dict[str, float]:
        """Return mass, centre of mass and moments of each link, as ``forearm.centre_z``."""
        return {f'{name}.{key}': float(value) for name, link in self.links.items()
                if link.inertial is not None for key, value in zip(
                    _NUMBERS, link.inertial.numbers(), strict=True)}

    def with_numbers(self, numbers: Mapping[str, float]) -> 'Robot':
        """
        Return the robot with other values of some numbers.

        Raises
        ------
        ModelError
            A link with these numbers is physically impossible.

        """
        values, links = self.numbers() | dict(numbers), dict(self.links)
        for name in {place.rpartition('.')[0] for place in numbers}:
            inertial = Inertial.of([values[f'{name}.{key}'] for key in _NUMBERS])
            if inertial.fault:
                raise ModelError(f'{links[name].place}: {inertial.fault}')
            links[name] = replace(links[name], inertial=inertial)
        return replace(self, links=links)


@dataclass(frozen=True)
class JointCoordinate(Coordinate):
    """
    The coordinate of a joint.

    Parameters
    ----------
    joint : Joint
        Its description in the URDF, with the limits, damping and friction of its followers.

    """

    joint: Joint = field(kw_only=True, compare=False)
