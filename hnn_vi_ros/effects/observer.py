# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observer that draws a simulation towards the machine that it is the twin of."""

from collections.abc import Callable, Sequence
from functools import cache
import math

from hnn_vi_ros.effects.base import coordinate_index, EffectState, StepEffect
from hnn_vi_ros.effects.commands import Command, Commanded, OBSERVATION
from hnn_vi_ros.effects.observations import check_observed, ObserverParameters, prepare
from hnn_vi_ros.effects.splitting import strang
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.integrators.base import Integrator, Step
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Observer(StepEffect, Commanded):
    """
    A Luenberger observer: q' = H_p - lambda (q - y), p' = -H_q - k (q - y), y(t) observed.

    The pull and the decay to y are taken by their exact flow for half a step, before and after
    that of a method of order 1 or 2 (Strang). Errors of a mass m decay by s^2 + lambda s + k / m.
    y goes on at the observed velocity until the next. Energy account: the change of H.

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
                 predictions: int = 4):
        check_positive(timeout=timeout)
        check_observed(coordinates, deviations, predictions, gain=gain, damping=damping)
        self.names, self.gain, self.damping = coordinates, float(gain), float(damping)
        self.timeout = float(timeout)

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether splitting leaves the method its order."""
        own = integrator.requirements
        return own.from_state and integrator.order <= 2 and super().accepts(integrator)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> ObserverParameters:
        """Return the places, the gains, and what is observed."""
        places = np.array([coordinate_index(coordinates, name) for name in self.names])
        knots = state.reference.knots
        return ObserverParameters(places, self.gain, self.damping, knots, state.clock)

    def prepare(self, command: Command, parameters: ObserverParameters, q: np.ndarray
                ) -> Callable[[], None]:
        """Return what sets an observation; see Commanded."""
        return prepare(command, parameters, self.names, self.timeout)

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two half flows; see StepEffect."""
        return strang(_flow, step, keeps_gradient)


@inlined
def _flow(own: ObserverParameters, h: float, q: np.ndarray, p: np.ndarray, p_carry: np.ndarray
          ) -> None:
    # Half a step from either end is the same instant: the splitting stays symmetric.
    t, row = own.clock[0] + h, own.knots[own.knots.shape[0] - 1]
    n, decay = own.places.size, math.expm1(-own.damping * h)
    # The integral of exp(-lambda t) over h: both act together.
    pull = own.gain * (-decay / own.damping if own.damping > 0.0 else h)
    if t <= row[0] and own.gain + own.damping > 0.0:
        for k in range(n):
            i = own.places[k]
            away = q[i] - row[2 + k] - (t - row[1]) * row[2 + n + k]
            p[i] -= pull * away
            q[i] += decay * away
