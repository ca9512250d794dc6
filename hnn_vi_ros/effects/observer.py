# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observer that corrects a simulation with observations of the machine whose twin it is."""

from collections.abc import Callable, Sequence
from functools import cache
import math
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, StepEffect
from hnn_vi_ros.effects.commands import Command, Commanded, OBSERVATION, Observation, select
from hnn_vi_ros.effects.splitting import strang
from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import (
    check_between, check_names_once, check_not_negative, check_positive)
from hnn_vi_ros.integrators import Integrator, Step
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

_MAX_PREDICTIONS = 40
# Two observations closer in time than this are the same one [s].
_MIN_INTERVAL = 1e-9


class ObserverParameters(NamedTuple):
    """
    Parameters of the compiled flow of an observer of n coordinates.

    Parameters
    ----------
    columns : np.ndarray of int64, shape (n,)
        Columns of the observed coordinates.
    gain, damping, velocity_limit : float
        k, lambda and V; see Observer.
    reach : float
        The largest q - y from which the simulation is corrected smoothly [m], [rad].
    knots : np.ndarray, shape (m, 1 + 3 d)
        Knots of Reference. The last row, after those of a path, belongs to the observer: expiry
        time of the observation, time at which it was made [s], n positions and n velocities.
    clock : np.ndarray
        See EffectState.

    """

    columns: np.ndarray
    gain: float
    damping: float
    velocity_limit: float
    reach: float
    knots: np.ndarray
    clock: np.ndarray


