# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A motor that follows its command late, and is weaker at speed."""

from collections.abc import Sequence
import math
from typing import Literal, NamedTuple

from hnn_vi_ros.effects.base import Effect, EffectState, InternalForce, motor_index
from hnn_vi_ros.effects.commands import Commanded, NUMBERS
from hnn_vi_ros.effects.drives import find_drive
from hnn_vi_ros.hamiltonians import check_not_negative
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class MotorParameters(NamedTuple):
    """Column, T, tau_max, omega_0, full braking, and command and clock of EffectState."""

    column: int
    time_constant: float
    torque_limit: float
    no_load_speed: float
    brakes: bool
    command: np.ndarray
    clock: np.ndarray


class Motor(InternalForce):
    """
    The lag and the torque-speed limit of a motor, applied to the command u of `external_force`.

    The torque x follows x' = (u - x) / T, exactly while u is held; what acts is x, limited to
    +-tau_max max(0, 1 - abs(v) / omega_0), in place of u. By default the line also limits a
    torque against v, as in a datasheet's envelope; a DC motor with a current limit, whose back
    EMF helps to brake, brakes with up to tau_max at any speed: ``braking: full``. x is part of
    snapshots and bags, and 0 at the start. Energy account: (limited x - u) v; `external_force`
    accounts for u v.

    Parameters
    ----------
    coordinate : str
        A coordinate of `external_force`, which must have the gain 1 and no offset.
    time_constant : float
        T >= 0 [s]; 0 is no lag.
    torque_limit : float, optional
        tau_max > 0 at rest [N m], [N]; by default that of the drive, or none.
    no_load_speed : float, optional
        omega_0 > 0 [rad/s], [m/s]; by default that of the drive, or none.
    drive : str, optional
        A drive whose limits at its voltage are the defaults, as in `servo`.
    braking : str
        ``limited``: the line limits driving and braking torques; ``full``: driving torques, x v >
        0, only.

    Raises
    ------
    ValueError
        A number is out of its range, the drive is unknown, or nothing commands the coordinate.

    References
    ----------
    B. Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 5.2.

    """

    feels_command, by_motors, corrects_command = True, False, True

    def __init__(self, coordinate: str, time_constant: float = 0.0,
                 torque_limit: float | None = None, no_load_speed: float | None = None,
                 drive: str | None = None, braking: Literal['limited', 'full'] = 'limited'):
        if drive is not None:
            row = find_drive(drive)
            torque_limit = row.torque_limit if torque_limit is None else torque_limit
            no_load_speed = row.no_load_speed if no_load_speed is None else no_load_speed
        check_not_negative(time_constant=time_constant)
        for name, value in (('torque_limit', torque_limit), ('no_load_speed', no_load_speed)):
            if value is not None and not value > 0.0:
                raise ValueError(f'{name} = {value} must be positive')
        if torque_limit is None and (no_load_speed is not None or not time_constant):
            raise ValueError('give time_constant, or torque_limit, or a drive with a voltage')
        self.brakes = braking == 'full'
        self.coordinate, self.time_constant = coordinate, float(time_constant)
        self.torque_limit = math.inf if torque_limit is None else float(torque_limit)
        self.no_load_speed = math.inf if no_load_speed is None else float(no_load_speed)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> MotorParameters:
        """Return the coordinate's column, the numbers, the command and the clock."""
        return MotorParameters(motor_index(coordinates, self.coordinate), self.time_constant,
                               self.torque_limit, self.no_load_speed, self.brakes,
                               state.command, state.clock)

    def check_beside(self, others: Sequence[Effect]) -> None:
        """Raise ValueError unless a plain external_force commands the coordinate."""
        if not any(isinstance(one, Commanded) and NUMBERS in one.takes and not getattr(
                one, 'feels_command', True) and self.coordinate in one.names for one in others):
            raise ValueError(f'no external_force with the gain 1 and no offset commands '
                             f'{self.coordinate!r}; add it, or remove the motor')

    @staticmethod
    @inlined
    def respond(own: MotorParameters, x: float, v: float, t: float, h: float
                ) -> tuple[float, float]:
        """Return the limited torque minus the command, and the mean rate of x over the step h."""
        u = _command(own)
        torque = u + (x - u) * _decay(own, t)
        limit = _limit(own, torque, v)
        return (min(max(torque, -limit), limit) - u, (u - x) * (1.0 - _decay(own, h)) / h)

    @staticmethod
    @inlined
    def respond_tangent(own: MotorParameters, x: float, v: float, t: float, h: float, dx: float,
                        dv: float) -> tuple[float, float]:
        """Return the changes of the force and of the mean rate of x."""
        u, decay = _command(own), _decay(own, t)
        torque, force = u + (x - u) * decay, decay * dx
        limit = _limit(own, torque, v)
        if abs(torque) > limit:
            falls = math.copysign(own.torque_limit / own.no_load_speed, torque * v)
            force = 0.0 if limit <= 0.0 or _at_full(own, torque, v) else -falls * dv
        return force, (_decay(own, h) - 1.0) * dx / h


@inlined
def _command(own: MotorParameters) -> float:
    return own.command[own.column] if own.clock[0] < own.command[own.command.size - 1] else 0.0


@inlined
def _decay(own: MotorParameters, t: float) -> float:
    return math.exp(-t / own.time_constant) if own.time_constant > 0.0 else 0.0


@inlined
def _at_full(own: MotorParameters, torque: float, v: float) -> bool:
    """Return True if a torque brakes and the speed does not limit it."""
    return own.brakes and torque * v < 0.0


@inlined
def _limit(own: MotorParameters, torque: float, v: float) -> float:
    """Return the largest torque at a speed; infinite at any speed if there is no limit at rest."""
    if _at_full(own, torque, v):
        return own.torque_limit
    return own.torque_limit * max(0.0, 1.0 - abs(v) / own.no_load_speed)
