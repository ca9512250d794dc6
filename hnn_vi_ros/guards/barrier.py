# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the energy is kept well enough to tell on which side of a barrier the motion is."""

import math

from hnn_vi_ros.guards.band import BandGuard
from hnn_vi_ros.guards.base import accounted_energy, Alarm, Observed


class BarrierGuard(BandGuard):
    """
    The energy is kept better than its distance from that of a barrier.

    Parameters
    ----------
    name : str
        What the barrier is: 'separatrix', 'escape barrier'.
    energy : float
        That of the barrier [J]; the motion's is that of the first sample, H~ where it is known.

    """

    kind = 'not resolved'

    def __init__(self, name: str, energy: float):
        super().__init__()
        self.kind, self._name = f'{name} not resolved', name
        self._energy, self._gap = energy, math.nan

    def _limit(self, sample: Observed) -> float:
        if math.isnan(self._gap):
            # At a saddle H~ is H, as the gradient is zero: what is conserved must be on the side
            # of it that H is on.
            plain = self._energy - sample.energy
            kept = self._energy - accounted_energy(sample)
            self._gap = abs(kept) if plain * kept > 0.0 else 0.0
        return self._gap

    def _alarm(self, step: int, limit: float) -> Alarm:
        return Alarm(self.kind, step, self.band, limit,
                     f'the energy is kept only to {self.band:.2g} J, but the {self._name} is '
                     f'{limit:.2g} J away: {self.kind}; use a smaller step_size')
