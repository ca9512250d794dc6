# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What ~/state tells: a whole sample in one stamped message, a list of named numbers."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.bags.cdr import decode_joint_state
import numpy as np

# Before the name of a coordinate: its momentum, and the rate of that.
MOMENTUM, RATE = 'p_', 'dp_dt_'
_SCALARS = ('H', 'work')


class State(NamedTuple):
    """
    A sample as ~/state tells it.

    Parameters
    ----------
    stamp : int
        Simulated time [ns].
    q, p, dp_dt : np.ndarray, shape (d,)
        Coordinates, momenta, and their rates.
    energy, work : float
        H(q, p) and what the effects have done on the system since the start [J].

    """

    stamp: int
    q: np.ndarray
    p: np.ndarray
    dp_dt: np.ndarray
    energy: float
    work: float


def state_names(names: Sequence[str]) -> list[str]:
    """Return what ~/state names its numbers: q, p, dp/dt of the coordinates, H and the work."""
    return [*names, *(MOMENTUM + name for name in names), *(RATE + name for name in names),
            *_SCALARS]


def decode_state(data: bytes) -> State:
    """Return the sample in a serialised message of ~/state; ValueError if it is none."""
    joints = decode_joint_state(data)
    d = (len(joints.names) - len(_SCALARS)) // 3
    if list(joints.names) != state_names(joints.names[:d]) or \
            len(joints.position) != len(joints.names):
        raise ValueError('it names other numbers than ~/state')
    return State(joints.stamp, *joints.position[:3 * d].reshape(3, d),
                 *joints.position[3 * d:].tolist())
