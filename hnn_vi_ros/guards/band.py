# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The range of something conserved as a bound."""

from abc import abstractmethod
import math

from hnn_vi_ros.guards.base import accounted_energy, Alarm, Guard, Observed


class BandGuard(Guard):
    """Base of guards: the range of the accounted energy, or of another value, so far."""

    def __init__(self) -> None:
        self.raised = False
        self._low, self._high = math.inf, -math.inf

    @property
    def band(self) -> float:
        """Return the range so far."""
        return max(self._high - self._low, 0.0)

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        value = self._value(sample)
        if value < self._low:
            self._low = value
        if value > self._high:
            self._high = value
        limit = self._limit(sample)
        # Written so that NaN is an alarm.
        if self.raised or (self.band <= limit and value == value):
            return None
        self.raised = True
        return self._alarm(sample.step, limit)

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        return self._alarm(sample.step, self._limit(sample))

    def _value(self, sample: Observed) -> float:
        return accounted_energy(sample)

    @abstractmethod
    def _limit(self, sample: Observed) -> float:
        """Return the band that is allowed as of a sample."""

    @abstractmethod
    def _alarm(self, step: int, limit: float) -> Alarm:
        """Return what to say of a band that is beyond the limit."""
