# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot from a URDF: links and the joints between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Joints with one coordinate, and without.
TURNING, SLIDING, RIGID = ('revolute', 'continuous'), 'prismatic', 'fixed'
KINDS = (*TURNING, SLIDING, RIGID)
# Tolerance for rounded digits in a file: relative to the largest moment of inertia, and [kg m2].
_ROUNDING, _NOTHING = 1e-6, 1e-12

_NUMBERS = ('mass', 'centre_x', 'centre_y', 'centre_z', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_MOMENTS = np.triu_indices(3)


class Units(NamedTuple):
    """Units of a joint: of q and p, of its force, of its viscous friction, and of a rotor."""

    q: str
    p: str
    force: str
    damping: str
    rotor: str

    @classmethod
    def of(cls, kind: str) -> 'Units':
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
    def fault(self) -> str:
        """Return the reason no body has this mass and these moments of inertia, '' if one has."""
        low, middle, high = np.linalg.eigvalsh(self.moments)
        room = _NOTHING + _ROUNDING * abs(high)
        text = f'principal moments of inertia {low:g}, {middle:g}, {high:g} kg m2'
        if self.mass < 0.0:
            return f'mass = {self.mass:g} kg must not be negative'
        if low < -room:
            return f'{text}: none may be negative; see ixx to izz'
        if low + middle < high - room:
            return (f'{text}: no body has one that is more than the two others together (triangle '
                    'inequality); see ixx to izz, and their unit')
        if self.mass == 0.0 and high > room:
            return f'{text} without mass; give the mass, or leave inertial out'
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
    mimics : str or None
        The joint that this one follows.

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
    mimics: str | None

    @property
    def units(self) -> Units:
        """Return the units of the joint."""
        return Units.of(self.kind)

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

    """

    name: str
    links: dict[str, Link]
    root: str
    where: str
    text: str
    locked: Mapping[str, float] = field(default_factory=dict)

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
        Its description in the URDF.

    """

    joint: Joint = field(kw_only=True, compare=False)
