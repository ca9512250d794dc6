# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of conserved quantities: accounted energy (energy minus work) and invariants."""

from abc import abstractmethod
from collections.abc import Callable, Iterator
import math

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import method_name
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Guard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.saddles import SaddleSearch
from hnn_vi_ros.simulation.guards.samples import accounted_energy, Observed, SampleBlock
from hnn_vi_ros.simulation.guards.scale import Scale
from hnn_vi_ros.simulation.guards.time_jumps import TimeJumps
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np


@kept(error_model='numpy')
def _widen(ends: np.ndarray, values: np.ndarray, weights: np.ndarray, limits: np.ndarray,
           first: int, raised: bool) -> tuple[int, float, bool]:
    """Widen ranges by values (n, k) from `first` on, up to the first one beyond its limit."""
    band = 0.0
    for i in range(first, values.shape[1]):
        # NaN values leave a band of 0; infinite values give NaN.
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
        # The negated comparison makes NaN an alarm.
        if not raised and (beyond or not band <= limits[i]):
            return i + 1, band, True
    return values.shape[1], band, False


class BandGuard(BlockGuard):
    """
    Base class of guards of the range, so far, of the accounted energy or of other values.

    Parameters
    ----------
    share : float, optional
        Allowed band relative to a scale, for guards that have one.
    weights : tuple of float, optional
        Divisors of the ranges of the values.

    Attributes
    ----------
    raised : bool
        True once an alarm was raised.
    band : float
        The range so far.
    limit : float
        Allowed band at the last sample.

    """

    def __init__(self, share: float = math.nan, weights: tuple[float, ...] = (1.0,)):
        self.raised, self.band, self.limit, self._share = False, 0.0, math.nan, share
        self._weights = np.array(weights)
        # Minimum and maximum of each value so far.
        self._ends = np.repeat([[math.inf], [-math.inf]], len(weights), axis=1)

    def allow(self, band: float, change: float) -> None:
        self._share = band

    def take(self, block: SampleBlock) -> list[Alarm]:
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

    def _values(self, block: SampleBlock) -> np.ndarray:
        """Return the n values whose ranges are checked, shape (n, k); one weight per value."""
        return block.accounted[None]

    @abstractmethod
    def _limits(self, block: SampleBlock) -> np.ndarray:
        """Return the allowed band at each sample, shape (k,)."""


def plain_share(simulation: Simulation) -> float:
    """
    Return the allowed range of H relative to that of the modified energy; 1 if none is known.

    Oscillations of H are inherent to the method and no energy loss, but beyond a tenth of the
    energy scale the motion is not resolved.
    """
    return 1.0 if simulation.modification is None else 2.0


# With a method of order 1, a range of H beyond this multiple of its limit is an alarm at once.
_IMMEDIATE_RATIO = 2.0


