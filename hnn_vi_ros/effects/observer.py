# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observer that draws a simulation towards the machine that it is the twin of."""

from collections.abc import Callable, Sequence
from functools import cache

from hnn_vi_ros.effects.base import coordinate_index, EffectState, StepEffect
from hnn_vi_ros.effects.commands import Command, Commanded, OBSERVATION
from hnn_vi_ros.effects.observations import (
    check_observed, flow, ObserverParameters, prepare)
from hnn_vi_ros.effects.splitting import strang
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.integrators.base import Integrator, Step
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Observer(StepEffect, Commanded):
    """
    A Luenberger observer: q' = H_p - lambda (q - y), p' = -H_q - k (q - y), y(t) observed.

    The pull and the decay to y are taken by their exact flow for half a step, before and after
    that of a method of order 1 or 2 (Strang). Errors of a mass m decay by s^2 + lambda s + k / m.
    y goes on at the observed velocity until the next. Where a q - y is more than V / lambda, or V
    times the time-out if that is less, the observed coordinates are set to y, at rest: a pull from
    so far would make them faster than the machine. Energy account: the change of H.

    Parameters
    ----------
    coordinates : list of str
        What is observed.
    gain : float
        k >= 0 [N/m], [N m/rad]; 0 observes and compares, and leaves the simulation alone.
    damping : float
        lambda >= 0 [1/s].
    timeout : float
        How long an observation holds, and how old one may be, > 0 [s].
    deviations : list of float, optional
        Standard deviations, the units of errors [m], [rad]; by default of what was observed.
    predictions : int
        From 1 to 40; one begins every 2 s / this.
    velocity_limit : float
        V > 0, that of the machine [m/s], [rad/s]; faster observations are ignored.

    Raises
    ------
    ValueError
        A parameter out of its range, no coordinate, or one named twice.

    References
    ----------
    D. Luenberger, An introduction to observers, IEEE Trans. Automat. Control 16 (1971).

    """

    single, knots, takes = True, 1, frozenset({OBSERVATION})

    def __init__(self, coordinates: list[str], gain: float = 0.0, damping: float = 0.0,
                 timeout: float = 0.5, deviations: list[float] | None = None,
                 predictions: int = 4, velocity_limit: float = 100.0):
        check_positive(timeout=timeout, velocity_limit=velocity_limit)
        check_observed(coordinates, deviations, predictions, gain=gain, damping=damping)
        self.names, self.gain, self.damping = coordinates, float(gain), float(damping)
        self.timeout, self.velocity_limit = float(timeout), float(velocity_limit)

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether splitting leaves the method its order."""
        own = integrator.requirements
        return own.from_state and integrator.order <= 2 and super().accepts(integrator)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> ObserverParameters:
        """Return the places, the gains, and what is observed."""
        places = np.array([coordinate_index(coordinates, name) for name in self.names])
        reach = self.velocity_limit / max(self.damping, 1.0 / self.timeout)
        return ObserverParameters(places, self.gain, self.damping, self.velocity_limit, reach,
                                  state.reference.knots, state.clock)

    def prepare(self, command: Command, parameters: ObserverParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return what sets an observation; see Commanded."""
        return prepare(command, parameters, self.names, self.timeout, q)

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two half flows; see StepEffect."""
        return strang(flow, step, keeps_gradient)
