# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The account of energy and work as a bound."""

from collections.abc import Callable
import math

from hnn_vi_ros.guards.base import accounted_energy, Alarm, Guard, Observed

# A change for good is looked for in that many blocks at least, of that many samples each at least.
_BLOCKS, _BLOCK = 50, 20
# It must last from one length of the run to this many times that: a slow swing does not.
_LASTING = 5
# A sudden change by this multiple of the energies in play is no oscillation any more.
_JUMP = 10.0


class EnergyGuard(Guard):
    """
    No energy is lost or gained beyond the account of work: neither at once nor by a drift.

    It counts as lost or gained when, in the whole last third of the run, it is on one side of
    where it started by more than a share of the scale, and stays so while the run grows to five
    times its length; or at once, by ten times the scale. An oscillation comes back before. Where
    effects have turned over more work than the energy scale, in and out together, the shares are
    of that.

    Parameters
    ----------
    share : float
        The lasting change that is allowed, over the scale.
    scale : callable
        Returns the energy scale as of a sample [J]; see SampledScale.

    """

    kind = 'energy not accounted for'
    remedy = ('take a symplectic method in the place of a baseline, or a smaller step_size; '
              'where an effect acts, check that it is listed in the scene')

    def __init__(self, share: float, scale: Callable[[Observed], float]):
        self.raised, self._how = False, (share, '')
        self._share, self._scale_at, self._scale = share, scale, 0.0
        self._work, self._turnover = 0.0, 0.0
        self._start: float | None = None
        self._low: list[float] = []
        self._high: list[float] = []
        self._count, self._length = 0, _BLOCK
        self._lowest, self._highest = math.inf, -math.inf
        self._since, self._sign = math.inf, 0

    def allow(self, band: float, change: float) -> None:
        """See Guard."""
        self._share = change

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        energy = accounted_energy(sample)
        if self._start is None:
            self._start = energy
        if sample.work != self._work:
            self._turnover += abs(sample.work - self._work)
            self._work = sample.work
        self._scale = max(self._scale_at(sample), self._turnover)
        change = energy - self._start
        if change < self._lowest:
            self._lowest = change
        if change > self._highest:
            self._highest = change
        self._count += 1
        if self.raised:
            return None
        # Written so that NaN is an alarm.
        if not abs(change) <= _JUMP * self._scale:
            return self._alarm(sample.step, abs(change), _JUMP, 'changed')
        if self._count < self._length:
            return None
        change = self._end_block()
        if change == 0.0:
            return None
        return self._alarm(sample.step, change, self._share, 'changed for good')

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        assert self._start is not None, 'an alarm was raised, by a sample'
        change = abs(accounted_energy(sample) - self._start)
        self._scale = max(self._scale_at(sample), self._turnover)
        return self._alarm(sample.step, change, *self._how)

    def _end_block(self) -> float:
        """Close a block; return by how much the energy has changed for good, 0 if it has not."""
        self._low.append(self._lowest)
        self._high.append(self._highest)
        self._count, self._lowest, self._highest = 0, math.inf, -math.inf
        blocks, length = len(self._low), self._length
        if blocks < _BLOCKS:
            return 0.0
        low, high = min(self._low[-(blocks // 3):]), max(self._high[-(blocks // 3):])
        if blocks == 2 * _BLOCKS:
            self._low = [min(pair) for pair in zip(self._low[::2], self._low[1::2], strict=True)]
            self._high = [max(pair)
                          for pair in zip(self._high[::2], self._high[1::2], strict=True)]
            self._length *= 2
        lasting = self._share * self._scale
        sign = 1 if low > lasting else -1 if high < -lasting else 0
        if sign != self._sign:
            self._sign, self._since = sign, blocks * length
        lasts = sign and blocks * length >= _LASTING * self._since
        return min(abs(low), abs(high)) if lasts else 0.0

    def _alarm(self, step: int, value: float, share: float, how: str) -> Alarm:
        self.raised, self._how = True, (share, how)
        if not math.isfinite(value):
            return Alarm(self.kind, step, value, share * self._scale,
                         'the energy is infinite, or no number; start elsewhere, or use a '
                         'smaller step_size')
        relative = value / self._scale if self._scale > 0.0 else math.inf
        return Alarm(self.kind, step, value, share * self._scale,
                     f'the energy has {how} by {value:.2g} J, {relative:.2g} of the '
                     'energies in play, beyond the work that was done: take a symplectic method '
                     'or a smaller step_size')