@kept(error_model='numpy')
def _first_lasting(own: np.ndarray, step: np.ndarray, energy: np.ndarray, limits: np.ndarray,
                   times: float) -> int:
    """Return the first sample with H beyond its limit since half the run; -1 if there is none."""
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
    Resolution of the motion: H, and H~ if known, stay within a share of the energy scale.

    With a method of order 1 the alarm is delayed, because energies and their scale are small at
    first if the run starts at an apocentre: it is raised at once only if the range of H is twice
    its limit, otherwise if the range has been beyond the limit since half the time of the run.

    Parameters
    ----------
    share : float
        Allowed band relative to the scale.
    scale : callable
        Returns the energy scale at each sample of a block [J]; see SampledScale.
    plain : float, optional
        Multiple of the share that is allowed for H; see ``plain_share``.
    order : int, optional
        Order of the method.

    """

    kind = 'under-resolved'
    remedy = ('use a smaller step_size, such as the one that `path not resolved` recommends, '
              'or a method of higher order')

    def __init__(self, share: float, scale: Scale, plain: float = 1.0, order: int = 2):
        self._patient = order == 1 and plain > 1.0
        # The range of H is divided by `plain`; with a method of order 1 it is judged separately.
        super().__init__(share, (1.0, math.inf if self._patient else plain))
        self._scale, self._plain = scale, plain
        # Minimum and maximum of H, first step, and step since which H is beyond its limit.
        self._own = np.array([math.inf, -math.inf, -1.0, math.inf])

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if run.conservative:
            yield cls(run.band_limit, run.scale, plain_share(run.simulation), run.order)

    def take(self, block: SampleBlock) -> list[Alarm]:
        if not self._patient or self.raised:
            return super().take(block)
        i = _first_lasting(self._own, block.step, block.energy,
                           self._plain * self._limits(block), _IMMEDIATE_RATIO)
        alarms = super().take(block)
        if i < 0 or (alarms and alarms[0].step <= block.step[i]):
            return alarms
        self.raised = True
        return [self._tell(int(block.step[i]), float(self._own[1] - self._own[0]),
                           self._plain * float(self._limits(block)[i]), self._plain)]

    def _values(self, block: SampleBlock) -> np.ndarray:
        return np.array([block.accounted, block.energy])

    def _limits(self, block: SampleBlock) -> np.ndarray:
        return self._share * self._scale(block)

    def _alarm(self, step: int) -> Alarm:
        kept, swing = self._ends[1] - self._ends[0]
        # Report H if its range is the one beyond the limit.
        band, times = (swing, self._plain) if swing > self._plain * kept else (kept, 1.0)
        return self._tell(step, float(band), times * self.limit, times)

    def _tell(self, step: int, band: float, limit: float, times: float) -> Alarm:
        if not (limit > 0.0 and math.isfinite(band / limit)):
            return Alarm(self.kind, step, band, limit, 'the energy is not finite: '
                         f'under-resolved; use {self.smaller}, or another initial state',
                         self.energy_unit)
        return Alarm(self.kind, step, band, limit,
                     f'the energy error exceeds {100.0 * self._share * times:g} % of the energy '
                     f'scale; use {self.smaller}, or a method of higher order',
                     self.energy_unit)


class BarrierGuard(BandGuard):
    """
    Energy barrier: the energy error stays smaller than the distance to the barrier's energy.

    Parameters
    ----------
    name : str
        Name of the barrier: 'separatrix', 'escape barrier'.
    energy : float
        Energy of the barrier [J]; the energy of the motion is that of the first sample.
    order : int, optional
        Order of the method. With order 1 the band of H is not meaningful: H~ is judged if known.
        From order 2 on H is judged: even if H~ stays on one side of the barrier, the motion may
        leave the region that H below the barrier confines it to, by the difference of H and H~.
    search : SaddleSearch, optional
        Search for saddles along the run; the nearest in energy is the barrier.

    """

    kind = 'not resolved'
    remedy = ('use a smaller step_size or a method of higher order: the energy error '
              'determines on which side of the barrier the motion is')

    def __init__(self, name: str, energy: float, order: int = 1,
                 search: SaddleSearch | None = None):
        super().__init__()
        self._plain = order > 1
        self.kind, self._name = f'{name} not resolved', name
        self._found, self._search = [] if search else [energy], search
        self._gap, self._start = math.inf, (math.nan, math.nan)

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        simulation, barrier = run.simulation, run.hamiltonian.barrier
        if barrier is not None and run.conservative:
            yield cls(*barrier, run.order)
        elif run.searchable and simulation.system.integrator is simulation.integrator:
            # On a constraint or between walls, saddles of H are not saddles of the motion.
            yield cls('saddle', math.inf, run.order, SaddleSearch(
                run.hamiltonian, lambda: simulation.rescue_ready))

    def take(self, block: SampleBlock) -> list[Alarm]:
        """See BlockGuard; no alarm is raised while no barrier is known."""
        alarms = super().take(block)
        self.raised &= self._gap < math.inf
        return alarms if self.raised else []

    def _limits(self, block: SampleBlock) -> np.ndarray:
        if math.isnan(self._start[0]):
            self._start = float(block.energy[0]), float(self._values(block)[0, 0])
        limits = np.full(len(block.step), self._gap)
        found = [(0, energy) for energy in self._found]
        self._found.clear()
        for i, energy in [*found, *(self._search.take(block) if self._search else ())]:
            # At a saddle H~ = H, since the gradient is zero: the conserved quantity and H must be
            # on the same side of it.
            plain, kept = (energy - start for start in self._start)
            self._gap = min(self._gap, abs(kept) if plain * kept > 0.0 else 0.0)
            limits[i:] = self._gap
        return limits

    def _values(self, block: SampleBlock) -> np.ndarray:
        return (block.energy - block.work if self._plain else block.accounted)[None]

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self.band, self.limit,
                     f'the energy error is {self.band:.2g} {self.energy_unit}, but the '
                     f'{self._name} is only {self.limit:.2g} {self.energy_unit} away: '
                     f'{self.kind}; use {self.smaller}', self.energy_unit)


# Spacing of finite differences relative to the state; an accuracy of a tenth suffices.
_SPACING = 1e-4


class InvariantGuard(BandGuard):
    """
    Invariant: it stays within a share of the largest change that the state could cause.

    The scale is the sum over i of abs(dI/dz_i) s_i, with s_i the size of the state or of the
    training box (``state_scales``), which is independent of constants in I. It is averaged over
    samples 1, 2, 4, 8, ..., which extend over the whole run.

    Parameters
    ----------
    name : str
        Name of the invariant.
    function : callable
        Function of q and p, each of shape (d,).
    share : float
        Allowed band relative to the scale.
    hamiltonian : Hamiltonian
        Hamiltonian of the motion.

    """

    kind = 'not conserved'
    remedy = ('use a smaller step_size, or a method that conserves it: Gauss methods conserve '
              'quadratic invariants')

    def __init__(self, name: str, function: Callable[[np.ndarray, np.ndarray], float],
                 share: float, hamiltonian: Hamiltonian):
        super().__init__(share)
        self.kind, self._name = f'{name} not conserved', name
        self._function, self._hamiltonian, self._seen = function, hamiltonian, 0
        self._scales: list[float] = []

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        for name, function in run.hamiltonian.invariants.items():
            yield cls(name, function, run.band_limit, run.hamiltonian)

    def _values(self, block: SampleBlock) -> np.ndarray:
        return np.array([[self._function(q, p) for q, p in zip(block.q, block.p, strict=True)]])

    def _limits(self, block: SampleBlock) -> np.ndarray:
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
                     f'{self._name} is not conserved: it varies by {self.band:.2g}, limit '
                     f'{self.limit:.2g}; use {self.smaller}, or a method that conserves it',
                     '1')


# Minimum number of blocks, and of samples per block, to detect a lasting change.
_MIN_BLOCKS, _MIN_BLOCK_SAMPLES = 50, 20
# Factor by which the run must grow while a change persists; a slow oscillation does not.
_PERSISTENCE = 5
# A sudden change beyond this multiple of the energy scale is not an oscillation; without other
# guards of the energy, as with damping or forces, the motion is then not resolved.
_JUMP_RATIO, _LARGEST_ERROR = 10.0, 0.5


@kept(error_model='numpy')
def _turn_over(own: np.ndarray, work: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return the larger of scale and total abs work; own: last work, total abs work so far."""
    larger = np.empty(len(work))
    for i in range(len(work)):
        own[1] += abs(work[i] - own[0])
        own[0] = work[i]
        larger[i] = scales[i] if scales[i] >= own[1] or math.isnan(own[1]) else own[1]
    return larger


