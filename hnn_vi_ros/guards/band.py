# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The range of the energy as a bound."""

from abc import abstractmethod
import math

from hnn_vi_ros.guards.base import accounted_energy, Alarm, Guard, Observed


class BandGuard(Guard):
    """What two guards share: the range of the accounted energy since the start."""

    def __init__(self, limit: float):
        self.limit, self.raised = limit, False
        self._low, self._high = math.inf, -math.inf

    @property
    def band(self) -> float:
        """Return the range of the accounted energy so far [J]."""
        return max(self._high - self._low, 0.0)

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        energy = accounted_energy(sample)
        if energy < self._low:
            self._low = energy
        if energy > self._high:
            self._high = energy
        if self.raised or self._high - self._low < self.limit:
            return None
        self.raised = True
        return self._alarm(sample.step)

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        return self._alarm(sample.step)

    @abstractmethod
    def _alarm(self, step: int) -> Alarm:
        """Return what to say of a band that has reached the limit."""
