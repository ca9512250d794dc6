# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction with a memory: bristles that bend, stick and slip."""

from collections.abc import Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, InternalForce
from hnn_vi_ros.effects.drives import find_drive
from hnn_vi_ros.hamiltonians import check_between, check_not_negative, check_positive
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Speeds at which the power of the bristles is checked.
_SPEEDS = np.geomspace(1e-9, 1e9, 1801)


class LugreParameters(NamedTuple):
    """Column of the coordinate, and sigma_0, sigma_1, sigma_2, F_C, F_S - F_C, v_S, a and v_d."""

    column: int
    stiffness: float
    bristle_damping: float
    damping: float
    friction: float
    stribeck: float
    speed: float
    exponent: float
    bristle_damping_speed: float


class LugreFriction(InternalForce):
    """
    LuGre friction, f = -(sigma_0 z + sigma_1 z' + sigma_2 v), with the deflection z of bristles.

    z' = v - sigma_0 abs(v) z / g(v) and g = F_C + (F_S - F_C) exp(-abs(v / v_S)^a). Below F_C a
    load bends the bristles and does not move the joint further; sliding begins at F_S. z follows
    its exact flow for a constant v, so that abs(z) <= F_S / sigma_0 at any step size; steps h
    should resolve sqrt(m / sigma_0) for a joint with the inertia m. z is part of snapshots and
    bags. Without memory and cheaper: `joint_friction`. Energy account: f v; sigma_0 z^2 / 2 of it
    is stored in the bristles, the rest is at most 0.

    Parameters
    ----------
    coordinate : str
        The coordinate with friction.
    stiffness : float
        sigma_0 > 0 of the bristles [N m/rad], [N/m].
    friction : float, optional
        Coulomb friction F_C > 0 [N m], [N]; by default that of the drive.
    stribeck : float, optional
        Excess F_S - F_C >= 0 of static friction [N m], [N]; by default that of the drive, or 0.
    speed : float, optional
        Stribeck speed v_S > 0 [rad/s], [m/s]; by default that of the drive, or 0.01.
    exponent : float, optional
        a of the Stribeck curve, from 1 to 10 [1]; by default that of the drive, or 2.
    damping : float, optional
        Viscous friction sigma_2 >= 0 [N m s/rad], [N s/m]; by default that of the drive, or 0.
    bristle_damping : float
        sigma_1 >= 0 of the bristles [N m s/rad], [N s/m].
    bristle_damping_speed : float, optional
        v_d > 0: sigma_1 falls as exp(-(v / v_d)^2) [rad/s], [m/s]; by default it is constant.
    drive : str, optional
        A drive whose measured friction is the default, as in `servo`.

    Raises
    ------
    ValueError
        A number is out of its range, the drive is unknown, or sigma_1 would add energy.

    References
    ----------
    C. Canudas de Wit et al., A new model for control of systems with friction, IEEE Trans.
    Automat. Control 40 (1995). N. Barabanov, R. Ortega, Necessary and sufficient conditions for
    passivity of the LuGre friction model, IEEE Trans. Automat. Control 45 (2000).

    """

    stiff = passive = True

    def __init__(self, coordinate: str, stiffness: float, friction: float | None = None,
                 stribeck: float | None = None, speed: float | None = None,
                 exponent: float | None = None, damping: float | None = None,
                 bristle_damping: float = 0.0, bristle_damping_speed: float | None = None,
                 drive: str | None = None):
        if drive is not None:
            row = find_drive(drive)
            friction = row.friction if friction is None else friction
            stribeck = row.stribeck if stribeck is None else stribeck
            speed = row.speed if speed is None else speed
            exponent = row.exponent if exponent is None else exponent
            damping = row.damping if damping is None else damping
        if friction is None:
            raise ValueError('give friction, or a drive')
        own = LugreParameters(
            0, float(stiffness), float(bristle_damping), float(damping or 0.0), float(friction),
            float(stribeck or 0.0), 0.01 if speed is None else float(speed),
            2.0 if exponent is None else float(exponent),
            math.inf if bristle_damping_speed is None else float(bristle_damping_speed))
        check_positive(stiffness=own.stiffness, friction=own.friction, speed=own.speed)
        check_not_negative(stribeck=own.stribeck, damping=own.damping,
                           bristle_damping=own.bristle_damping)
        check_between(1.0, 10.0, exponent=own.exponent)
        check_positive(bristle_damping_speed=min(own.bristle_damping_speed, 1e12))
        _check_passive(own)
        self.coordinate, self.numbers = coordinate, own

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> LugreParameters:
        """Return the coordinate's column, and the numbers."""
        return self.numbers._replace(column=coordinate_index(coordinates, self.coordinate))

    def fastest_rate(self, parameters: LugreParameters, inverse_mass: np.ndarray) -> float:
        """Return the frequency or the decay rate of small motions on the bristles [rad/s]."""
        own, inverse = parameters, inverse_mass[parameters.column, parameters.column]
        return max(math.sqrt(own.stiffness * inverse),
                   (own.bristle_damping + own.damping) * inverse)

    def stored_energy(self, parameters: LugreParameters, q: np.ndarray, x: float
                      ) -> dict[str, float]:
        """Return sigma_0 z^2 / 2 of the bristles [J]."""
        return {'': 0.5 * parameters.stiffness * x * x}

    @staticmethod
    @inlined
    def respond(own: LugreParameters, x: float, v: float, t: float, h: float
                ) -> tuple[float, float]:
        """Return the force, and the mean rate of z over the step h."""
        rate, _, bristle_damping, _ = _at_speed(own, v)
        bending = v - rate * x
        z = x + bending * _duration(rate, t)
        force = own.stiffness * z + bristle_damping * (v - rate * z) + own.damping * v
        return -force, bending * _duration(rate, h) / h

    @staticmethod
    @inlined
    def respond_tangent(own: LugreParameters, x: float, v: float, t: float, h: float, dx: float,
                        dv: float) -> tuple[float, float]:
        """Return the changes of the force and of the mean rate of z."""
        rate, rate_slope, c, c_slope = _at_speed(own, v)
        bending, d_rate = v - rate * x, rate_slope * dv
        d_bending, duration, mean = dv - rate * dx - d_rate * x, _duration(rate, t), \
            _duration(rate, h)
        z = x + bending * duration
        dz = dx + d_bending * duration + bending * _duration_slope(rate, t, duration) * d_rate
        force = own.stiffness * dz + c * (dv - d_rate * z - rate * dz) \
            + c_slope * dv * (v - rate * z) + own.damping * dv
        return -force, (d_bending * mean + bending * _duration_slope(rate, h, mean) * d_rate) / h