class Observer(StepEffect, Commanded):
    """
    A Luenberger observer: q' = H_p - lambda (q - y), p' = -H_q - k (q - y), y(t) observed.

    Correction and decay to y use their exact flow for half a step, before and after that of a
    method of order 1 or 2 (Strang). Errors of a mass m decay by s^2 + lambda s + k / m. y is
    extrapolated at the observed velocity until the next observation. If a q - y exceeds
    V / lambda, or V times the time-out if that is less, the observed coordinates are set to y, at
    rest: a pull from so far would move them faster than the machine. Use it for the twin of a
    machine. Energy account: the change of H.

    Parameters
    ----------
    coordinates : list of str
        The observed coordinates.
    gain : float
        k >= 0 [N/m], [N m/rad]; 0 only observes and compares, without changing the simulation.
    damping : float
        lambda >= 0 [1/s].
    timeout : float
        Time for which an observation is valid, and its maximum age, > 0 [s].
    deviations : list of float, optional
        Standard deviations, the units of errors [m], [rad]; by default estimated from the
        observations.
    predictions : int
        Number of predictions, from 1 to 40; one starts every 2 s / this number.
    velocity_limit : float
        V > 0, the velocity limit of the machine [m/s], [rad/s]; faster observations are ignored.

    Raises
    ------
    ValueError
        A parameter is out of its range, no coordinate is named, or one is named twice.

    References
    ----------
    D. Luenberger, An introduction to observers, IEEE Trans. Automat. Control 16 (1971).

    """

    single, knots, takes = True, 1, frozenset({OBSERVATION})

    def __init__(self, coordinates: list[str], gain: float = 0.0, damping: float = 0.0,
                 timeout: float = 0.5, deviations: list[float] | None = None,
                 predictions: int = 4, velocity_limit: float = 100.0):
        check_positive(timeout=timeout, velocity_limit=velocity_limit)
        _check(coordinates, deviations, predictions, gain=gain, damping=damping)
        self.names, self.gain, self.damping = coordinates, float(gain), float(damping)
        self.timeout, self.velocity_limit = float(timeout), float(velocity_limit)

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if splitting preserves the order of the method."""
        own = integrator.requirements
        return own.from_state and integrator.order <= 2 and super().accepts(integrator)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> ObserverParameters:
        """Return the columns, the gains, and the row of the observation."""
        columns = np.array([coordinate_index(coordinates, name) for name in self.names])
        reach = self.velocity_limit / max(self.damping, 1.0 / self.timeout)
        return ObserverParameters(columns, self.gain, self.damping, self.velocity_limit, reach,
                                  state.reference.knots, state.clock)

    def prepare(self, command: Command, parameters: ObserverParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return a function that applies an observation."""
        assert isinstance(command, Observation)
        position, velocity = select(command, self.names)
        now, row = parameters.clock[0], parameters.knots[-1]
        seen = now + command.delay
        if not abs(command.delay) <= self.timeout:
            raise ValueError(
                f'the time stamp differs from the simulated time by {command.delay:.3g} s, limit '
                f'{self.timeout:g} s; use simulated time, or zero for the current time')
        # A present observation replaces one with a time stamp in the future.
        if row[0] > 0.0 and row[1] <= now and seen < row[1] - _MIN_INTERVAL:
            raise ValueError(f'the observation is {row[1] - seen:.3g} s older than the last one')
        _check_reached(position, velocity, seen, parameters, self.names, self.timeout, q)

        def put() -> None:
            row[:2] = seen + self.timeout, seen
            row[2:2 + 2 * len(position)] = *position, *np.nan_to_num(velocity)
        return put

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two half flows."""
        return strang(_flow, step, keeps_gradient)


def _check(names: Sequence[str], deviations: Sequence[float] | None, predictions: int,
           **gains: float) -> None:
    check_between(1, _MAX_PREDICTIONS, predictions=predictions)
    check_not_negative(**gains)
    check_names_once(coordinates=names)
    if deviations is not None and (len(deviations) != len(names) or not all(
            np.isfinite(one) and one > 0.0 for one in deviations)):
        raise ValueError(f'deviations = {deviations} must be positive and finite, one for each of '
                         f'{listed(names)}')


def _check_reached(position: np.ndarray, velocity: np.ndarray, seen: float,
                   own: ObserverParameters, names: Sequence[str], timeout: float, q: np.ndarray
                   ) -> None:
    """
    Raise ValueError for an observation that the velocity limit of the machine excludes.

    The machine can be anywhere it can reach from its last observation, or from the position to
    which the simulation is corrected: an accepted outlier must not make the next correct
    observation invalid. Before the first observation it can be as far as it gets in the time-out.
    """
    limit, row, n = own.velocity_limit, own.knots[-1], len(names)
    beyond = np.abs(position - q[own.columns]) - (own.reach if row[0] > 0.0 else limit * timeout)
    if row[0] > 0.0:
        beyond = np.minimum(beyond, np.abs(position - row[2:2 + n]) - limit * abs(seen - row[1]))
    for name, rate, excess in zip(names, np.abs(velocity), beyond, strict=True):
        # An unknown velocity is NaN and passes.
        if rate > limit or excess > 0.0:
            what = f'moves at {rate:.4g} per second' if rate > limit else \
                f'is {excess:.4g} beyond the reachable range'
            raise ValueError(f'joint {name!r} {what}, given velocity_limit = {limit:g}; increase '
                             'it if the machine is faster')


@inlined
def _flow(own: ObserverParameters, h: float, q: np.ndarray, p: np.ndarray, p_carry: np.ndarray
          ) -> None:
    # Both half steps use the same instant, so the splitting stays symmetric.
    t, row = own.clock[0] + h, own.knots[own.knots.shape[0] - 1]
    n, decay = own.columns.size, math.expm1(-own.damping * h)
    # The integral of exp(-lambda t) over h: pull and decay act together.
    pull = own.gain * (-decay / own.damping if own.damping > 0.0 else h)
    if t > row[0] or own.gain + own.damping == 0.0:
        return
    lost = False
    for k in range(n):
        away = q[own.columns[k]] - row[2 + k] - (t - row[1]) * row[2 + n + k]
        lost = lost or abs(away) > own.reach
    for k in range(n):
        i = own.columns[k]
        away = q[i] - row[2 + k] - (t - row[1]) * row[2 + n + k]
        p[i] = 0.0 if lost else p[i] - pull * away
        q[i] -= away if lost else -decay * away
