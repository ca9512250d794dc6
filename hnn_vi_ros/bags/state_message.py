# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Message of ~/state: a whole sample with one stamp, a list of named numbers."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.bags.cdr import decode_joint_state
import numpy as np

# Before the name of a coordinate: its momentum, and the rate of that.
MOMENTUM, RATE = 'p_', 'dp_dt_'
_SCALARS = ('H', 'work')


class State(NamedTuple):
    """
    A sample, as ~/state holds it.

    Parameters
    ----------
    stamp : int
        Simulated time [ns].
    q, p, dp_dt : np.ndarray, shape (d,)
        Coordinates, momenta, and their rates; these have fewer columns where q has quaternions.
    energy, work : float
        H(q, p) and what the effects have done on the system since the start [J].

    """

    stamp: int
    q: np.ndarray
    p: np.ndarray
    dp_dt: np.ndarray
    energy: float
    work: float


def state_names(names: Sequence[str], momenta: Sequence[str] | None = None) -> list[str]:
    """Return what ~/state names its numbers: q, p, dp/dt of the coordinates, H and the work."""
    momenta = names if momenta is None else momenta
    return [*names, *(MOMENTUM + name for name in momenta), *(RATE + name for name in momenta),
            *_SCALARS]


def decode_state(data: bytes) -> State:
    """Return the sample in a serialised message of ~/state; ValueError if it is none."""
    joints = decode_joint_state(data)
    names, count = list(joints.names), len(joints.names) - len(_SCALARS)
    d = _momenta(names, count)
    if d is None or len(joints.position) != len(names):
        raise ValueError('it names other numbers than ~/state')
    q, p, dp_dt = np.split(joints.position[:count], [count - 2 * d, count - d])
    return State(joints.stamp, q, p, dp_dt, *joints.position[count:].tolist())


def _momenta(names: list[str], count: int) -> int | None:
    """Return how many momenta ~/state has that so names its numbers; None if it is none."""
    d = count // 3
    if names == state_names(names[:d]):
        return d
    # A quaternion has four columns and three momenta.
    rates = sum(name.startswith(RATE) for name in names)
    momenta = [name.removeprefix(RATE) for name in names[count - rates:count]]
    return rates if names == state_names(names[:count - 2 * rates], momenta) else None
