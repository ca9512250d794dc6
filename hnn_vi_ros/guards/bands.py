# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of what is conserved: the account of energy and work, ranges of it and of invariants."""

from abc import abstractmethod
from collections.abc import Callable
import math

from hnn_vi_ros.accuracy.diagnostics import state_scales
from hnn_vi_ros.guards.base import (
    accounted_energy, Alarm, Block, BlockScale, Guard, Observed, scales_over)
from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np


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


def _range(low: float, high: float, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest value as of each of some values."""
    return (np.minimum.accumulate(np.concatenate([[low], values]))[1:],
            np.maximum.accumulate(np.concatenate([[high], values]))[1:])


def _taken(scale: object, block: Block) -> None:
    if isinstance(scale, BlockScale):
        scale.take(block)


# H may go this many times as far as the modified energy that the method keeps: that it does is
# the method's own, and no loss, but beyond a fifth of the energies in play it is no resolution.
PLAIN = 4.0


class ResolutionGuard(BandGuard):
    """
    The step resolves the motion: the modified energy stays within a share of the energy scale.

    H itself stays within four times that share; where no modified energy is known, within it.

    Parameters
    ----------
    share : float
        The band that is allowed, over the scale.
    scale : callable
        Returns the energy scale as of a sample [J]; see SampledScale.
    modified : bool, optional
        Whether a modified energy is known.

    """

    kind = 'under-resolved'
    remedy = ('use a smaller step_size, such as the one that `simulate` and `hnn run` name, or a '
              'method of higher order')

    def __init__(self, share: float, scale: Callable[[Observed], float], modified: bool = False):
        super().__init__()
        self._share, self._scale, self._modified = share, scale, modified
        self._lowest, self._highest = math.inf, -math.inf

    def allow(self, band: float, change: float) -> None:
        """See Guard."""
        self._share = band

    @property
    def band(self) -> float:
        """Return the range of the modified energy, or a quarter of that of H if larger [J]."""
        return max(super().band, self._plain_band / PLAIN) if self._modified else super().band

    @property
    def _plain_band(self) -> float:
        return max(self._highest - self._lowest, 0.0)

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        if sample.energy < self._lowest:
            self._lowest = sample.energy
        if sample.energy > self._highest:
            self._highest = sample.energy
        return super().update(sample)

    def quiet(self, block: Block) -> Callable[[], None] | None:
        """See Guard."""
        scales = scales_over(self._scale, block)
        if scales is None or not np.isfinite(block.accounted + block.energy).all():
            return None
        low, high = _range(self._low, self._high, block.accounted)
        lowest, highest = _range(self._lowest, self._highest, block.energy)
        bands = high - low
        if self._modified:
            bands = np.maximum(bands, (highest - lowest) / PLAIN)
        if not (self.raised or (bands <= self._share * scales).all()):
            return None

        def take() -> None:
            self._low, self._high = float(low[-1]), float(high[-1])
            self._lowest, self._highest = float(lowest[-1]), float(highest[-1])
            _taken(self._scale, block)
        return take

    def _limit(self, sample: Observed) -> float:
        return self._share * self._scale(sample)

    def _alarm(self, step: int, limit: float) -> Alarm:
        # Report H, if H went too far.
        plain = self._modified and self.band > super().band
        band, limit = (PLAIN * x if plain else x for x in (self.band, limit))
        if not (limit > 0.0 and math.isfinite(band / limit)):
            return Alarm(self.kind, step, band, limit, 'the energy is infinite, or no number: '
                         'under-resolved; use a smaller step_size, or start elsewhere')
        share = self._share * self.band / limit * (PLAIN if plain else 1.0)
        return Alarm(self.kind, step, band, limit,
                     f'the energy is kept only to {share:.2g} of the energies in play: '
                     'under-resolved; use a smaller step_size, or a method of higher order')


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


# Spacing of differences relative to the state; they need be good to a tenth only.
_SPACING = 1e-4


class InvariantGuard(BandGuard):
    """
    An invariant stays within a share of the change that the state could cause.

    That scale is the sum over i of abs(dI/dz_i) s_i, with s_i the size of the state or of the
    training box (``state_scales``): no constant in I changes it. It is the mean of those at the
    samples 1, 2, 4, 8, ..., which do not all lie at the start.

    Parameters
    ----------
    name : str
        Name of the invariant.
    function : callable
        Of q and p, each of shape (d,).
    share : float
        The band that is allowed, over the scale.
    hamiltonian : Hamiltonian
        H of the motion.

    """

    kind = 'not conserved'
    remedy = ('use a smaller step_size, or a method that conserves it: Gauss methods keep '
              'quadratic invariants')

    def __init__(self, name: str, function: Callable[[np.ndarray, np.ndarray], float],
                 share: float, hamiltonian: Hamiltonian):
        super().__init__()
        self.kind, self._name = f'{name} not conserved', name
        self._function, self._share, self._hamiltonian = function, share, hamiltonian
        self._seen = 0
        self._scales: list[float] = []

    def allow(self, band: float, change: float) -> None:
        """See Guard."""
        self._share = band

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        self._seen += 1
        if self._seen & (self._seen - 1) == 0:
            self._scales.append(self._scale_at(sample.q, sample.p))
        return super().update(sample)

    def _value(self, sample: Observed) -> float:
        return self._function(sample.q, sample.p)

    def _limit(self, sample: Observed) -> float:
        return self._share * sum(self._scales) / len(self._scales)

    def _scale_at(self, q: np.ndarray, p: np.ndarray) -> float:
        z, d = np.concatenate([q, p]), q.size
        total = 0.0
        for i, size in enumerate(state_scales(self._hamiltonian, q, p)):
            sides = np.array([z, z])
            sides[:, i] += _SPACING * size, -_SPACING * size
            ahead, behind = (self._function(x[:d], x[d:]) for x in sides)
            total += abs(ahead - behind) / (2.0 * _SPACING)
        return total

    def _alarm(self, step: int, limit: float) -> Alarm:
        return Alarm(self.kind, step, self.band, limit,
                     f'{self._name} has moved by {self.band:.2g}, more than {limit:.2g}: it is '
                     'not conserved; use a smaller step_size, or a method that conserves it',
                     '1')


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

    @property
    def calm(self) -> tuple[float, float]:
        """See Guard: ten times the scale that was known when it looked last."""
        if self.raised:
            return super().calm
        if self._start is None:
            return math.inf, -math.inf
        return self._start - _JUMP * self._scale, self._start + _JUMP * self._scale

    @property
    def ahead(self) -> float:
        """See Guard: the sample that closes a block of this guard is looked at by itself."""
        return math.inf if self.raised else self._length - self._count - 1

    def quiet(self, block: Block) -> Callable[[], None] | None:
        """See Guard."""
        scales = scales_over(self._scale_at, block)
        if self._start is None or scales is None or not np.isfinite(
                block.accounted + block.work).all():
            return None
        turnover = np.add.accumulate(np.concatenate([
            [self._turnover], np.abs(np.diff(block.work, prepend=self._work))]))[1:]
        scales = np.maximum(scales, turnover)
        changes = block.accounted - self._start
        if not (self.raised or (np.abs(changes) <= _JUMP * scales).all()):
            return None

        def take() -> None:
            self._work, self._turnover = float(block.work[-1]), float(turnover[-1])
            self._scale = float(scales[-1])
            self._lowest = min(self._lowest, float(changes.min()))
            self._highest = max(self._highest, float(changes.max()))
            self._count += changes.size
            _taken(self._scale_at, block)
        return take

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
