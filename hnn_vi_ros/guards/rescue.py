# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that another method had to take."""

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
from hnn_vi_ros.simulation import Simulation


class RescueGuard(Guard):
    """
    The scene's method takes all steps: none in sub-steps or by the midpoint rule.

    Each change of method leaves H where it is, but moves what the method itself conserves.

    Parameters
    ----------
    simulation : Simulation
        Whose steps are counted.

    """

    kind = 'rescued steps'
    remedy = ('use a smaller step_size, or a method whose equations can be solved at this '
              'one')

    def __init__(self, simulation: Simulation):
        self._simulation, self._seen = simulation, 0

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        before, self._seen = self._seen, self._simulation.rescued
        return self.renew(sample) if before == 0 < self._seen else None

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        count = self._simulation.rescued
        # Those who look at a path afterwards see the counts of its end.
        return Alarm(self.kind, self._simulation.steps, count, 0,
                     f'{count} steps so far were taken otherwise than by the integrator, as '
                     'on_failure says; use a smaller step_size or another integrator', '1')
