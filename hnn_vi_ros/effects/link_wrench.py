# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Wrenches on links of a robot, commanded while the simulation runs."""

from collections.abc import Callable, Sequence
from typing import Any, cast, NamedTuple

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.effects.commands import Command, Commanded, LARGEST, LINK_WRENCH, LinkWrench
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import (
    Bodies, check_positive, fill_frames, Following, Hamiltonian, TreeWork)
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Entries of the last wrench after force and torque: the point, the body, and 1 for axes of the
# body or 0 for those of the base.
_POINT, _BODY, _TURNS = 6, 9, 10


class WrenchParameters(NamedTuple):
    """
    Parameters of the compiled function of a wrench on a robot of n joints.

    Parameters
    ----------
    bodies, work
        The bodies (only their geometry is used) and workspace for one state.
    following : Following
        The values of all joints, computed from those that are coordinates.
    joints : np.ndarray, shape (n,)
        Workspace for these values.
    clock, expiry : np.ndarray
        See EffectState.
    held : np.ndarray, shape (11,)
        The last wrench: force [N], torque [N m], the point that it acts at in the frame of the
        body [m]; see _POINT.
    columns : np.ndarray of int64, shape (0,)
        Empty, since it drives no joint.

    """

    bodies: Bodies
    work: TreeWork
    following: Following
    joints: np.ndarray
    clock: np.ndarray
    expiry: np.ndarray
    held: np.ndarray
    columns: np.ndarray


class WrenchOnLinks(Force, Commanded):
    """
    The last commanded wrench F on a link of a robot, J(q)^T F, until its time-out.

    F is a force at the origin of the link and a torque, along the axes of the link or of the base.
    As that of `external_force`, a command acts in all steps that start before its time-out. For
    bodies that move freely use `external_force`. Energy account: J^T F . H_p.

    Parameters
    ----------
    timeout : float
        Duration of a command, > 0 [s]; afterwards no force acts.

    Raises
    ------
    ValueError
        The time-out is not positive, or H is not that of a URDF.

    """

    depends_on_momentum, single, takes = False, True, frozenset({LINK_WRENCH})

    def __init__(self, timeout: float = 0.5):
        check_positive(timeout=timeout)
        self.timeout = float(timeout)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> WrenchParameters:
        """Raise ValueError, since the coordinates alone do not tell where links are."""
        raise ValueError('a wrench on a link needs the H of a URDF; use external_force')

    def resolve_on(self, hamiltonian: Hamiltonian, state: EffectState) -> WrenchParameters:
        """Return the geometry of the robot, the clock and the wrench."""
        if hamiltonian.robot is None:
            return self.resolve(hamiltonian.coordinates, state)
        robot: Any = hamiltonian
        # The same for all copies of a robot.
        self._base, self._links = robot.base_link, robot.links
        bodies, n = robot.bodies, len(robot.bodies.parent) - 1
        following = robot.following or Following(np.arange(n), np.ones(n), np.zeros(n))
        return WrenchParameters(bodies, TreeWork.empty(n), following, np.zeros(n), state.clock,
                                state.expiry, np.zeros(11), np.zeros(0, dtype=np.int64))

    def changing(self, parameters: WrenchParameters) -> dict[str, np.ndarray]:
        """Return the wrench and its expiry time."""
        return {'wrench.held': parameters.held, 'wrench.expiry': parameters.expiry}

    def prepare(self, command: Command, parameters: WrenchParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return a function that sets the wrench."""
        frame, force, torque = cast(LinkWrench, command)
        frame = str(frame)
        link = frame if frame in self._links else frame.removeprefix(f'{self._base}/')
        body, rotation, origin = self._links.get(link, (0, np.eye(3), np.zeros(3)))
        if not body:
            valid = listed(name for name, (row, *_) in self._links.items() if row)
            raise ValueError(f'frame_id = {frame[:80]!r}: expected a moving link for its own '
                             f'axes, or {self._base}/LINK for those of the base; links: {valid}')
        try:
            parts = np.array([force, torque], dtype=np.float64)
        except (TypeError, ValueError):
            parts = np.zeros(0)
        if parts.shape != (2, 3) or not (np.abs(parts) <= LARGEST).all():
            raise ValueError(f'wrench {[force, torque]!s:.80}: expected a force and a torque, of '
                             f'three finite numbers each, at most {LARGEST:g}')
        if link == frame:
            parts = parts @ rotation.T

        def put() -> None:
            parameters.held[:] = *parts.ravel(), *origin, body, link == frame
            parameters.expiry[0] = parameters.clock[0] + self.timeout
        return put

    @staticmethod
    @inlined
    def add_force(parameters: WrenchParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add J^T F if the wrench is active at the start of the step."""
        own, held = parameters, parameters.held
        if not own.clock[0] < own.expiry[0]:
            return
        follow = own.following
        for j in range(own.joints.size):
            own.joints[j] = follow.multiplier[j] * q[follow.leader[j]] + follow.offset[j]
        fill_frames(own.bodies, own.work, own.joints, 0)
        offset, axis, i = own.work.offset, own.work.axis, int(held[_BODY])
        wrench, point = own.work.spare[i], own.work.impulse[i]
        for c in range(3):
            wrench[c], wrench[3 + c], point[c] = 0.0, 0.0, 0.0
            for k in range(3):
                entry = own.work.rotation[i, 3 * c + k]
                turned = entry if held[_TURNS] == 1.0 else (1.0 if c == k else 0.0)
                wrench[c] += turned * held[3 + k]
                wrench[3 + c] += turned * held[k]
                point[c] += entry * held[_POINT + k]
        x, y, z = point[0], point[1], point[2]
        u, v, w = wrench[3], wrench[4], wrench[5]
        while i > 0:
            # The moment about the origin of the body; first from the point, then from its child.
            wrench[0] += y * w - z * v
            wrench[1] += z * u - x * w
            wrench[2] += x * v - y * u
            power = 0.0
            for c in range(6):
                power += axis[i, c] * wrench[c]
            j = own.bodies.coordinate[i]
            f_p[follow.leader[j]] += follow.multiplier[j] * power
            x, y, z = offset[i, 0], offset[i, 1], offset[i, 2]
            i = own.bodies.parent[i]
