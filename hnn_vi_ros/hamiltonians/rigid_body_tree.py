# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A robot of rigid bodies that a URDF describes."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.rigid_body.robot import (
    Joint, JointCoordinate, Robot, SLIDING)
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import (
    Bodies, compose, displace, force_change_of, force_of, move, place, solve_rate_changes,
    solve_rates, TreeParameters, Work)
from hnn_vi_ros.hamiltonians.rigid_body.tree import mass_matrix, tree_of
from hnn_vi_ros.hamiltonians.rigid_body.urdf import read_urdf
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np


class RigidBodyTree(Hamiltonian):
    """
    A robot that a URDF describes, H = p . M(q)^-1 p / 2 + V(q).

    Up to 12 joints move, revolute, continuous or prismatic; their names are those of the
    coordinates. M is that of the links and of rotors; V = -sum of m g . c over the links that
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
        self.bodies, self.joints = tree_of(
            self.robot, joints, self.robot.locked, gravity, base or self.robot.root,
            rotor_inertia or {})
        self.coordinates = tuple(_coordinate(joint) for joint in self.joints)

    @property
    def provenance(self) -> dict[str, str]:
        """Return the name that the file gives the robot."""
        return {'robot': self.robot.name}

    def masses(self, q: np.ndarray) -> np.ndarray:
        """Return M(q), shape (m, d, d), for q of shape (m, d)."""
        return np.array([mass_matrix(self.bodies, one) for one in q])

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        return tree_kernel(self.bodies)


def tree_kernel(bodies: Bodies) -> Kernel:
    """Return the functions of H of some bodies, with working memory of their own."""
    d = len(bodies.parent) - 1
    # A bound of the moments of the weights: their sum times how far they may be away.
    reach = np.zeros(d + 1)
    for i in range(1, d + 1):
        reach[i] = reach[bodies.parent[i]] + np.linalg.norm(bodies.placement[i, 9:])
    weights = (bodies.inertia[1:, 0] * reach[1:]
               + np.linalg.norm(bodies.inertia[1:, 1:4], axis=1))
    scale = float(np.linalg.norm(bodies.gravity) * weights.sum())
    kernel = compiled_kernel((_energy, _gradient, _hessian_vector),
                             TreeParameters(bodies, Work.empty(d)), d, (scale, 0.0))
    return kernel._replace(energy_scale=scale)


def extended_gradient(bodies: Bodies, q: np.ndarray, p: np.ndarray
                      ) -> tuple[np.ndarray, np.ndarray]:
    """Return H_q and H_p, of q and p of shape (m, d), in extended precision."""
    d = q.shape[1]
    parameters = TreeParameters(bodies, Work.empty(d, np.longdouble))
    slopes = np.empty((2, q.size), np.longdouble)
    _gradient(parameters, q.astype(np.longdouble).ravel(), p.astype(np.longdouble).ravel(),
              *slopes)
    return slopes[0].reshape(-1, d), slopes[1].reshape(-1, d)


def _coordinate(joint: Joint) -> JointCoordinate:
    units = ('m', 'kg m/s') if joint.kind == SLIDING else ('rad', 'kg m2/s')
    return JointCoordinate(joint.name, *units, joint=joint)


@inlined
def _arrange(parameters: TreeParameters, q: np.ndarray, p: np.ndarray, start: int) -> None:
    """Fill the work for the state that starts there, up to the rates of the joints."""
    bodies, work = parameters.bodies, parameters.work
    place(bodies, work, q, start)
    compose(bodies, work)
    solve_rates(bodies, work, p, start)


def _energy(parameters: TreeParameters, q: np.ndarray, p: np.ndarray) -> float:
    bodies, work = parameters.bodies, parameters.work
    _arrange(parameters, q, p, 0)
    first, gravity = work.composite, bodies.gravity
    energy = -(first[0, 1] * gravity[0] + first[0, 2] * gravity[1] + first[0, 3] * gravity[2])
    for i in range(p.size):
        at = bodies.coordinate[i + 1]
        energy += 0.5 * p[at] * work.rates[i] + bodies.load[i + 1] * q[at]
    return energy


def _gradient(parameters: TreeParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    bodies, work = parameters.bodies, parameters.work
    for start in range(0, q.size, work.rates.size):
        _arrange(parameters, q, p, start)
        move(bodies, work)
        for i in range(1, bodies.parent.size):
            at = start + bodies.coordinate[i]
            dH_dq[at], dH_dp[at] = force_of(bodies, work, i), work.rates[i - 1]


def _hessian_vector(parameters: TreeParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    bodies, work = parameters.bodies, parameters.work
    for start in range(0, q.size, work.rates.size):
        _arrange(parameters, q, p, start)
        move(bodies, work)
        displace(bodies, work, v_q, start)
        solve_rate_changes(bodies, work, v_p, start)
        for i in range(1, bodies.parent.size):
            at = start + bodies.coordinate[i]
            product_q[at] = force_change_of(bodies, work, i)
            product_p[at] = work.rates_v[i - 1]
