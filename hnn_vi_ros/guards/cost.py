# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Time that the costliest step has taken, as a bound."""

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Times what the equations of a step take at most as a rule.
_SLOW = 5


class CostGuard(Guard):
    """
    No step takes more than five times the gradients that its method takes at most as a rule.

    A step that does is one whose equations have no solution that the method's own solver finds:
    Newton's method takes it, or sub-steps do. Gradients are counted, and no time is measured, so
    that the same run raises the same alarm everywhere. Of trajectories that step together a step
    takes at most what each would take alone, so that much is allowed.

    Parameters
    ----------
    simulation : Simulation
        Whose steps are watched.

    """

    kind = 'slow step'
    remedy = 'use a smaller step_size, or `time_transformed` for close encounters'

    def __init__(self, simulation: Simulation):
        self._simulation, self._raised = simulation, False
        self._usual = simulation.usual_gradients * np.atleast_2d(simulation.q).shape[0]
        self._limit = _SLOW * self._usual

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        if self._raised or self._simulation.costliest[0] <= self._limit:
            return None
        self._raised = True
        return self.renew(sample)

    def renew(self, sample: Observed) -> Alarm:
        """See Guard."""
        gradients, step = self._simulation.costliest
        return Alarm(self.kind, step, gradients, self._limit,
                     f'a step took {gradients} evaluations of the gradient, where '
                     f'{self._usual} do as a rule; use a smaller '
                     'step_size or another integrator', '1')
