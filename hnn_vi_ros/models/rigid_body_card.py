# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A robot in a model card: its tree of bodies, and its identified parameters.

A body consists of all links that are rigidly connected behind a moving joint. Its parameters are
given in the frame of the link on the joint, with origin on the joint: mass m, first moment h = m
c, moments of inertia about that origin, inertia of the rotor behind the joint, and a constant
offset of the motor's force. M and V are linear in all of them.
"""

from collections.abc import Mapping
from typing import Annotated

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import (
    Bodies, frame_of, Joint, JointUnits, MOST_JOINTS, SLIDING, TURNING)
import numpy as np
from pydantic import Field

RIGID_BODY = 'rigid_body'
_INERTIAL = ('mass', 'first_x', 'first_y', 'first_z', 'inertia_xx', 'inertia_xy', 'inertia_yy',
             'inertia_xz', 'inertia_yz', 'inertia_zz')
INERTIAL = len(_INERTIAL)
# Parameters of each body and its joint.
EACH = INERTIAL + 2
# Rounding of zero, relative to the largest eigenvalue of a pseudo-inertia.
_ZERO_TOLERANCE = 1e-9

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class BodyCard(StrictModel):
    """A body of a tree, and its joint to the parent."""

    link: str = Field(min_length=1, max_length=200)
    joint: str = Field(min_length=1, max_length=200)
    parent: int = Field(ge=0, description='0 for the base, k for the k-th body')
    coordinate: int = Field(ge=0, description='index of the coordinate of the joint')
    prismatic: bool
    axis: Vector = Field(description='axis of the joint, a unit vector in the frame of the link')
    rotation: list[Vector] = Field(min_length=3, max_length=3, description=(
        'rotation of the frame of the link in that of its parent where the coordinate is zero'))
    origin: Vector = Field(description='origin of the link in the frame of its parent there [m]')

    def _check(self) -> None:
        turn = np.array(self.rotation)
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or not np.linalg.det(turn) > 0.0:
            raise ValueError(f'rotation of {self.link} is not a rotation matrix')
        if abs(float(np.linalg.norm(self.axis)) - 1.0) > 1e-6:
            raise ValueError(f'axis of {self.joint} is not a unit vector')


class TreeCard(StrictModel):
    """Bodies, each after its parent, and gravity."""

    robot: str = Field('', max_length=200, description='name of the robot in the URDF')
    bodies: list[BodyCard] = Field(min_length=1, max_length=MOST_JOINTS)
    gravity: Vector = Field(description='gravity in the frame of the base [m/s2]')

    def _check(self) -> None:
        for row, body in enumerate(self.bodies):
            if body.parent > row:
                raise ValueError(f'{body.link} has parent {body.parent}, which must precede it')
        if sorted(body.coordinate for body in self.bodies) != [*range(len(self.bodies))]:
            raise ValueError('each joint must have its own coordinate')

    @property
    def units(self) -> dict[str, str]:
        """Return the parameters of all bodies in sequence, with their units."""
        found: dict[str, str] = {}
        for body in self.bodies:
            own = JointUnits.of(SLIDING if body.prismatic else TURNING[0])
            units = 'kg', *3 * ('kg m',), *6 * ('kg m2',)
            found |= {f'{body.link}.{name}': unit
                      for name, unit in zip(_INERTIAL, units, strict=True)}
            found |= {f'{body.joint}.rotor_inertia': own.rotor, f'{body.joint}.offset': own.force}
        return found


class BaseParameter(StrictModel):
    """A linear combination of parameters that the motions determine uniquely."""

    combination: dict[str, float] = Field(description='factors of parameters')
    value: float
    standard_error: float = Field(ge=0.0, description=(
        'from the residuals, in blocks because of their autocorrelation'))
    unit: str = Field(max_length=32)


class Identification(StrictModel):
    """Information of the data on the parameters of a robot."""

    base_parameters: list[BaseParameter]
    weak: list[BaseParameter] = Field([], description=(
        'others, which the data determine less well than the URDF: they are close to it'))
    held: list[dict[str, float]] = Field(description=(
        'directions, as factors of parameters, that the data do not determine: they have the '
        'values of the URDF'))
    force_error: list[float] = Field(description=(
        'squared error of the force over its variance, for each coordinate, on held-out data'))
    residual_share: list[float] | None = Field(None, description=(
        'root mean square of the force of the networks over that of the force, for each '
        'coordinate, on held-out data'))


def tree_card(bodies: Bodies, joints: Mapping[int, Joint], robot: str) -> TreeCard:
    """
    Return the tree of bodies.

    Parameters
    ----------
    bodies : Bodies
        Bodies of a robot.
    joints : mapping of int to Joint
        Joints by coordinate.
    robot : str
        Name of the robot.

    """
    frames = [np.eye(3)]
    found = []
    for i in range(1, len(bodies.parent)):
        parent, coordinate = int(bodies.parent[i]), int(bodies.coordinate[i])
        joint = joints[coordinate]
        frames.append(frame_of(joint.axis))
        rotation, origin = bodies.placement[i, :9].reshape(3, 3), bodies.placement[i, 9:]
        found.append(BodyCard(
            link=joint.child, joint=joint.name, parent=parent, coordinate=coordinate,
            prismatic=bool(bodies.prismatic[i]), axis=joint.axis.tolist(),
            rotation=(frames[parent] @ rotation @ frames[i].T).tolist(),
            origin=(frames[parent] @ origin).tolist()))
    return TreeCard(robot=robot, bodies=found, gravity=bodies.gravity.tolist())


def values_of(tree: TreeCard, bodies: Bodies) -> np.ndarray:
    """Return the parameters of bodies, shape (d, 12), with zero offsets."""
    found = np.zeros((len(tree.bodies), EACH))
    for i, (row, body) in enumerate(zip(found, tree.bodies, strict=True), start=1):
        row[:INERTIAL] = rotated_inertia(bodies.inertia[i], frame_of(np.array(body.axis)))
        row[INERTIAL] = bodies.armature[i]
    return found


def bodies_of(tree: TreeCard, values: np.ndarray) -> Bodies:
    """Return the bodies of a tree with parameters of shape (d, 12)."""
    frames = [np.eye(3), *(frame_of(np.array(body.axis)) for body in tree.bodies)]
    placement, inertia = [np.r_[np.eye(3).ravel(), np.zeros(3)]], [np.zeros(INERTIAL)]
    for body, own, row in zip(tree.bodies, frames[1:], values, strict=True):
        rotation = frames[body.parent].T @ np.array(body.rotation) @ own
        placement.append(np.r_[rotation.ravel(), frames[body.parent].T @ body.origin])
        inertia.append(rotated_inertia(row[:INERTIAL], own.T))
    return Bodies(
        np.array([0, *(body.parent for body in tree.bodies)]),
        np.array([0, *(body.coordinate for body in tree.bodies)]),
        np.array([0, *(int(body.prismatic) for body in tree.bodies)]), np.array(placement),
        np.array(inertia), np.r_[0.0, values[:, INERTIAL]], np.array(tree.gravity),
        np.r_[0.0, values[:, INERTIAL + 1]])


def rotated_inertia(inertial: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return mass, first moment and moments of inertia, shape (10,), in rotated axes."""
    second = rotation @ symmetric(inertial[4:]) @ rotation.T
    return np.r_[inertial[0], rotation @ inertial[1:4], second[np.tril_indices(3)]]


