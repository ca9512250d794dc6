# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards that watch a run sample by sample and say when it is no longer to be trusted."""

from abc import ABC, abstractmethod
import math
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

# A change for good is looked for in that many blocks at least, of that many samples each at least.
_BLOCKS, _BLOCK = 50, 20
# It must last from one length of the run to this many times that: a slow swing does not.
_LASTING = 5


class Observed(Protocol):
    """What guards look at; a Sample is one."""

    step: int
    q: np.ndarray
    p: np.ndarray
    energy: float
    modified_energy: float
    work: float


class Alarm(NamedTuple):
    """
    What a guard found.

    Parameters
    ----------
    kind : str
        Which guard: the same words each time.
    step : int
        Steps since the start of the run.
    value, limit : float
        What was found, and what would have been allowed.
    message : str
        One line: what, by how much, remedy.

    """

    kind: str
    step: int
    value: float
    limit: float
    message: str


class Guard(ABC):
    """Something that must hold all the time; it costs about as much as ten additions."""

    kind: ClassVar[str]

    @abstractmethod
    def update(self, sample: Observed) -> Alarm | None:
        """Look at the next sample; return an alarm when it stops to hold, not while it lasts."""


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H where there is none, less the work done on the system [J]."""
    modified = sample.modified_energy
    return (sample.energy if math.isnan(modified) else modified) - sample.work


class BoxGuard(Guard):
    """
    The state is inside the box that the model was trained in.

    Parameters
    ----------
    box : tuple of np.ndarray
        Bounds of q and of p, each (d, 2), as ``Hamiltonian.box``.

    Attributes
    ----------
    excess : float
        How far the last sample is outside, in half-widths of the box; 0 inside.

    """

    kind = 'out of the training box'

    def __init__(self, box: tuple[np.ndarray, np.ndarray]):
        self.excess = 0.0
        bounds = np.concatenate(box)
        # Plain floats: for the few coordinates of a model they are faster than arrays.
        self._low, self._high = bounds.T.tolist()

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        values, low, high = sample.q.tolist() + sample.p.tolist(), self._low, self._high
        for i, x in enumerate(values):
            if not low[i] <= x <= high[i]:
                return self._outside(sample.step, values)
        self.excess = 0.0
        return None

    def _outside(self, step: int, values: list[float]) -> Alarm | None:
        before = self.excess
        self.excess = max(2.0 * max(x - high, low - x) / (high - low)
                          for x, low, high in zip(values, self._low, self._high, strict=True))
        if before > 0.0:
            return None
        return Alarm(self.kind, step, self.excess, 0.0,
                     f'outside of the box that the model was trained in, by {self.excess:.2g} of '
                     'its half-width: H is a guess there; train a model on a larger box')


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

    @abstractmethod
    def _alarm(self, step: int) -> Alarm:
        """Return what to say of a band that has reached the limit."""


class ResolutionGuard(BandGuard):
    """
    The step resolves the motion: the modified energy stays within a share of the energy.

    Parameters
    ----------
    share : float
        The band that is allowed, over the scale.
    scale : float
        Of the energies in play [J]; see ``diagnostics.energy_scale``.
    step_size : float
        h [s].
    order : int
        The band is O(h^order): 2 for the modified energy of a method of order 1, else the order
        of the method.

    """

    kind = 'under-resolved'

    def __init__(self, share: float, scale: float, step_size: float, order: int):
        super().__init__(share * scale)
        self._scale, self._step_size, self._order = scale, step_size, order

    def allow(self, share: float) -> None:
        """Change what is allowed."""
        self.limit = share * self._scale

    def _alarm(self, step: int) -> Alarm:
        share = self.band / self._scale
        enough = self._step_size * (self.limit / self.band) ** (1.0 / self._order)
        # Rounded down, to two digits.
        digits = 10.0 ** (math.floor(math.log10(enough)) - 1)
        enough = math.floor(enough / digits) * digits
        return Alarm(self.kind, step, self.band, self.limit,
                     f'the energy is kept only to {share:.2g} of its size: under-resolved; use '
                     f'step_size <= {enough:.2g} s')


class BarrierGuard(BandGuard):
    """
    The energy is kept better than its distance from that of a barrier.

    Parameters
    ----------
    name : str
        What the barrier is: 'separatrix', 'escape barrier'.
    gap : float
        Its energy less that of the motion [J]; negative above it.

    """

    kind = 'not resolved'

    def __init__(self, name: str, gap: float):
        super().__init__(abs(gap))
        self.kind, self._name = f'{name} not resolved', name

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self.band, self.limit,
                     f'the energy is kept only to {self.band:.2g} J, but the {self._name} is '
                     f'{self.limit:.2g} J away: {self.kind}; use a smaller step_size')


class EnergyGuard(Guard):
    """
    No energy is lost or gained beyond the account of work: neither at once nor by a drift.

    It counts as lost or gained when, in the whole last third of the run, it is on one side of
    where it started by more than a share of the scale, and stays so while the run grows to five
    times its length. An oscillation comes back before. Where effects have turned over more work
    than the scale, in and out together, the shares are of that.

    Parameters
    ----------
    share : float
        The lasting change that is allowed, over the scale.
    gain : float
        The change at once that is allowed, over the scale.
    scale : float
        Of the energies in play [J].

    """

    kind = 'energy not accounted for'

    def __init__(self, share: float, gain: float, scale: float):
        self.raised = False
        self._share, self._gain, self._scale = share, gain, scale
        self._work, self._turnover = 0.0, 0.0
        self._start: float | None = None
        self._low: list[float] = []
        self._high: list[float] = []
        self._count, self._length = 0, _BLOCK
        self._lowest, self._highest = math.inf, -math.inf
        self._since, self._sign = math.inf, 0

    def allow(self, share: float) -> None:
        """Change the lasting change that is allowed."""
        self._share = share

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        energy = accounted_energy(sample)
        if self._start is None:
            self._start = energy
        if sample.work != self._work:
            self._turnover += abs(sample.work - self._work)
            self._work, self._scale = sample.work, max(self._scale, self._turnover)
        change = energy - self._start
        if change < self._lowest:
            self._lowest = change
        if change > self._highest:
            self._highest = change
        self._count += 1
        if self.raised:
            return None
        # Written so that NaN is an alarm.
        if not abs(change) <= self._gain * self._scale:
            self.raised = True
            return self._alarm(sample.step, abs(change), self._gain, 'changed')
        if self._count < self._length:
            return None
        change = self._end_block()
        if change == 0.0:
            return None
        self.raised = True
        return self._alarm(sample.step, change, self._share, 'changed for good')

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
        return Alarm(self.kind, step, value, share * self._scale,
                     f'the energy has {how} by {value:.2g} J, {value / self._scale:.2g} of its '
                     'size, beyond the work that was done: take a symplectic method or a smaller '
                     'step_size')
