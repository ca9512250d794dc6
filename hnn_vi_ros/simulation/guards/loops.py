# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the loops of a robot: they stay closed, and keep away from singular positions."""

from collections.abc import Iterator

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.simulation.guards.base import Guard, LimitGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed
import numpy as np


class _LoopGuard(LimitGuard):
    """Base class of guards of the loops of a simulation."""

    def __init__(self, loops: LoopManifold):
        self._loops = loops

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        loops = run.simulation.system.constraints
        if isinstance(loops, LoopManifold):
            yield cls(loops)


class ClosureGuard(_LoopGuard):
    """Loops: they stay closed, also in the equations that depend on others and were dropped."""

    kind, limit = 'loop open', 1e-10
    remedy = ('start where the linkage is not singular: an equation that depends on others only '
              'there is dropped')
    message = 'loops are open by {:.3g} of their length; start where the linkage is not singular'

    def value(self, sample: Observed) -> float:
        """Return the largest error of closure, relative to the length of the chains."""
        return float(np.abs(self._loops.errors(sample.q)).max())


class SingularGuard(_LoopGuard):
    """Singular positions: no step moves by more than half of the distance to one."""

    kind, limit = 'singular position', 0.5
    remedy = ('use a smaller step_size, or keep away from the position: there the linkage can '
              'continue in several ways')
    message = ('the linkage was stretched or folded: a step moved it by {:.3g} of the distance to '
               'a position where its loops are singular and it can continue in several ways; use '
               'a smaller step_size')

    def __init__(self, loops: LoopManifold):
        super().__init__(loops)
        loops.constraints.sine[:] = 0.0

    def value(self, sample: Observed) -> float:
        """Return the largest relative change of the distance in a step; see Constraints."""
        return float(self._loops.constraints.sine[1])
