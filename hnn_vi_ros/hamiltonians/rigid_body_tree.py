# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot of rigid bodies from a URDF."""

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
    A robot from a URDF, H = p . M(q)^-1 p / 2 + V(q).

    Up to 12 joints move, revolute, continuous or prismatic; their names are the names of the
    coordinates. M includes the links and the rotors; V = -sum of m g . c over the moving links,
    with centres of mass c relative to the origin of the base. Limits, damping and friction of the
    URDF act only if a scene lists the effects `joint_limits` and `joint_friction`.

    Parameters
    ----------
    file : str
        The URDF: a path, relative to the folder of the scene or else the working directory, or
        package://PACKAGE/PATH in an installed ROS package; meshes are not read.
    joints : list of str, optional
        The moving joints, in the order of the coordinates; by default all that are not locked,
        from the base to the tips.
    locked : dict of str to float, optional
        Joints that do not move, and their values [rad], [m].
    gravity : sequence of float
        Acceleration of gravity, three numbers in the frame of the base [m/s^2].
    base : str, optional
        The fixed link; links that are not behind it are ignored. Default: the root of the tree.
    rotor_inertia : dict of str to float, optional
        Inertias of the rotors behind joints, reduced to the joint, that is multiplied by the
        square of the gear ratio [kg m2], [kg].

    Raises
    ------
    ModelError
        The file cannot be read, or its robot cannot be simulated.
    ValueError
        An argument is invalid.

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
        """Return the functions for simulations."""
        return tree_kernel(self.bodies)


def _coordinate(joint: Joint) -> JointCoordinate:
    return JointCoordinate(joint.name, joint.units.q, joint.units.p, joint=joint)
