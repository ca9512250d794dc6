# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction in joints."""

from collections.abc import Sequence
import math
from typing import Literal, NamedTuple

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.effects.joints import check_given, joint_numbers
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class JointFrictionParameters(NamedTuple):
    """The viscous coefficients b and the forces F, each of shape (d,), and the speed u."""

    damping: np.ndarray
    friction: np.ndarray
    speed: float


class JointFriction(Force):
    """
    Viscous and dry friction in joints, f = -b v - F tanh(v / u), where v = H_p of each.

    A URDF calls b damping and F friction. Well above the speed u dry friction has the constant
    size F; below, it is viscous with F / u, so that a joint under load creeps instead of
    sticking. Energy account: the power f . v <= 0.

    Parameters
    ----------
    from_ : str, optional
        urdf: damping and friction of all joints in the URDF of H.
    damping : dict of str to float, optional
        b >= 0 by coordinate, in addition to the URDF's or replacing them [N m s/rad], [N s/m].
    friction : dict of str to float, optional
        F >= 0, likewise [N m], [N].
    speed : float
        u > 0 [rad/s], [m/s]; steps h should resolve m u / F for a joint with the inertia m.

    Raises
    ------
    ValueError
        There is no friction, or a number is negative or not finite.

    References
    ----------
    E. Pennestrì et al., Review and comparison of dry friction force models, Nonlinear Dynamics
    83 (2016), section 2.2.

    """

    depends_on_momentum = True

    def __init__(self, from_: Literal['urdf'] | None = None,
                 damping: dict[str, float] | None = None,
                 friction: dict[str, float] | None = None, speed: float = 0.01):
        check_given(from_, damping=damping, friction=friction)
        check_positive(speed=speed)
        for name, values in (('damping', damping), ('friction', friction)):
            for joint, value in (values or {}).items():
                if value < 0.0:
                    raise ValueError(f'{name} of {joint} = {value} must not be negative')
        self.source, self.speed = from_, float(speed)
        self.damping, self.friction = damping, friction

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> JointFrictionParameters:
        """Return b and F of each coordinate, and u."""
        damping = joint_numbers(
            coordinates, self.source, lambda joint: joint.damping, self.damping)
        friction = joint_numbers(
            coordinates, self.source, lambda joint: joint.friction, self.friction)
        if not (np.nan_to_num(damping).any() or np.nan_to_num(friction).any()):
            raise ValueError(
                'no joint has damping or friction; give them, or leave the effect out')
        return JointFrictionParameters(
            np.nan_to_num(damping), np.nan_to_num(friction), self.speed)

    @staticmethod
    @inlined
    def add_force(own: JointFrictionParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add -b v - F tanh(v / u)."""
        for i in range(own.damping.size):
            v = velocity[i]
            f_p[i] -= own.damping[i] * v + own.friction[i] * math.tanh(v / own.speed)