@kept(error_model='numpy')
def _change(ends: np.ndarray, accounted: np.ndarray, start: float, limits: np.ndarray, first: int,
            last: int) -> tuple[int, bool]:
    """Widen the range of the change; return the index of a jump, or the last index."""
    at, jumped = last - 1, False
    for i in range(first, last):
        change = accounted[i] - start
        if change < ends[0]:
            ends[0] = change
        if change > ends[1]:
            ends[1] = change
        # The negated comparison makes NaN an alarm.
        if not (jumped or abs(change) <= limits[i]):
            at, jumped = i, True
    return at, jumped


class EnergyGuard(BlockGuard):
    """
    Energy balance: energy changes only by the work done, with neither jumps nor drift.

    The alarm for drift is raised if, during the whole last third of the run, the energy is on one
    side of its initial value by more than a share of the scale, and remains so until the run is
    five times as long: an oscillation returns earlier. The alarm for a jump is raised at once,
    beyond ten times the scale, or half of it in a run that is not conservative. If the total
    absolute work of effects exceeds the energy scale, it replaces the scale.

    Parameters
    ----------
    share : float
        Allowed lasting change relative to the scale.
    scale : callable
        Returns the energy scale at each sample of a block [J]; see SampledScale.
    conservative : bool, optional
        True if other guards judge the energy as well.
    drifting : Simulation, optional
        Simulation whose method is not symplectic, so that its energy drifts.
    works : callable, optional
        Returns the work done so far by each effect [J]; the alarm names the largest.
    jumps : callable, optional
        Returns the work of jumps of H in time so far [J]; see TimeJumps.

    """

    kind = 'energy not accounted for'
    remedy = ('use a symplectic method instead of a baseline, or a smaller step_size; check that '
              'every effect that acts is listed in the scene')

    def __init__(self, share: float, scale: Scale, conservative: bool = True,
                 drifting: Simulation | None = None,
                 works: Callable[[], dict[str, float]] = dict,
                 jumps: Callable[[SampleBlock], np.ndarray] | None = None):
        self._jumps, self._jumped = jumps, 0.0
        self.raised, self._how, self._drifting = False, (share, ''), drifting
        # The effects' works at the end of the last block.
        self._works_now, self._works = works, works()
        self._jump = _JUMP_RATIO if conservative else _LARGEST_ERROR
        self._share, self._scale_at, self._scale = share, scale, 0.0
        # Work at the last sample, and total absolute work.
        self._turned = np.zeros(2)
        self._start: float | None = None
        self._low: list[float] = []
        self._high: list[float] = []
        self._count, self._length = 0, _MIN_BLOCK_SAMPLES
        # Range of the change in the current block.
        self._ends = np.array([math.inf, -math.inf])
        self._since, self._sign = math.inf, 0

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        method = run.simulation.integrator
        yield cls(run.change_limit, run.scale, run.conservative, run.simulation if method.explicit
                  and not method.requirements.symplectic else None,
                  dict if run.conservative or run.in_rows
                  else lambda: run.simulation.works,
                  None if run.in_rows or run.hamiltonian.time is None
                  else TimeJumps(run.simulation))

    def allow(self, band: float, change: float) -> None:
        self._share = change

    def take(self, block: SampleBlock) -> list[Alarm]:
        scales = self._scale_at(block)
        if self._jumps is not None:
            jumps = self._jumps(block)
            self._jumped = float(jumps[-1])
            block = block._replace(accounted=block.accounted - jumps, work=block.work + jumps)
        if self._start is None:
            self._start = float(block.accounted[0])
        scales = _turn_over(self._turned, block.work, scales)
        alarms, first = [], 0
        while first < len(scales):
            # Stop at the end of a block of this guard.
            last = min(len(scales), first + self._length - self._count)
            i, jumped = _change(
                self._ends, block.accounted, self._start, self._jump * scales, first, last)
            self._count, self._scale = self._count + last - first, float(scales[i])
            step, change = int(block.step[i]), abs(float(block.accounted[i]) - self._start)
            if jumped and not self.raised:
                alarms.append(self._alarm(step, change, self._jump, 'changed'))
            if self._count == self._length and (change := self._end_block()) and not self.raised:
                alarms.append(self._alarm(step, change, self._share, 'changed permanently'))
            first = last
        self._scale, self._works = float(scales[-1]), self._works_now()
        return alarms

    @property
    def calm(self) -> tuple[float, float]:
        """See BlockGuard: the limit of a jump at the last sample judged."""
        if self.raised:
            return super().calm
        if self._start is None:
            return math.inf, -math.inf
        start = self._start + self._jumped
        return start - self._jump * self._scale, start + self._jump * self._scale

    def renew(self, sample: Observed) -> Alarm | None:
        assert self._start is not None, 'a sample has raised an alarm'
        change = abs(accounted_energy(sample) - self._jumped - self._start)
        return self._alarm(sample.step, change, *self._how)

    def _end_block(self) -> float:
        """Close a block; return the lasting change of the energy [J], 0 if there is none."""
        self._low.append(float(self._ends[0]))
        self._high.append(float(self._ends[1]))
        self._count, self._ends[:] = 0, (math.inf, -math.inf)
        blocks, length = len(self._low), self._length
        if blocks < _MIN_BLOCKS:
            return 0.0
        low, high = min(self._low[-(blocks // 3):]), max(self._high[-(blocks // 3):])
        if blocks == 2 * _MIN_BLOCKS:
            self._low = [min(pair) for pair in zip(self._low[::2], self._low[1::2], strict=True)]
            self._high = [max(pair)
                          for pair in zip(self._high[::2], self._high[1::2], strict=True)]
            self._length *= 2
        lasting = self._share * self._scale
        sign = 1 if low > lasting else -1 if high < -lasting else 0
        if sign != self._sign:
            self._sign, self._since = sign, blocks * length
        lasts = sign and blocks * length >= _PERSISTENCE * self._since
        return min(abs(low), abs(high)) if lasts else 0.0

    def _alarm(self, step: int, value: float, share: float, how: str) -> Alarm:
        self.raised, self._how = True, (share, how)
        if not math.isfinite(value):
            return Alarm(self.kind, step, value, share * self._scale,
                         f'the energy is not finite; use {self.smaller}, or another initial '
                         'state', self.energy_unit)
        cause = ''
        if self._drifting is not None:
            time = max(step, 1) * self._drifting.step_size
            cause = (f'{method_name(self._drifting.integrator)} is not symplectic, and its energy '
                     f'drifts by {value / time:.2g} {self.energy_unit}/s; ')
        # The window of the alarm is the block in which it is found.
        moved = {name: work - self._works.get(name, 0.0)
                 for name, work in self._works_now().items()}
        if moved:
            most = max(moved, key=lambda name: abs(moved[name]))
            cause += (f'of the effects {most} did the most work meanwhile, {moved[most]:.2g} '
                      f'{self.energy_unit}; ')
        return Alarm(self.kind, step, value, share * self._scale,
                     f'the energy has {how} by more than {100.0 * share:g} % of the energy '
                     f'scale, apart from the work done: {cause}use a symplectic method or '
                     f'{self.smaller}', self.energy_unit)


def is_wrong(kind: str) -> bool:
    """Return whether alarms of a kind indicate that a run may be qualitatively wrong."""
    return kind.endswith(tuple(guard.kind for guard in (
        ResolutionGuard, BarrierGuard, InvariantGuard, EnergyGuard)))
