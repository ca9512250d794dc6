# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Elastic gears with backlash between rotors and joints; the scene lists them as ``drives``.

With the twist s = theta - q of the angles of a rotor, on the side of its joint, and of the joint,

    U(s) = k (f(s - b)^2 + f(-s - b)^2) / 2,   f(x) = max(x, 0)  or  w log(1 + exp(x / w))

with half the backlash b. Without backlash, U = k s^2 / 2.
"""

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, Effect, EffectState, Force, Potential
from hnn_vi_ros.hamiltonians import ElasticDrive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate, rotor_name
import numpy as np


class GearParameters(NamedTuple):
    """Columns of rotors and joints; k, c, half the backlash b, and w of each gear, (n,) each."""

    rotor: np.ndarray
    joint: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    half: np.ndarray
    width: np.ndarray


class _Gears(Effect):
    """Gears of drives, by joint."""

    def __init__(self, drives: Mapping[str, ElasticDrive]):
        self._drives = drives

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> GearParameters:
        """Return the columns and the numbers."""
        return GearParameters(
            *(np.array([coordinate_index(coordinates, name) for name in names]) for names in (
                [rotor_name(joint) for joint in self._drives], self._drives)),
            *np.array([[one.stiffness, one.damping, 0.5 * one.backlash, one.smoothing]
                       for one in self._drives.values()]).T.copy())


class ElasticGears(_Gears, Potential):
    """The energy U of elastic gears, which is part of H."""

    label, stiff = 'elastic gears', True

    def fastest_rate(self, parameters: GearParameters, inverse_mass: np.ndarray) -> float:
        """Return the frequency or the decay rate of the fastest twist [rad/s]."""
        own = parameters
        twists = np.eye(len(inverse_mass))[own.rotor] - np.eye(len(inverse_mass))[own.joint]
        inverse = np.einsum('ni,ij,nj->n', twists, inverse_mass, twists)
        return float(max(np.sqrt(own.stiffness * inverse).max(), (own.damping * inverse).max()))

    def stored_energy(self, parameters: GearParameters, q: np.ndarray, x: float
                      ) -> dict[str, float]:
        """Return U of each gear [J]."""
        return {joint: _twist_energy(parameters, i, q)[0] for i, joint in enumerate(self._drives)}

    @staticmethod
    @inlined
    def energy(own: GearParameters, q: np.ndarray) -> float:
        """Return the sum of U [J]."""
        total = 0.0
        for i in range(own.rotor.size):
            total += _twist_energy(own, i, q)[0]
        return total

    @staticmethod
    @inlined
    def add_gradient(own: GearParameters, q: np.ndarray, dH_dq: np.ndarray) -> None:
        """Add U' to the rotors, and -U' to the joints."""
        for i in range(own.rotor.size):
            torque = _twist_energy(own, i, q)[1]
            dH_dq[own.rotor[i]] += torque
            dH_dq[own.joint[i]] -= torque

    @staticmethod
    @inlined
    def add_hessian_vector(own: GearParameters, q: np.ndarray, v: np.ndarray, product: np.ndarray
                           ) -> None:
        """Add U'' v."""
        for i in range(own.rotor.size):
            change = _twist_energy(own, i, q)[2] * (v[own.rotor[i]] - v[own.joint[i]])
            product[own.rotor[i]] += change
            product[own.joint[i]] -= change


class GearDamping(_Gears, Force):
    """The torques c (theta' - q') in elastic gears; their work is never positive."""

    depends_on_momentum, passive, label = True, True, 'gear damping'

    @staticmethod
    @inlined
    def add_force(own: GearParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the torques to the joints, and their opposites to the rotors."""
        for i in range(own.rotor.size):
            torque = own.damping[i] * (velocity[own.rotor[i]] - velocity[own.joint[i]])
            f_p[own.rotor[i]] -= torque
            f_p[own.joint[i]] += torque


def gear_effects(drives: Mapping[str, ElasticDrive]) -> list[Effect]:
    """Return the effects of drives."""
    damped = any(one.damping for one in drives.values())
    return [ElasticGears(drives), *[GearDamping(drives)] * damped]


@inlined
def _twist_energy(own: GearParameters, i: int, q: np.ndarray) -> tuple[float, float, float]:
    """Return U of a gear and its first two derivatives by the twist."""
    s, k, b = q[own.rotor[i]] - q[own.joint[i]], own.stiffness[i], own.half[i]
    if b == 0.0:
        return 0.5 * k * s * s, k * s, k
    up, down = _beyond(s - b, own.width[i]), _beyond(-s - b, own.width[i])
    return (0.5 * k * (up[0] * up[0] + down[0] * down[0]),
            k * (up[0] * up[1] - down[0] * down[1]),
            k * (up[1] * up[1] + up[0] * up[2] + down[1] * down[1] + down[0] * down[2]))


@inlined
def _beyond(x: float, w: float) -> tuple[float, float, float]:
    """Return f(x) and its first two derivatives."""
    if w == 0.0:
        return (x, 1.0, 0.0) if x > 0.0 else (0.0, 0.0, 0.0)
    # Without overflow for large x.
    e = math.exp(-abs(x) / w)
    slope = 1.0 / (1.0 + e) if x > 0.0 else e / (1.0 + e)
    return max(x, 0.0) + w * math.log1p(e), slope, slope * (1.0 - slope) / w
