# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards of the validity of a model: box of the training data, and spread of an ensemble."""

from collections.abc import Callable, Iterator
import math

from hnn_vi_ros.kernels import kept
from hnn_vi_ros.models import Domain, domain_of
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Guard, StateGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed, SampleBlock
import numpy as np

# Half-widths by which the velocities of a log, whose range is the domain of a machine, may err.
_EDGE = 0.01


@kept(error_model='numpy')
def _excess(q: np.ndarray, p: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the excess of states (k, d) over a box, in half-widths; NaN for NaN states."""
    (k, d), excess = q.shape, np.zeros(len(q))
    for i in range(k):
        for j in range(2 * d):
            x = q[i, j] if j < d else p[i, j - d]
            beyond = max(x - high[j], low[j] - x) / (0.5 * (high[j] - low[j]))
            if not (beyond <= excess[i] or math.isnan(excess[i])):
                excess[i] = beyond
    return excess


class BoxGuard(BlockGuard):
    """
    Training box: the state stays inside the box of the training data.

    Parameters
    ----------
    box : tuple of np.ndarray
        Bounds of q and of p, each (d, 2), as ``Hamiltonian.box``.
    gauge : np.ndarray, shape (d, d), optional
        Gauge of a magnetic field, c A(q) = gauge q: the model was trained on P = p - c A(q).
    domain : Domain, optional
        Training domain of a machine in q and v, which replaces the box.

    Attributes
    ----------
    excess : float
        Distance of the last sample from the box, in its half-widths; 0 inside.
    largest : float
        The largest excess so far.
    share : float
        Share of the samples so far that are outside.

    """

    kind = 'out of the training box'
    remedy = ('start inside the training domain, or train on a larger one; `confine: true` '
              'encloses it with walls, and `stop_outside_box` ends a run that leaves it')

    def __init__(self, box: tuple[np.ndarray, np.ndarray], gauge: np.ndarray | None = None,
                 domain: Domain | None = None):
        self._gauge, self._domain = gauge, domain
        self.excess = self.largest = 0.0
        self._samples = self._outside = 0
        self._what = ''
        self._bounds = tuple(np.concatenate(box).T.copy())

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        hamiltonian = run.hamiltonian
        if hamiltonian.box is not None:
            yield cls(hamiltonian.box, hamiltonian.gauge, domain_of(hamiltonian))

    def outside(self, sample: Observed) -> bool:
        """Return whether a sample is outside the box or domain."""
        return bool(self._excess(sample.q[None], sample.p[None], sample.dH_dp[None])[0] > 0.0)

    def take(self, block: SampleBlock) -> list[Alarm]:
        excess = self._excess(block.q, block.p, block.dH_dp)
        if self.excess == 0.0 and not excess.any():
            self._samples += excess.size
            return []
        before = np.concatenate([[self.excess], excess[:-1]])
        alarms, first = [], 0
        for left in [*np.flatnonzero((excess > 0.0) & (before == 0.0)), None]:
            last = len(excess) if left is None else int(left) + 1
            part = excess[first:last]
            if part.size:
                self._samples += part.size
                self._outside += int(np.count_nonzero(part))
                self.excess = float(part[-1])
                if part.max() > self.largest:
                    i = first + int(part.argmax())
                    self.largest = float(excess[i])
                    if self._domain is not None:
                        beyond = self._domain.beyond(block.q[i:i + 1], block.dH_dp[i:i + 1])
                        self._what = f' (largest: {beyond[0]})'
            if left is not None:
                alarms.append(self._alarm(int(block.step[left])))
            first = last
        return alarms

    def _excess(self, q: np.ndarray, p: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the excess of states (k, d) over the box, in half-widths, shape (k,)."""
        if self._domain is not None:
            excess = self._domain.excess(q, v).max(axis=-1)
            return np.where(excess < _EDGE, 0.0, excess)
        return _excess(q, p if self._gauge is None else p - q @ self._gauge.T, *self._bounds)

    @property
    def share(self) -> float:
        """Return the share of the samples so far that are outside."""
        return self._outside / max(1, self._samples)

    def _alarm(self, step: int) -> Alarm:
        after = (f'{self._what}, in {100.0 * self.share:.3g} % of the samples so far: H is '
                 'extrapolated there; train the model on a larger domain')
        what = f'{self.excess:.2g} half-widths outside the training domain of the model{after}'
        if self.excess == 0.0:
            what = (f'inside the training domain again, after up to {self.largest:.2g} '
                    f'half-widths outside it{after}')
        return Alarm(self.kind, step, self.excess, 0.0, what, 'half-widths')


class SpreadGuard(StateGuard):
    """
    Ensemble spread: the members of an ensemble stay close together.

    Parameters
    ----------
    spread : callable
        Returns the half-widths of the bands of q, then of p, shape (2 d,).
    box : tuple of np.ndarray
        Bounds of q and of p in the training data, each (d, 2).
    limit : float
        Largest allowed spread, in half-widths of the box.

    Attributes
    ----------
    value : float
        The largest spread of the last sample, in half-widths of the box.

    """

    each = True
    kind = 'spread of the ensemble'
    remedy = ('start where the data are dense, or train on more data along this motion; '
              '`uncertainty: {limit: ...}` in the scene sets the limit')

    def __init__(self, spread: Callable[[], np.ndarray], box: tuple[np.ndarray, np.ndarray],
                 limit: float):
        self._spread, self._limit, self.value = spread, limit, 0.0
        self._half = 0.5 * np.ptp(np.concatenate(box), axis=1)

    def update(self, sample: Observed) -> Alarm | None:
        before, self.value = self.value, float((self._spread() / self._half).max())
        return self.renew(sample) if before <= self._limit < self.value else None

    def renew(self, sample: Observed) -> Alarm | None:
        if self.value <= self._limit:
            return None
        what = (f'the members of the ensemble differ by {self.value:.2g} half-widths of the '
                'training domain: the prediction is unreliable; reset, or train on more data '
                'there')
        return Alarm(self.kind, sample.step, self.value, self._limit, what, 'half-widths')
