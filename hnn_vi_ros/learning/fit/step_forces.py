# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured forces between samples, and the constant force of each step that replaces them."""

from collections.abc import Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects import ExternalForce, LARGEST, OFF
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Distance from a kink at which slopes are taken on each side, in samples.
_OFF_KINK = 0.01
# Time by which rounding moves an instant [s].
_ROUNDED = 1e-9


def impulse(motion: EvenMotion, times: np.ndarray) -> np.ndarray:
    """
    Return the integral of the measured forces from the first sample to given times [s].

    The first force acts before the first sample unless the run began idle; the last one acts after
    the last sample.
    """
    times = np.maximum(times, 0.0) if motion.idle else times
    inside = np.clip(times, 0.0, motion.spacing * (len(motion.tau) - 1))
    beyond = times - inside
    return motion.course.antiderivative()(inside) + beyond[:, None] * np.where(
        beyond[:, None] < 0.0, motion.tau[0], motion.tau[-1])


def slope(motion: EvenMotion, times: np.ndarray) -> np.ndarray:
    """Return the slope of the measured forces at given times [s], its mean at a kink."""
    rate, end = motion.course.derivative(), motion.spacing * (len(motion.tau) - 1)
    off = _OFF_KINK * motion.spacing
    return 0.5 * sum(rate(np.minimum(at, end - off)) * (at > 0.0)[:, None]
                     for at in (times - off, times + off))


def constant_forces(motion: EvenMotion, edges: np.ndarray, h: float, rates: bool) -> np.ndarray:
    """
    Return the constant force of each step that moves a body as the measured forces do.

    Parameters
    ----------
    motion : EvenMotion
        The measured forces.
    edges : np.ndarray, shape (N + 1,)
        Start and end times of N steps, since the first sample [s].
    h : float
        Step size [s].
    rates : bool
        True if velocities are compared too.

    Returns
    -------
    np.ndarray, shape (N, m)
        Its mean in each step moves positions as F + h^2 F'' / 12 would, up to h^4; velocities
        without this term would be off by h^2 F' / 12.

    """
    total = impulse(motion, edges)
    if not rates:
        total = total - h**2 / 12.0 * slope(motion, edges)
    return np.diff(total, axis=0) / h


class HeldCommands(NamedTuple):
    """
    Positions commanded to servos, steps at the time stamps of the log.

    Parameters
    ----------
    t : np.ndarray, shape (M,)
        Times since the first sample of the motion [s].
    positions : np.ndarray, shape (M, m)
        Positions, also while motors are off: then those that wait for the motor.
    off : np.ndarray of bool, shape (M, m)
        Mask of the motors that are off.
    rate : float
        Largest rate at which servos follow the positions, possibly infinite.
    begins : np.ndarray, shape (m,)
        Positions at which they begin to follow.

    """

    t: np.ndarray
    positions: np.ndarray
    off: np.ndarray
    rate: float
    begins: np.ndarray

    @property
    def reached(self) -> np.ndarray:
        """Return the reference at the times of the commands, shape (M, m)."""
        if self.rate == math.inf:
            return self.positions
        r = np.vstack([self.begins, self.positions[1:]])
        for before, now, position, most in zip(
                r, r[1:], self.positions, self.rate * np.diff(self.t), strict=False):
            now[:] = before + np.clip(position - before, -most, most)
        return r

    def _since(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the last command before each time, and the time since [s], shape (N, 1)."""
        k = np.searchsorted(self.t, times + _ROUNDED, side='right') - 1
        k = np.clip(k, 0, len(self.t) - 1)
        return k, (times - self.t[k])[:, None]

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the reference at other times, shape (N, m)."""
        r, (k, since) = self.reached, self._since(times)
        if self.rate == math.inf:
            return r[k]
        most = self.rate * np.maximum(since, 0.0)
        return r[k] + np.clip(self.positions[k] - r[k], -most, most)

    def mean(self, edges: np.ndarray) -> np.ndarray:
        """Return the mean of the reference between edges, (N + 1,), shape (N, m)."""
        r, (k, since) = self.reached, self._since(edges)
        change = self.positions - r

        def integral(own: np.ndarray, x: np.ndarray) -> np.ndarray:
            if self.rate == math.inf:
                return np.zeros_like(own)
            ramp = np.clip(np.minimum(np.abs(own) / self.rate, x), 0.0, None)
            return np.sign(own) * self.rate * ramp * (x - 0.5 * ramp)
        lasting = np.diff(self.t)[:, None]
        total = np.cumsum(np.vstack([
            0.0 * r[:1], lasting * r[:-1] + integral(change[:-1], lasting)]), axis=0)
        return np.diff(total[k] + r[k] * since + integral(change[k], since), axis=0) / np.diff(
            edges)[:, None]

    def off_in(self, edges: np.ndarray) -> np.ndarray:
        """Return where motors are off for most of the time between edges, shape (N, m)."""
        return HeldCommands(self.t, self.off.astype(float), self.off, math.inf,
                            self.begins).mean(edges) > 0.5


def held_commands(motion: EvenMotion, rate: float = math.inf) -> HeldCommands:
    """
    Return the commands of a motion, which servos follow at a rate.

    They begin at the measured position if each joint has a command, else at the first command.
    """
    logged = motion.logged or motion
    assert logged.tau is not None, 'commanded'
    positions, off = logged.tau.copy(), np.abs(logged.tau) > LARGEST
    for column, idle in zip(positions.T, off.T, strict=True):
        column[idle] = np.interp(np.flatnonzero(idle), np.flatnonzero(~idle), column[~idle]) \
            if not idle.all() else 0.0
    begins = motion.q[0] if motion.q.shape[1] == positions.shape[1] else positions[0]
    return HeldCommands(logged.t - motion.t[0], positions, off, rate, begins)


def constant_commands(motion: EvenMotion, edges: np.ndarray, delay: float, rate: float = math.inf
                      ) -> np.ndarray:
    """
    Return the command of each step to servos, its mean in the step, or OFF, shape (N, m).

    Only positions are delayed [s] and limited in rate: a drive that filters its goal switches its
    motor at once.

    Parameters
    ----------
    motion : EvenMotion
        A commanded motion.
    edges : np.ndarray, shape (N + 1,)
        Start and end times of N steps, since the first sample [s].
    delay, rate : float
        See `servo`.

    """
    commands = held_commands(motion, rate)
    return np.where(commands.off_in(edges), OFF, commands.mean(edges - delay))


def command_names(effect: ExternalForce, coordinates: Sequence[Coordinate],
                  motions: Sequence[EvenMotion]) -> Sequence[str]:
    """Return the coordinates on which measured forces act; raise DataError on a mismatch."""
    names, m = [coordinate.name for coordinate in coordinates], motions[0].tau.shape[1]
    if not effect.names:
        raise DataError('external_force: identify cannot use the input map of its model; give it '
                        'coordinates instead')
    if m in (len(effect.names), len(names)):
        return effect.names if m == len(effect.names) else names
    raise DataError(f'external_force has {len(effect.names)} coordinates and H has {len(names)}, '
                    f'but the data contain {m} forces; give one for each coordinate of either')
