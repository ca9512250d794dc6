# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of a machine: checked, and kept for the steps to come."""

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

from hnn_vi_ros.effects.commands import Command, Observation
from hnn_vi_ros.errors import listed
from hnn_vi_ros.kernels.marks import inlined
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
    gain, damping, velocity_limit : float
        k, lambda and V; see Observer.
    reach : float
        Up to which q - y the simulation is pulled [m], [rad].
    knots : np.ndarray, shape (m, 1 + 3 d)
        Of Reference: behind those of a path, the last one is the observer's. It holds until when
        the observation is followed, when it was made [s], n positions and n velocities.
    clock : np.ndarray
        See EffectState.

    """

    places: np.ndarray
    gain: float
    damping: float
    velocity_limit: float
    reach: float
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


def largest_gain(mass: float, damping: float, h: float) -> float:
    """
    Return up to which gain the splitting of an observer is stable at a step.

    Half a flow, the flight of a free mass m and another half map (q - y, p) with the determinant
    exp(-lambda h); both eigenvalues are at most 1 in size up to k = (2 m lambda / h)
    coth(lambda h / 2), which is 4 m / h^2 without damping.

    Parameters
    ----------
    mass : float
        m [kg], [kg m2].
    damping : float
        lambda [1/s].
    h : float
        Step size [s].

    """
    half = 0.5 * damping * h
    return 4.0 * mass / h**2 * (half / math.tanh(half) if half > 0.0 else 1.0)


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


def prepare(command: Command, own: ObserverParameters, names: Sequence[str], timeout: float,
            q: np.ndarray) -> Callable[[], None]:
    """Return what keeps an observation, or raise ValueError; see Commanded."""
    assert isinstance(command, Observation)
    position, velocity = select(command, names)
    now, row = own.clock[0], own.knots[-1]
    seen = now + command.delay
    if not abs(command.delay) <= timeout:
        raise ValueError(f'observed {command.delay:.3g} s from the simulated time, at most '
                         f'{timeout:g} s are taken; stamp by simulated time, or by zero for now')
    # One that was stamped ahead of time gives way to what is observed now.
    if row[0] > 0.0 and row[1] <= now and seen < row[1] - _LEAST:
        raise ValueError(f'observed {row[1] - seen:.3g} s before the last observation: it is late')
    _check_reached(position, velocity, seen, own, names, timeout, q)

    def put() -> None:
        row[:2] = seen + timeout, seen
        row[2:2 + 2 * len(position)] = *position, *np.nan_to_num(velocity)
    return put


def _check_reached(position: np.ndarray, velocity: np.ndarray, seen: float,
                   own: ObserverParameters, names: Sequence[str], timeout: float, q: np.ndarray
                   ) -> None:
    """
    Raise ValueError of what is faster than the machine, or where it cannot be.

    It can be where it gets to from where it was seen last, or from where the simulation is drawn
    to it: after a wrong observation that looked right the next right one is not lost. One that
    was not seen yet may be as far away as it gets in the time-out.
    """
    limit, row, n = own.velocity_limit, own.knots[-1], len(names)
    beyond = np.abs(position - q[own.places]) - (own.reach if row[0] > 0.0 else limit * timeout)
    if row[0] > 0.0:
        beyond = np.minimum(beyond, np.abs(position - row[2:2 + n]) - limit * abs(seen - row[1]))
    for name, rate, excess in zip(names, np.abs(velocity), beyond, strict=True):
        # A velocity that is not known is not too large.
        if rate > limit or excess > 0.0:
            what = f'moves by {rate:.4g} per second' if rate > limit else \
                f'is {excess:.4g} beyond where the machine can be'
            raise ValueError(f'joint {name!r} {what}, by velocity_limit = {limit:g}; raise it if '
                             'the machine is faster')


@inlined
def flow(own: ObserverParameters, h: float, q: np.ndarray, p: np.ndarray, p_carry: np.ndarray
         ) -> None:
    """Pull momenta and coordinates to what is observed; see Observer."""
    # Half a step from either end is the same instant: the splitting stays symmetric.
    t, row = own.clock[0] + h, own.knots[own.knots.shape[0] - 1]
    n, decay = own.places.size, math.expm1(-own.damping * h)
    # The integral of exp(-lambda t) over h: both act together.
    pull = own.gain * (-decay / own.damping if own.damping > 0.0 else h)
    if t > row[0] or own.gain + own.damping == 0.0:
        return
    lost = False
    for k in range(n):
        away = q[own.places[k]] - row[2 + k] - (t - row[1]) * row[2 + n + k]
        lost = lost or abs(away) > own.reach
    for k in range(n):
        i = own.places[k]
        away = q[i] - row[2 + k] - (t - row[1]) * row[2 + n + k]
        p[i] = 0.0 if lost else p[i] - pull * away
        q[i] -= away if lost else -decay * away