@inlined
def _at_speed(own: LugreParameters, v: float) -> tuple[float, float, float, float]:
    """Return sigma_0 abs(v) / g(v) and its slope, and sigma_1(v) and its slope."""
    sign = 0.0 if v == 0.0 else math.copysign(1.0, v)
    # Beyond, the excess is zero and its exponent could overflow.
    size = min(abs(v) / own.speed, 1e3)
    excess = own.stribeck * math.exp(-size ** own.exponent)
    g = own.friction + excess
    g_slope = -sign * excess * own.exponent * size ** (own.exponent - 1.0) / own.speed
    rate = own.stiffness * abs(v) / g
    ratio = v / own.bristle_damping_speed
    c = own.bristle_damping * math.exp(-ratio * ratio)
    return (rate, own.stiffness * sign / g - rate * g_slope / g, c,
            -2.0 * ratio / own.bristle_damping_speed * c)


@inlined
def _duration(rate: float, t: float) -> float:
    """Return the integral of exp(-rate s) over s from 0 to t."""
    return -math.expm1(-rate * t) / rate if rate > 0.0 else t


@inlined
def _duration_slope(rate: float, t: float, duration: float) -> float:
    """Return its derivative with respect to the rate."""
    return (t * math.exp(-rate * t) - duration) / rate if rate > 0.0 else -0.5 * t * t


def _check_passive(own: LugreParameters) -> None:
    """
    Raise ValueError if bristles could give more energy than they store.

    With s = sigma_0 z, the loss f v - (sigma_0 z^2 / 2)' is v (s^2 / g + v (sigma_1 + sigma_2 -
    sigma_1 s / g)), which is least at s = sigma_1 v / 2, and s is at most F_S.
    """
    v = _SPEEDS
    # Ratios are bounded, so that no power of them overflows.
    excess = np.exp(-(np.minimum(v, 1e3 * own.speed) / own.speed) ** own.exponent)
    g = own.friction + own.stribeck * excess
    c = own.bristle_damping * np.exp(
        -(np.minimum(v, 1e3 * own.bristle_damping_speed) / own.bristle_damping_speed) ** 2)
    s = np.minimum(0.5 * c * v, own.friction + own.stribeck)
    loss = s * s / g + v * (c + own.damping - c * s / g)
    bad = loss < -1e-12 * v * c
    if bad.any():
        most = own.damping * own.friction / own.stribeck
        raise ValueError(
            f'bristle_damping = {own.bristle_damping:g} could add energy at speeds from '
            f'{v[bad.argmax()]:.3g}; use at most damping friction / stribeck = {most:.3g}, or '
            'give bristle_damping_speed')
