# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction in joints."""

from collections.abc import Sequence
import math
from typing import Literal, NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Force, motor_index
from hnn_vi_ros.effects.joints import check_joint_numbers, joint_numbers
from hnn_vi_ros.hamiltonians import check_not_negative, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class JointFrictionParameters(NamedTuple):
    """b, F, k and columns of motors, (d,), the speed u, and command and clock of EffectState."""

    damping: np.ndarray
    friction: np.ndarray
    load: np.ndarray
    motors: np.ndarray
    speed: float
    command: np.ndarray
    clock: np.ndarray


class JointFriction(Force):
    """
    Viscous and dry friction in joints, f = -b v - (F + k abs(a)) tanh(v / u), v = H_p of each.

    A URDF calls b damping and F friction. Well above the speed u, dry friction has the constant
    magnitude F; below, it is viscous with F / u, so that a loaded joint creeps instead of
    sticking. In a gear it increases with the load: the command a of external_force for this
    coordinate, without its gain, passes through its teeth. Hamon et al. use the output force of
    the gear, a minus friction and rotor inertia, which is implicit; both agree to first order in
    k. For fitted friction use `learned_friction`. Energy account: the power f . v <= 0.

    Parameters
    ----------
    from_ : str, optional
        urdf: damping and friction of all joints in the URDF of H.
    damping : dict of str to float, optional
        b >= 0 by coordinate, added to the URDF's or replacing them [N m s/rad], [N s/m].
    friction : dict of str to float, optional
        F >= 0, likewise [N m], [N].
    load : dict of str to float, optional
        k >= 0 by coordinate [1].
    speed : float
        u > 0 [rad/s], [m/s]; steps h should resolve m u / F for a joint with the inertia m.

    Raises
    ------
    ValueError
        No friction is given, or a number is negative or not finite.

    References
    ----------
    E. Pennestrì et al., Review and comparison of dry friction force models, Nonlinear Dynamics
    83 (2016), section 2.2. P. Hamon, M. Gautier, P. Garrec, Dynamic identification of robots
    with a dry friction model depending on load and velocity, IROS 2010.

    """

    depends_on_momentum = passive = True

    def __init__(self, from_: Literal['urdf'] | None = None,
                 damping: dict[str, float] | None = None,
                 friction: dict[str, float] | None = None, speed: float = 0.01,
                 load: dict[str, float] | None = None):
        check_joint_numbers(from_, check_not_negative, damping=damping, friction=friction,
                            load=load)
        check_positive(speed=speed)
        self.source, self.speed = from_, float(speed)
        self.damping, self.friction, self.load = damping, friction, load
        self.feels_command = bool(load)
        self.by_motors = False if load else None

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> JointFrictionParameters:
        """Return b, F and k of each coordinate, u, and the command."""
        damping, friction, load = (np.nan_to_num(joint_numbers(
            coordinates, self.source, of, given)) for of, given in (
                (lambda joint: joint.damping, self.damping),
                (lambda joint: joint.friction, self.friction), (lambda joint: None, self.load)))
        if not (damping.any() or friction.any() or load.any()):
            raise ValueError('no joint has damping or friction; give them, or remove the effect')
        motors = np.arange(load.size)
        for name in self.load or ():
            motors[coordinate_index(coordinates, name)] = motor_index(coordinates, name)
        return JointFrictionParameters(
            damping, friction, load, motors, self.speed, state.command, state.clock)

    def joints(self, parameters: JointFrictionParameters) -> np.ndarray:
        """Return the columns of the joints with friction."""
        own = parameters
        return np.flatnonzero(own.damping + own.friction + own.load)

    @staticmethod
    @inlined
    def add_force(own: JointFrictionParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add -b v - (F + k abs(a)) tanh(v / u)."""
        acts = own.clock[0] < own.command[own.command.size - 1]
        for i in range(own.damping.size):
            v, load = velocity[i], abs(own.command[own.motors[i]]) if acts else 0.0
            f_p[i] -= own.damping[i] * v + (
                own.friction[i] + own.load[i] * load) * math.tanh(v / own.speed)
