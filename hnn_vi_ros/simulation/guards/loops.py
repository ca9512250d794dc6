# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the loops of a robot: they stay closed, and keep away from singular positions."""

from abc import abstractmethod
from typing import ClassVar

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.simulation.guards.base import Alarm, Observed, StateGuard
import numpy as np


class LoopGuard(StateGuard):
    """
    Base class of guards of loops.

    Parameters
    ----------
    loops : LoopManifold
        The loops of the simulation.

    Attributes
    ----------
    limit : float
        Limit of the value that is watched.
    message : str
        Message of the alarm, with a placeholder for the value.

    """

    limit: ClassVar[float]
    message: ClassVar[str]

    def __init__(self, loops: LoopManifold):
        self._loops, self._raised = loops, False

    def update(self, sample: Observed) -> Alarm | None:
        if self._raised or self.value(sample) <= self.limit:
            return None
        self._raised = True
        return self.renew(sample)

    def renew(self, sample: Observed) -> Alarm:
        value = self.value(sample)
        return Alarm(self.kind, sample.step, value, self.limit, self.message.format(value), '1')

    @abstractmethod
    def value(self, sample: Observed) -> float:
        """Return the value that is watched."""


class ClosureGuard(LoopGuard):
    """Loops: they stay closed, also in the equations that depend on others and were dropped."""

    kind, limit = 'loop open', 1e-10
    remedy = ('start where the linkage is not singular: an equation that depends on others only '
              'there is dropped')
    message = 'loops are open by {:.3g} of their length; start where the linkage is not singular'

    def value(self, sample: Observed) -> float:
        """Return the largest error of closure, relative to the length of the chains."""
        return float(np.abs(self._loops.errors(sample.q)).max())


class SingularGuard(LoopGuard):
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