def symmetric(entries: np.ndarray) -> np.ndarray:
    """Return the symmetric matrix with entries xx, xy, yy, xz, yz, zz."""
    matrix = np.empty((3, 3))
    matrix[np.tril_indices(3)] = entries
    matrix.T[np.tril_indices(3)] = entries
    return matrix


def pseudo_inertia(inertial: np.ndarray) -> np.ndarray:
    """
    Return the second moments of the mass distribution, shape (4, 4), from (m, h, I).

    The matrix is positive semidefinite if, and only if, a body with these moments exists (P.
    Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and Automation Letters 3, 2018).
    """
    second = symmetric(inertial[4:])
    found = np.empty((4, 4))
    found[:3, :3] = 0.5 * np.trace(second) * np.eye(3) - second
    found[:3, 3] = found[3, :3] = inertial[1:4]
    found[3, 3] = inertial[0]
    return found


def check_values(tree: TreeCard, values: np.ndarray) -> None:
    """Raise ValueError for parameters that are physically impossible."""
    for body, row in zip(tree.bodies, values, strict=True):
        eigenvalues = np.linalg.eigvalsh(pseudo_inertia(row[:INERTIAL]))
        if not eigenvalues[0] >= -_ZERO_TOLERANCE * abs(eigenvalues[-1]):
            raise ValueError(f'mass and moments of {body.link} are physically impossible')
        if not row[INERTIAL] >= 0.0:
            raise ValueError(f'rotor_inertia of {body.joint} must not be negative')
