# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of what is conserved: the account of energy and work, ranges of it and of invariants."""

from abc import abstractmethod
from collections.abc import Callable
import math

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
from hnn_vi_ros.simulation.guards.base import (
    accounted_energy, Alarm, Block, BlockGuard, Observed, Scale)
from hnn_vi_ros.simulation.guards.saddles import SaddleSearch
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np


@kept(error_model='numpy')
def _widen(ends: np.ndarray, values: np.ndarray, weights: np.ndarray, limits: np.ndarray,
           first: int, raised: bool) -> tuple[int, float, bool]:
    """Widen ranges by values (n, k) from the first on, up to one beyond its limit, if any."""
    band = 0.0
    for i in range(first, values.shape[1]):
        # No value, as of NaN, leaves 0; infinite values leave NaN.
        band, beyond = 0.0, False
        for j in range(len(values)):
            if math.isnan(values[j, i]):
                beyond = True
            else:
                ends[0, j] = min(ends[0, j], values[j, i])
                ends[1, j] = max(ends[1, j], values[j, i])
            if ends[1, j] >= ends[0, j]:
                own = (ends[1, j] - ends[0, j]) / weights[j]
                if not (own <= band or math.isnan(band)):
                    band = own
        # Written so that NaN is an alarm.
        if not raised and (beyond or not band <= limits[i]):
            return i + 1, band, True
    return values.shape[1], band, False


class BandGuard(BlockGuard):
    """
    Base of guards: the range of the accounted energy, or of other values, so far.

    Parameters
    ----------
    share : float, optional
        The band that is allowed, over a scale, where there is one.
    weights : tuple of float, optional
        For each of the values: over how much of it its range counts.

    Attributes
    ----------
    raised : bool
        Whether there was an alarm.
    band : float
        The range so far.
    limit : float
        What is allowed, as of the last sample.

    """

    def __init__(self, share: float = math.nan, weights: tuple[float, ...] = (1.0,)):
        self.raised, self.band, self.limit, self._share = False, 0.0, math.nan, share
        self._weights = np.array(weights)
        # Of each value the lowest and the highest so far.
        self._ends = np.repeat([[math.inf], [-math.inf]], len(weights), axis=1)

    def allow(self, band: float, change: float) -> None:
        self._share = band

    def take(self, block: Block) -> list[Alarm]:
        values, limits = self._values(block), self._limits(block)
        alarms, taken = [], 0
        while taken < len(limits):
            taken, self.band, beyond = _widen(
                self._ends, values, self._weights, limits, taken, self.raised)
            self.limit = float(limits[taken - 1])
            if beyond:
                self.raised = True
                alarms.append(self._alarm(int(block.step[taken - 1])))
        return alarms

    def renew(self, sample: Observed) -> Alarm | None:
        return self._alarm(sample.step)

    def _values(self, block: Block) -> np.ndarray:
        """Return the values whose range is watched, shape (n, k) with a weight for each n."""
        return block.accounted[None]

    @abstractmethod
    def _limits(self, block: Block) -> np.ndarray:
        """Return the band that is allowed as of each sample, shape (k,)."""

    @abstractmethod
    def _alarm(self, step: int) -> Alarm:
        """Return what to say of a band that is beyond the limit."""


def plain_share(simulation: Simulation) -> float:
    """
    Return how many times as far as the modified energy H may go, 1 where none is known.

    That H swings is the method's own, and no loss, but beyond a tenth of the energies in play it
    is no resolution.
    """
    return 1.0 if simulation.modification is None else 2.0


# H of a method of order 1 is judged at once where it goes this many times as far as it may.
_AT_ONCE = 2.0


@kept(error_model='numpy')
def _first_lasting(own: np.ndarray, step: np.ndarray, energy: np.ndarray, limits: np.ndarray,
                   times: float) -> int:
    """Return the first sample at which H is too far and was at half the time; -1 for none."""
    for i in range(len(step)):
        if own[2] < 0.0:
            own[2] = step[i]
        own[0], own[1] = min(own[0], energy[i]), max(own[1], energy[i])
        band = own[1] - own[0]
        if not band > limits[i]:
            own[3] = math.inf
        else:
            own[3] = min(own[3], step[i])
            if step[i] - own[2] >= 2.0 * (own[3] - own[2]) or band > times * limits[i]:
                return i
    return -1


