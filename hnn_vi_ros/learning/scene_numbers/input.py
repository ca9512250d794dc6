# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Input of measured motions: their forces in the steps of a scene, and its clock."""

from collections.abc import Sequence

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.periodic_drive import PeriodicDrive
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.runs import Motion
import numpy as np

# Share of a step: times of samples further from whole steps shift the phase of a drive.
_OFF_GRID = 0.01


def impulse(motion: Motion, times: np.ndarray) -> np.ndarray:
    """
    Return the integral of the measured forces up to times from the first sample on [s].

    Each force goes over into the next; the first one acts before the first sample, the last one
    after the last.
    """
    tau, spacing = motion.tau, motion.spacing
    whole = np.concatenate([np.zeros((1, tau.shape[1])),
                            np.cumsum(motion.forces * spacing, axis=0)])
    row = np.clip(np.floor(times / spacing).astype(int), 0, len(tau) - 1)
    rest = (times - row * spacing)[:, None]
    slope = np.zeros_like(tau)
    slope[:-1] = np.diff(tau, axis=0) / spacing
    return whole[row] + rest * (tau[row] + 0.5 * np.where(rest > 0.0, rest, 0.0) * slope[row])


def command_names(effect: ExternalForce, coordinates: Sequence, motions: Sequence[Motion]
                  ) -> Sequence[str]:
    """Return the coordinates on which the measured forces act, or raise DataError."""
    names, m = [coordinate.name for coordinate in coordinates], motions[0].tau.shape[1]
    if not effect.names:
        raise DataError('external_force: its model has an input map, which takes no measured '
                        'forces here; give it coordinates')
    if m in (len(effect.names), len(names)):
        return effect.names if m == len(effect.names) else names
    raise DataError(f'external_force has {len(effect.names)} coordinates, H {len(names)}, and the '
                    f'data hold {m} forces; give as many')


def check_times(effects: Sequence[Effect], motions: Sequence[Motion], h: float) -> None:
    """Raise DataError where a drive would be out of phase: samples at no whole steps."""
    if any(isinstance(effect, PeriodicDrive) for effect in effects):
        for motion in motions:
            off = abs(motion.t[0] / h - round(motion.t[0] / h))
            if off > _OFF_GRID:
                raise DataError(f'{motion.name}: begins at {motion.t[0]:.9g} s, which is no whole '
                                f'number of steps of {h:g} s, by which the drive of the scene '
                                'counts time; shift the times')
