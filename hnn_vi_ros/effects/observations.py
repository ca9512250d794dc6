# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of a machine: checked, and kept for the steps to come."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.commands import Command, Observation
from hnn_vi_ros.errors import listed
import numpy as np

MOST_PREDICTIONS = 40
# What joints are at, or move by in a second; far beyond, numbers overflow.
_LARGEST = 1e9
# Older than the last one by less than this, an observation is the same one again [s].
_LEAST = 1e-9


class ObserverParameters(NamedTuple):
    """
    Parameters of the compiled flow of an observer of n coordinates.

    Parameters
    ----------
    places : np.ndarray of int64, shape (n,)
        Those of what is observed among the coordinates.
    gain, damping : float
        k and lambda; see Observer.
    knots : np.ndarray, shape (m, 1 + 3 d)
        Of Reference: behind those of a path, the last one is the observer's. It holds until when
        the observation is followed, when it was made [s], n positions and n velocities.
    clock : np.ndarray
        See EffectState.

    """

    places: np.ndarray
    gain: float
    damping: float
    knots: np.ndarray
    clock: np.ndarray


def check_observed(names: Sequence[str], deviations: Sequence[float] | None, predictions: int,
                   **gains: float) -> None:
    """Raise ValueError where what an observer takes beside its time-out cannot be used."""
    if not 1 <= predictions <= MOST_PREDICTIONS:
        raise ValueError(f'predictions = {predictions} must be from 1 to {MOST_PREDICTIONS}')
    for gain, value in gains.items():
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f'{gain} = {value} must be at least 0 and finite')
    if not names or len(set(names)) < len(names):
        raise ValueError(f'coordinates = {names} must name at least one, each once')
    if deviations is not None and (len(deviations) != len(names) or not all(
            np.isfinite(one) and one > 0.0 for one in deviations)):
        raise ValueError(f'deviations = {deviations} must be positive and finite, one for each of '
                         f'{listed(names)}')


def select(command: Observation, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return positions and velocities of named joints, shape (n,); velocities NaN where not seen.

    Raises
    ------
    ValueError
        A joint is missing or there twice, or a number is not finite.

    """
    given = list(command.names)
    for name in names:
        if given.count(name) != 1:
            raise ValueError(f'joint {name!r} is observed {given.count(name)} times: name it '
                             f'once; observed are {listed(names)}')
    rows = [given.index(name) for name in names]
    position, velocity = command.position[rows], command.velocity[rows]
    if not (np.abs(position) <= _LARGEST).all() or (np.abs(velocity) > _LARGEST).any():
        raise ValueError('a position is missing or not finite, or a velocity is infinite, or one '
                         f'is beyond {_LARGEST:g}')
    return position, velocity


def prepare(command: Command, own: ObserverParameters, names: Sequence[str], timeout: float
            ) -> Callable[[], None]:
    """Return what keeps an observation, or raise ValueError; see Commanded."""
    assert isinstance(command, Observation)
    position, velocity = select(command, names)
    now, row = own.clock[0], own.knots[-1]
    seen = now + command.delay
    if not abs(command.delay) <= timeout:
        raise ValueError(f'observed {command.delay:.3g} s from the simulated time, at most '
                         f'{timeout:g} s are taken; stamp by simulated time, or by zero for now')
    if row[0] > 0.0 and seen < row[1] - _LEAST:
        raise ValueError(f'observed {row[1] - seen:.3g} s before the last observation: it is late')

    def put() -> None:
        row[:2] = seen + timeout, seen
        row[2:2 + 2 * len(position)] = *position, *np.nan_to_num(velocity)
    return put