class ResolutionGuard(BandGuard):
    """
    The step resolves the motion: H, and H~ where known, stay within a share of the energy scale.

    A method of order 1 is given time: from an apocentre on, energies are small at first, and so
    is their scale. Only where H has gone twice as far as it may is it told at once, else where it
    has been too far since half the time of the run.

    Parameters
    ----------
    share : float
        The band that is allowed, over the scale.
    scale : callable
        Returns the energy scale at each sample of a block [J]; see SampledScale.
    plain : float, optional
        How many times that share is allowed for H; see ``plain_share``.
    order : int, optional
        Of the method.

    """

    kind = 'under-resolved'
    remedy = ('use a smaller step_size, such as the one that `simulate` and `hnn run` name, or a '
              'method of higher order')

    def __init__(self, share: float, scale: Scale, plain: float = 1.0, order: int = 2):
        self._patient = order == 1 and plain > 1.0
        # Of the range of H a part counts; of a method of order 1 it is judged by itself.
        super().__init__(share, (1.0, math.inf if self._patient else plain))
        self._scale, self._plain = scale, plain
        # Lowest and highest H, the first step, and since when H has been too far.
        self._own = np.array([math.inf, -math.inf, -1.0, math.inf])

    def take(self, block: Block) -> list[Alarm]:
        if not self._patient or self.raised:
            return super().take(block)
        i = _first_lasting(self._own, block.step, block.energy,
                           self._plain * self._limits(block), _AT_ONCE)
        alarms = super().take(block)
        if i < 0 or (alarms and alarms[0].step <= block.step[i]):
            return alarms
        self.raised = True
        return [self._tell(int(block.step[i]), float(self._own[1] - self._own[0]),
                           self._plain * float(self._limits(block)[i]), self._plain)]

    def _values(self, block: Block) -> np.ndarray:
        return np.array([block.accounted, block.energy])

    def _limits(self, block: Block) -> np.ndarray:
        return self._share * self._scale(block)

    def _alarm(self, step: int) -> Alarm:
        kept, swing = self._ends[1] - self._ends[0]
        # Report H, if H went too far.
        band, times = (swing, self._plain) if swing > self._plain * kept else (kept, 1.0)
        return self._tell(step, float(band), times * self.limit, times)

    def _tell(self, step: int, band: float, limit: float, times: float) -> Alarm:
        if not (limit > 0.0 and math.isfinite(band / limit)):
            return Alarm(self.kind, step, band, limit, 'the energy is infinite, or no number: '
                         'under-resolved; use a smaller step_size, or start elsewhere')
        return Alarm(self.kind, step, band, limit,
                     f'the energy error exceeds {100.0 * self._share * times:g} % of the energy '
                     'scale; use a smaller step_size, or a method of higher order')


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
    search : SaddleSearch, optional
        Finds saddles along the run, the nearest in energy of which is the barrier.

    """

    kind = 'not resolved'
    remedy = ('use a smaller step_size or a method of higher order: the energy error '
              'decides on which side of the barrier the motion is')

    def __init__(self, name: str, energy: float, order: int = 1,
                 search: SaddleSearch | None = None):
        super().__init__()
        self._plain = order > 1
        self.kind, self._name = f'{name} not resolved', name
        self._found, self._search = [] if search else [energy], search
        self._gap, self._start = math.inf, (math.nan, math.nan)

    def take(self, block: Block) -> list[Alarm]:
        """See BlockGuard; as long as no barrier is known, nothing is told."""
        alarms = super().take(block)
        self.raised &= self._gap < math.inf
        return alarms if self.raised else []

    def _limits(self, block: Block) -> np.ndarray:
        if math.isnan(self._start[0]):
            self._start = float(block.energy[0]), float(self._values(block)[0, 0])
        limits = np.full(len(block.step), self._gap)
        found = [(0, energy) for energy in self._found]
        self._found.clear()
        for i, energy in [*found, *(self._search.take(block) if self._search else ())]:
            # At a saddle H~ is H, as the gradient is zero: what is conserved must be on the side
            # of it that H is on.
            plain, kept = (energy - start for start in self._start)
            self._gap = min(self._gap, abs(kept) if plain * kept > 0.0 else 0.0)
            limits[i:] = self._gap
        return limits

    def _values(self, block: Block) -> np.ndarray:
        return (block.energy - block.work if self._plain else block.accounted)[None]

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self.band, self.limit,
                     f'the energy is kept only to {self.band:.2g} J, but the {self._name} is '
                     f'{self.limit:.2g} J away: {self.kind}; use a smaller step_size')


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
        super().__init__(share)
        self.kind, self._name = f'{name} not conserved', name
        self._function, self._hamiltonian, self._seen = function, hamiltonian, 0
        self._scales: list[float] = []

    def _values(self, block: Block) -> np.ndarray:
        return np.array([[self._function(q, p) for q, p in zip(block.q, block.p, strict=True)]])

    def _limits(self, block: Block) -> np.ndarray:
        limits = []
        for q, p in zip(block.q, block.p, strict=True):
            self._seen += 1
            if self._seen & (self._seen - 1) == 0:
                self._scales.append(self._scale_at(q, p))
            limits.append(self._share * sum(self._scales) / len(self._scales))
        return np.array(limits)

    def _scale_at(self, q: np.ndarray, p: np.ndarray) -> float:
        z, d = np.concatenate([q, p]), q.size
        total = 0.0
        for i, size in enumerate(state_scales(self._hamiltonian, q, p)):
            sides = np.array([z, z])
            sides[:, i] += _SPACING * size, -_SPACING * size
            ahead, behind = (self._function(x[:d], x[d:]) for x in sides)
            total += abs(ahead - behind) / (2.0 * _SPACING)
        return total

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self.band, self.limit,
                     f'{self._name} has moved by {self.band:.2g}, more than {self.limit:.2g}: it '
                     'is not conserved; use a smaller step_size, or a method that conserves it',
                     '1')


# A change for good is looked for in that many blocks at least, of that many samples each at least.
_BLOCKS, _BLOCK = 50, 20
# It must last from one length of the run to this many times that: a slow swing does not.
_LASTING = 5
# A sudden change by this multiple of the energies in play is no oscillation any more.
_JUMP = 10.0


@kept(error_model='numpy')
def _turn_over(own: np.ndarray, work: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return the scale, or the work turned over if more; own are the work and that so far."""
    larger = np.empty(len(work))
    for i in range(len(work)):
        own[1] += abs(work[i] - own[0])
        own[0] = work[i]
        larger[i] = scales[i] if scales[i] >= own[1] or math.isnan(own[1]) else own[1]
    return larger


