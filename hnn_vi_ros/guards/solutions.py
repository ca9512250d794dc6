# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Equations of steps with several solutions."""

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
from hnn_vi_ros.simulation import Simulation


class SolutionGuard(Guard):
    """
    No solver comes to another solution of a step than that which is connected to h = 0.

    Parameters
    ----------
    simulation : Simulation
        Whose steps are counted.

    """

    kind = 'several solutions'
    remedy = 'use a smaller step_size: below the fold the equation has one solution'

    def __init__(self, simulation: Simulation):
        self._simulation, self._seen = simulation, 0

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        before, self._seen = self._seen, self._simulation.several_solutions
        return self.renew(sample) if before == 0 < self._seen else None

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        count = self._simulation.several_solutions
        # Those who look at a path afterwards see the counts of its end.
        return Alarm(self.kind, self._simulation.steps, count, 0,
                     'the equation of a step has several solutions, of which the one connected to '
                     f'h = 0 is taken, in {count} steps so far; use a smaller step_size', '1')
