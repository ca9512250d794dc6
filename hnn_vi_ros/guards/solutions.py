# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the equation of each step has one solution that is connected to h = 0."""

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
from hnn_vi_ros.simulation import Simulation


class SolutionGuard(Guard):
    """
    A solution of the equation of a step: the only one that a solver meets, or one at all.

    Parameters
    ----------
    simulation : Simulation
        Whose steps are counted.
    kind : str
        ``'several solutions'`` or ``'no solution'``.

    """

    KINDS = ('several solutions', 'no solution')

    def __init__(self, simulation: Simulation, kind: str):
        self.kind, self._simulation, self._seen = kind, simulation, 0

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        before, self._seen = self._seen, self._count()
        return self.renew(sample) if before == 0 < self._seen else None

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        what = ('the equation of the step has several solutions, and the one connected to h = 0 '
                'is taken' if self.kind == self.KINDS[0] else
                'the equation of the step has no solution: det(I + h H_qp) changes sign, and '
                'steps are taken in parts')
        return Alarm(self.kind, sample.step, self._count(), 0,
                     f'{what}, in {self._count()} steps so far; use a smaller step_size', '1')

    def _count(self) -> int:
        return (self._simulation.several_solutions if self.kind == self.KINDS[0]
                else self._simulation.unsolvable)