@kept(error_model='numpy')
def _change(ends: np.ndarray, accounted: np.ndarray, start: float, scales: np.ndarray, first: int,
            last: int) -> tuple[int, bool]:
    """Widen the range of the change; return the place of a jump in it, or the last one."""
    at, jumped = last - 1, False
    for i in range(first, last):
        change = accounted[i] - start
        if change < ends[0]:
            ends[0] = change
        if change > ends[1]:
            ends[1] = change
        # Written so that NaN is an alarm.
        if not (jumped or abs(change) <= _JUMP * scales[i]):
            at, jumped = i, True
    return at, jumped


class EnergyGuard(BlockGuard):
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
        Returns the energy scale at each sample of a block [J]; see SampledScale.

    """

    kind = 'energy not accounted for'
    remedy = ('take a symplectic method in the place of a baseline, or a smaller step_size; '
              'where an effect acts, check that it is listed in the scene')

    def __init__(self, share: float, scale: Scale):
        self.raised, self._how = False, (share, '')
        self._share, self._scale_at, self._scale = share, scale, 0.0
        # The work so far, and what has been turned over by it.
        self._turned = np.zeros(2)
        self._start: float | None = None
        self._low: list[float] = []
        self._high: list[float] = []
        self._count, self._length = 0, _BLOCK
        # Of the block that is open.
        self._ends = np.array([math.inf, -math.inf])
        self._since, self._sign = math.inf, 0

    def allow(self, band: float, change: float) -> None:
        self._share = change

    def take(self, block: Block) -> list[Alarm]:
        if self._start is None:
            self._start = float(block.accounted[0])
        scales = _turn_over(self._turned, block.work, self._scale_at(block))
        alarms, first = [], 0
        while first < len(scales):
            # Up to where a block of this guard ends.
            last = min(len(scales), first + self._length - self._count)
            i, jumped = _change(self._ends, block.accounted, self._start, scales, first, last)
            self._count, self._scale = self._count + last - first, float(scales[i])
            step, change = int(block.step[i]), abs(float(block.accounted[i]) - self._start)
            if jumped and not self.raised:
                alarms.append(self._alarm(step, change, _JUMP, 'changed'))
            if self._count == self._length and (change := self._end_block()) and not self.raised:
                alarms.append(self._alarm(step, change, self._share, 'changed for good'))
            first = last
        self._scale = float(scales[-1])
        return alarms

    @property
    def calm(self) -> tuple[float, float]:
        """See BlockGuard: ten times the scale that was known when it looked last."""
        if self.raised:
            return super().calm
        if self._start is None:
            return math.inf, -math.inf
        return self._start - _JUMP * self._scale, self._start + _JUMP * self._scale

    def renew(self, sample: Observed) -> Alarm | None:
        assert self._start is not None, 'an alarm was raised, by a sample'
        change = abs(accounted_energy(sample) - self._start)
        return self._alarm(sample.step, change, *self._how)

    def _end_block(self) -> float:
        """Close a block; return by how much the energy has changed for good, 0 if it has not."""
        self._low.append(float(self._ends[0]))
        self._high.append(float(self._ends[1]))
        self._count, self._ends[:] = 0, (math.inf, -math.inf)
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
        return Alarm(self.kind, step, value, share * self._scale,
                     f'the energy has {how} by more than {100.0 * share:g} % of the energy '
                     'scale, beyond the work that was done: take a symplectic method or a smaller '
                     'step_size')


def is_wrong(kind: str) -> bool:
    """Return whether alarms of a kind say that a run may be qualitatively wrong."""
    return kind.endswith(tuple(guard.kind for guard in (
        ResolutionGuard, BarrierGuard, InvariantGuard, EnergyGuard)))
