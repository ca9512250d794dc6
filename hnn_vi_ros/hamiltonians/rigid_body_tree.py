# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot of rigid bodies that a URDF describes."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.rigid_body.robot import Joint, JointCoordinate, Robot
from hnn_vi_ros.hamiltonians.rigid_body.tree import mass_matrix, tree_of
from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import tree_kernel
from hnn_vi_ros.hamiltonians.rigid_body.urdf import read_urdf
from hnn_vi_ros.kernels import Kernel
import numpy as np


class RigidBodyTree(Hamiltonian):
    """
    A robot that a URDF describes, H = p . M(q)^-1 p / 2 + V(q).

    Up to 12 joints move, revolute, continuous or prismatic; they name the coordinates. M covers
    the links and the rotors; V = -sum of m g . c over the links that
    move, with centres of mass c from the origin of the base. Nothing else acts: limits, damping
    and friction of the URDF do where a scene lists effects for them.

    Parameters
    ----------
    file : str
        The URDF: a path, from the folder of the scene or else the working directory, or
        package://PACKAGE/PATH in an installed ROS package; what its meshes are is not read.
    joints : list of str, optional
        The joints that move, in the order of the coordinates; default: all that are not locked,
        from the base to the tips.
    locked : dict of str to float, optional
        Joints that do not move, and where they are held [rad], [m].
    gravity : sequence of float
        The acceleration of free fall, three numbers in the frame of the base [m/s^2].
    base : str, optional
        The link that rests; what is not behind it is left out. Default: the root of the tree.
    rotor_inertia : dict of str to float, optional
        Inertia of the rotors behind joints as the joints feel it, that is times the square of the
        gear ratio [kg m2], [kg].

    Raises
    ------
    ModelError
        The file cannot be read, or describes what cannot be simulated.
    ValueError
        An argument that cannot be used.

    """

    separable = False
    robot: Robot

    def __init__(self, file: str, joints: list[str] | None = None,
                 locked: dict[str, float] | None = None,
                 gravity: Sequence[float] = (0.0, 0.0, -9.81), base: str | None = None,
                 rotor_inertia: dict[str, float] | None = None):
        self.robot = replace(read_urdf(Path(file)), locked=locked or {})
        self.provenance = {'robot': self.robot.name}
        self._arguments = (joints, self.robot.locked, gravity, base or self.robot.root,
                           rotor_inertia or {})
        self.bodies, self.joints = tree_of(self.robot, *self._arguments)
        self.coordinates = tuple(_coordinate(joint) for joint in self.joints)

    def with_numbers(self, numbers: Mapping[str, float]) -> 'RigidBodyTree':
        """Return H with other numbers of links; see ``Robot.with_numbers``."""
        other = copy(self)
        other.__dict__.pop('kernel', None)
        other.robot = self.robot.with_numbers(numbers)
        other.bodies, other.joints = tree_of(other.robot, *self._arguments)
        return other

    def masses(self, q: np.ndarray) -> np.ndarray:
        """Return M(q), shape (m, d, d), for q of shape (m, d)."""
        return np.array([mass_matrix(self.bodies, one) for one in q])

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return tree_kernel(self.bodies)


def _coordinate(joint: Joint) -> JointCoordinate:
    return JointCoordinate(joint.name, joint.units.q, joint.units.p, joint=joint)
