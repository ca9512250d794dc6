# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot of rigid bodies from a URDF."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.rigid_body.closures import loops_in
from hnn_vi_ros.hamiltonians.rigid_body.gears import drives_of, ElasticDrive, with_rotors
from hnn_vi_ros.hamiltonians.rigid_body.loops import ClosingJoint, loops_of
from hnn_vi_ros.hamiltonians.rigid_body.payload import Carrier, Payload
from hnn_vi_ros.hamiltonians.rigid_body.robot import JointCoordinate, Robot
from hnn_vi_ros.hamiltonians.rigid_body.tree import links_of, mass_matrix, tree_of
from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import tree_kernel
from hnn_vi_ros.hamiltonians.rigid_body.urdf import read_urdf
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import Coordinate, Follower, rotor_name
import numpy as np


class RigidBodyTree(Hamiltonian):
    """
    A robot from a URDF, H = p . M(q)^-1 p / 2 + V(q).

    Up to 12 joints move, revolute, continuous or prismatic; their names are the names of the
    coordinates. M includes the links and the rotors; V = -sum of m g . c over the moving links,
    with centres of mass c relative to the origin of the base. Limits, damping and friction of the
    URDF act only if a scene lists the effects `joint_limits` and `joint_friction`. Joints that
    `mimic` others have no coordinate: their inertia, limits and friction act on their leader.

    Parameters
    ----------
    file : str
        The URDF: a path, relative to the folder of the scene or else the working directory, or
        package://PACKAGE/PATH in an installed ROS package; meshes are not read.
    joints : list of str, optional
        The moving joints, in the order of the coordinates; by default all that are not locked
        and mimic no other, from the base to the tips.
    locked : dict of str to float, optional
        Joints that do not move, and their values [rad], [m]; joints that mimic them do not move
        either.
    gravity : sequence of float
        Acceleration of gravity, three numbers in the frame of the base [m/s^2].
    base : str, optional
        The fixed link; links that are not behind it are ignored. Default: the root of the tree.
    rotor_inertia : dict of str to float, optional
        Inertias of the rotors behind joints, reduced to the joint, that is multiplied by the
        square of the gear ratio; by default those of `drake:rotor_inertia` in the URDF [kg m2],
        [kg].
    loops : list of ClosingJoint, optional
        Joints that close chains of the tree, kept with RATTLE; by default those of `loop_joint`,
        `drake:ball_constraint`, and `joint` in `gazebo` of the URDF, and [] for none.
    assemble : bool
        Move any initial state onto the loops; by default one that is more than 1e-3 away (of a
        coordinate, or of the largest velocity) is refused.
    drives : dict of str to ElasticDrive, optional
        Motors that move joints through elastic gears. The rotor of a joint `elbow` is the
        coordinate `elbow_motor`, after those of the joints: its angle on the side of the joint.
        Commands to the joint act on it.
    payload : Payload, optional
        A rigid body that a link carries; commands can change it during a run, at constant
        velocities, also from none (mass: 0.0).

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
                 rotor_inertia: dict[str, float] | None = None,
                 loops: list[ClosingJoint] | None = None, assemble: bool = False,
                 drives: dict[str, ElasticDrive] | None = None,
                 payload: Payload | None = None):
        robot = read_urdf(Path(file))
        self.provenance = {'robot': robot.name}
        self._arguments = (joints, locked or {}, gravity, base or robot.root, rotor_inertia or {})
        self._drives: dict[str, ElasticDrive] = {}
        if payload:
            self.carrier = Carrier(payload, robot, locked or {}, base or robot.root)
        self._build(robot)
        links = tuple(JointCoordinate(
            joint.name, joint.units.q, joint.units.p, joint=joint, followers=tuple(
                Follower(name, *mimic[1:]) for name, mimic in self.robot.followers.items()
                if mimic.joint == joint.name)) for joint in self.joints)
        if drives:
            self._drives = drives_of(drives, [joint.name for joint in self.joints])
            self._build(robot)
        units = {link.name: (link.q_unit, link.p_unit) for link in links}
        self.coordinates = (*links, *(Coordinate(rotor_name(name), *units[name], rotor_of=name)
                                      for name in self._drives))
        links_at = self.links if loops or robot.closures else {}
        if loops is None:
            rows = {name: row for name, (row, *_) in links_at.items()}
            loops = loops_in(robot, rows, self.bodies, self.following)
        if loops and drives:
            raise ValueError('loops and drives are not supported together yet; remove one')
        if loops:
            self.loops = loops_of(loops, self.bodies, self.following, links_at, assemble)

    def _build(self, robot: Robot) -> None:
        self.robot, self.bodies, self.joints, self.following = tree_of(robot, *self._arguments)
        if self._drives:
            self.bodies, self.following = with_rotors(
                self.bodies, self.following, [*self._drives.values()], len(self.joints))
        if self.carrier is not None:
            self.bodies = self.carrier.mount(self.bodies)

    def copy(self) -> 'RigidBodyTree':
        """Return the same robot with its own workspace, and with a payload of its own."""
        other = super().copy()
        if self.carrier is not None:
            other.bodies = self.bodies._replace(inertia=self.bodies.inertia.copy())
        return other

    @property
    def base_link(self) -> str:
        """Return the name of the fixed link."""
        return self._arguments[3]

    @property
    def links(self) -> dict[str, tuple[int, np.ndarray, np.ndarray]]:
        """Return the body of each link, and the pose of its frame in that of the body."""
        return links_of(self.robot, self.robot.locked, self.base_link)

    def payload_numbers(self, payload: Payload) -> np.ndarray:
        """Return the inertia of a payload on its body; ValueError if it is impossible."""
        assert self.carrier is not None, 'only a robot with a payload takes others'
        return self.carrier.numbers(payload)

    def change_payload(self, numbers: np.ndarray | None = None) -> None:
        """Replace the payload by one of these numbers, by default by that of the scene."""
        assert self.carrier is not None, 'only a robot with a payload takes others'
        self.carrier.change(self.bodies, numbers)

    def with_numbers(self, numbers: Mapping[str, float]) -> 'RigidBodyTree':
        """Return H with other numbers of links; see ``Robot.with_numbers``."""
        other = self.copy()
        other._build(self.robot.with_numbers(numbers))
        return other

    def gravity_model(self, kind: str, file: str | None) -> 'RigidBodyTree':
        """Return a robot without drives: this one, it without payload, or that of a URDF."""
        if self.loops is not None:
            raise ValueError('gravity_compensation does not support robots with loops; remove it')
        if file is not None:
            _, locked, gravity, base, rotors = self._arguments
            return RigidBodyTree(file, [joint.name for joint in self.joints], locked, gravity,
                                 base, rotors, loops=[])
        other = self.copy()
        other._drives, other.carrier = {}, None
        other._build(self.robot)
        other.coordinates = self.coordinates[:len(self.joints)]
        if kind == 'model' and self.carrier is not None:
            # The same memory, which changes of the payload write to.
            other.carrier = self.carrier
            other.bodies = other.bodies._replace(
                inertia=self.bodies.inertia[:len(other.bodies.parent)])
        return other

    def masses(self, q: np.ndarray) -> np.ndarray:
        """Return M(q), shape (m, d, d), for q of shape (m, d)."""
        return np.array([mass_matrix(self.bodies, one, self.following) for one in q])

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        return tree_kernel(self.bodies, self.following, self.carrier is None)
