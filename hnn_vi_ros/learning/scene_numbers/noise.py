# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of measured motions, and how fast they turn, from the data alone."""

from collections.abc import Sequence

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.runs import Motion
import numpy as np

# Least noise, relative to the measured range: rounding alone makes as much.
_LEAST_NOISE = 1e-9
_LEAST_SAMPLES = 10


def first_noise(motions: Sequence[Motion], velocities: bool) -> np.ndarray:
    """Return a guess of the noise from third differences, which smooth motion hardly has."""
    columns = [np.hstack([motion.q, motion.v][:1 + velocities]) for motion in motions]
    thirds = np.concatenate([np.diff(column, 3, axis=0) for column in columns])
    least = least_noise(np.concatenate(columns))
    return np.maximum(np.sqrt((thirds**2).mean(axis=0) / 20.0), least)


def least_noise(measured: np.ndarray) -> np.ndarray:
    """Return what rounding makes of noise, shape (C,)."""
    return _LEAST_NOISE * (np.ptp(measured, axis=0) + 1e-300)


def first_length(motions: Sequence[Motion], velocities: bool) -> float:
    """Return a length of windows in which a motion hardly turns: four of its times [s]."""
    q, v = (np.concatenate([getattr(motion, name) for motion in motions])
            for name in ('q_smooth', 'v_smooth'))
    speed = np.sqrt((v**2).mean(axis=0))
    if not speed.any():
        raise DataError(f'{motions[0].name}: nothing moves in it, so no parameter can be found')
    pace = float((q.std(axis=0)[speed > 0.0] / speed[speed > 0.0]).min())
    least = _LEAST_SAMPLES if velocities else 2 * _LEAST_SAMPLES
    return max(4.0 * pace, (least - 1) * motions[0].spacing)
