# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the steps: their cost, unsolved equations, and steps that another method took."""

from typing import ClassVar

from hnn_vi_ros.simulation.guards.base import Alarm, Observed, StateGuard
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Times what the equations of a step take at most as a rule.
_SLOW = 5


class CostGuard(StateGuard):
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
        if self._raised or self._simulation.costliest[0] <= self._limit:
            return None
        self._raised = True
        return self.renew(sample)

    def renew(self, sample: Observed) -> Alarm:
        gradients, step = self._simulation.costliest
        return Alarm(self.kind, step, gradients, self._limit,
                     f'a step took {gradients} evaluations of the gradient, where '
                     f'{self._usual} do as a rule; use a smaller '
                     'step_size or another integrator', '1')


class CountGuard(StateGuard):
    """
    Base of guards: a count of the simulation stays zero.

    Parameters
    ----------
    simulation : Simulation
        Whose steps are counted.

    Attributes
    ----------
    counted : str
        Attribute of the simulation that holds the count.
    message : str
        Line of the alarm, with a place for the count.

    """

    counted: ClassVar[str]
    message: ClassVar[str]

    def __init__(self, simulation: Simulation):
        self._simulation, self._seen = simulation, 0

    def update(self, sample: Observed) -> Alarm | None:
        before, self._seen = self._seen, getattr(self._simulation, self.counted)
        return self.renew(sample) if before == 0 < self._seen else None

    def renew(self, sample: Observed) -> Alarm:
        count = getattr(self._simulation, self.counted)
        # Those who look at a path afterwards see the counts of its end.
        return Alarm(self.kind, self._simulation.steps, count, 0, self.message.format(count), '1')


class SolutionGuard(CountGuard):
    """No solver comes to another solution of a step than that which is connected to h = 0."""

    kind = 'several solutions'
    remedy = 'use a smaller step_size: below the fold the equation has one solution'
    counted = 'several_solutions'
    message = ('the equation of a step has several solutions, of which the one connected to '
               'h = 0 is taken, in {} steps so far; use a smaller step_size')


class RescueGuard(CountGuard):
    """
    The scene's method takes all steps: none in sub-steps or by the midpoint rule.

    Each change of method leaves H where it is, but moves what the method itself conserves.
    """

    kind = 'rescued steps'
    remedy = ('use a smaller step_size, or a method whose equations can be solved at this '
              'one')
    counted = 'rescued'
    message = ('{} steps so far were taken otherwise than by the integrator, as on_failure '
               'says; use a smaller step_size or another integrator')
