# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The range of the energy as a bound."""

from abc import abstractmethod
import math

from hnn_vi_ros.guards.base import accounted_energy, Alarm, Guard, Observed


class BandGuard(Guard):
    """What two guards share: the range of the accounted energy since the start."""

    def __init__(self):
        self.raised = False
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
        limit = self._limit(sample)
        if self.raised or self.band <= limit:
            return None
        self.raised = True
        return self._alarm(sample.step, limit)

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        return self._alarm(sample.step, self._limit(sample))

    @abstractmethod
    def _limit(self, sample: Observed) -> float:
        """Return the band that is allowed as of a sample [J]."""

    @abstractmethod
    def _alarm(self, step: int, limit: float) -> Alarm:
        """Return what to say of a band that is beyond the limit."""
