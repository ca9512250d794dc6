# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured forces between samples, and the constant force of each step that replaces them."""

from collections.abc import Sequence
from dataclasses import replace
import math

from hnn_vi_ros.effects import ExternalForce, LARGEST, OFF
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Distance from a kink at which slopes are taken on each side, in samples.
_OFF_KINK = 0.01


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


def commands_and_off(motion: EvenMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return commands, also while motors are off, and where these are off, each (N, m)."""
    on, off = motion.tau.copy(), np.abs(motion.tau) > LARGEST
    for column, idle in zip(on.T, off.T, strict=True):
        # A command that waits for the motor, or the last one.
        column[idle] = np.interp(np.flatnonzero(idle), np.flatnonzero(~idle), column[~idle]) \
            if not idle.all() else 0.0
    return on, off


def ramps(motion: EvenMotion, positions: np.ndarray, rate: float) -> np.ndarray:
    """
    Return a reference, at the samples, that follows positions at a rate, shape (N, m).

    It begins at the measured position if each joint has a command, else at the first command.
    """
    r, most = positions.copy(), rate * motion.spacing
    if motion.q.shape == r.shape and rate < math.inf:
        r[0] = motion.q[0]
    for before, now, position in zip(r, r[1:], positions, strict=False):
        now[:] = before + np.clip(position - before, -most, most)
    return r


def _limited(motion: EvenMotion, positions: np.ndarray, times: np.ndarray, rate: float
             ) -> np.ndarray:
    """Return the integral to given times of such a reference."""
    spacing, r = motion.spacing, ramps(motion, positions, rate)

    def integral(change: np.ndarray, x: np.ndarray) -> np.ndarray:
        ramp = np.minimum(np.abs(change) / rate, x)
        return np.sign(change) * rate * ramp * (x - 0.5 * ramp)
    change = positions - r
    total = np.cumsum(spacing * r + integral(change, np.full_like(r, spacing)), axis=0)
    k = np.clip(np.floor(times / spacing + 1e-9).astype(int), 0, len(r) - 1)
    x = (times - spacing * k)[:, None]
    return np.where(k[:, None] > 0, total[k - 1], 0.0) + r[k] * x + integral(change[k], x)


def constant_commands(motion: EvenMotion, edges: np.ndarray, h: float, delay: float,
                      rate: float = math.inf) -> np.ndarray:
    """
    Return the command of each step to servos, its mean in the step, or OFF, shape (N, m).

    A motor is off in a step if it is for most of it. Only positions are delayed [s] and limited
    in rate: a drive that filters its goal switches its motor at once. Other parameters are as in
    ``constant_forces``.
    """
    on, off = commands_and_off(motion)
    total = impulse(replace(motion, tau=on), edges - delay) if rate == math.inf else _limited(
        motion, on, edges - delay, rate)
    share = np.diff(impulse(replace(motion, tau=off.astype(float)), edges), axis=0) / h
    return np.where(share > 0.5, OFF, np.diff(total, axis=0) / h)


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
