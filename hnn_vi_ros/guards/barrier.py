# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guard of a barrier: the energy is kept well enough to know on which side the motion is."""

import math

from hnn_vi_ros.guards.band import BandGuard
from hnn_vi_ros.guards.base import accounted_energy, Alarm, Observed


class BarrierGuard(BandGuard):
    """
    The energy is kept better than its distance from that of a barrier.

    Parameters
    ----------
    name : str
        Name of the barrier: 'separatrix', 'escape barrier'.
    energy : float
        That of the barrier [J]; the motion's is that of the first sample.
    order : int, optional
        Of the method. With order 1 the band of H says nothing: H~ is judged where it is known.
        From order 2 on it is H: where H~ stays on one side of the barrier the motion may still
        leave, by as much as H and H~ differ, the region that H below it confines it to.

    """

    kind = 'not resolved'
    remedy = ('use a smaller step_size or a method of higher order: the energy error '
              'decides on which side of the barrier the motion is')

    def __init__(self, name: str, energy: float, order: int = 1):
        super().__init__()
        self._plain = order > 1
        self.kind, self._name = f'{name} not resolved', name
        self._energy, self._gap = energy, math.nan

    def _limit(self, sample: Observed) -> float:
        if math.isnan(self._gap):
            # At a saddle H~ is H, as the gradient is zero: what is conserved must be on the side
            # of it that H is on.
            plain = self._energy - sample.energy
            kept = self._energy - self._value(sample)
            self._gap = abs(kept) if plain * kept > 0.0 else 0.0
        return self._gap

    def _value(self, sample: Observed) -> float:
        return sample.energy - sample.work if self._plain else accounted_energy(sample)

    def _alarm(self, step: int, limit: float) -> Alarm:
        return Alarm(self.kind, step, self.band, limit,
                     f'the energy is kept only to {self.band:.2g} J, but the {self._name} is '
                     f'{limit:.2g} J away: {self.kind}; use a smaller step_size')
