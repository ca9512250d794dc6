# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guard of the poles of H, which no motion can cross, but a step can."""

from collections.abc import Iterator
from itertools import pairwise
import math

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Guard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import SampleBlock
import numpy as np

# A search for a pole starts if second derivatives exceed this multiple of their mean so far.
_MIN_RATIO = 4.0
# Maximum number of searches per doubling of the number of samples.
_MAX_SEARCHES = 2
# Number of points between two samples, even to avoid the midpoint, and of refinements: down to
# 1e-7 of the distance. There H'' has grown by 1e7 at a pole of first order, as has the gradient
# at a logarithm. Thresholds of growth: of H'', of H', and of H'' in each round; the last
# rounds show that the line does not only come near to a pole.
_POINTS, _ROUNDS, _LAST_ROUNDS = 16, 8, 3
_MIN_POLE_GROWTH, _MIN_FLOW_GROWTH, _MIN_ROUND_GROWTH = 1e6, 1e3, 2.0
# Lines near a pole, relative to the distance of the samples: their offset in each coordinate,
# the least offset relative to the largest, and half of their length.
_OFFSET, _LEAST_OFFSET, _REACH = 1e-3, 1e-2, 8e-3


@kept(error_model='numpy')
def _next_peak(own: np.ndarray, sizes: np.ndarray, first: int) -> int:
    """Return the index after the next steep peak of H''; own: sum, count, last two values."""
    for i in range(first, len(sizes)):
        own[0] += sizes[i]
        own[1] += 1.0
        peak = own[3] > _MIN_RATIO * own[0] / own[1] and own[3] >= own[2] and own[3] >= sizes[i]
        own[2], own[3] = own[3], sizes[i]
        if peak:
            return i
    return len(sizes)


class PoleGuard(BlockGuard):
    """
    Poles: the motion crosses no pole of H, such as that of an azimuth or centrifugal barrier.

    Between samples at which rows of H'' are large, the maximum of these rows is searched on the
    straight line from one sample to the next. They and H' grow without bound at a pole; H' does
    not if the factor of the pole is zero, for example a zero angular momentum. A pole that lines
    next to it miss, such as the center of an orbit, does not separate the samples.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of the motion.

    """

    kind = 'pole crossed'
    remedy = 'use a smaller step_size, or coordinates without a pole there'

    def __init__(self, hamiltonian: Hamiltonian):
        self._hamiltonian, self.raised, self._searched = hamiltonian, False, 0
        # Distinct entries, so that no row of H'' cancels by symmetry.
        self._direction = 1.0 / (1.0 + 0.1 * np.arange(2 * hamiltonian.dimension))
        self._own = np.zeros(4)
        # The last two samples.
        self._last = np.empty((0, 2 * hamiltonian.dimension))

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        # Networks and robots have no poles.
        if run.searchable and run.hamiltonian.box is None and run.hamiltonian.robot is None:
            yield cls(run.hamiltonian)

    def take(self, block: SampleBlock) -> list[Alarm]:
        if self.raised:
            return []
        z = np.hstack([block.q, block.p])
        sizes, before = self._sizes(z), len(self._last)
        path, alarms, at = np.vstack([self._last, z]), [], 0
        while at < len(z):
            at = _next_peak(self._own, sizes, at)
            if at < len(z):
                budget = _MAX_SEARCHES * (1.0 + math.log2(self._own[1]))
                if not self.raised and self._searched < budget:
                    self._searched += 1
                    part = path[max(0, before + at - 2):before + at + 1]
                    if any(self._crossed(*ends) for ends in pairwise(part)):
                        self.raised = True
                        alarms.append(self._alarm(int(block.step[at])))
                at += 1
        self._last = path[-2:].copy()
        return alarms

    def _sizes(self, z: np.ndarray) -> np.ndarray:
        """Return the largest entry of H'' v at states (k, 2 d), shape (k,)."""
        d = z.shape[1] // 2
        v = np.tile(self._direction, (len(z), 1))
        with np.errstate(all='ignore'):
            products = np.hstack(self._hamiltonian.hessian_vector(
                z[:, :d], z[:, d:], v[:, :d], v[:, d:]))
        return np.abs(products).max(axis=1)

    def _crossed(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return whether a surface of poles is between two states, shape (2 d,)."""
        pole, way = self._pole(start, end), end - start
        if pole is None:
            return False
        widths = np.abs(way[:way.size // 2])
        offsets = np.diag(_OFFSET * np.maximum(widths, _LEAST_OFFSET * widths.max()))
        beside = pole + np.hstack([offsets, np.zeros_like(offsets)])
        return all(self._pole(one - _REACH * way, one + _REACH * way) is not None
                   for one in beside)

    def _pole(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """Return a pole on the line from one state to another, shape (2 d,), None without one."""
        low, high, d, peaks = 0.0, 1.0, start.size // 2, list[float]()

        def slopes(z: np.ndarray) -> np.ndarray:
            with np.errstate(all='ignore'):
                return np.abs(np.hstack(self._hamiltonian.gradient(z[:, :d], z[:, d:])))

        ends = np.array([start, end])
        steepest, fastest = self._sizes(ends).max(), slopes(ends).max(axis=0)
        for _ in range(_ROUNDS):
            places = np.linspace(low, high, _POINTS)
            z = start + places[:, None] * (end - start)
            sizes = np.nan_to_num(self._sizes(z), nan=math.inf)
            k = int(sizes.argmax())
            # A pole shows at the first points: one is within 1 / 30 of the distance from it.
            if sizes[k] < _MIN_ROUND_GROWTH * steepest:
                return None
            peaks.append(sizes[k])
            low, high = places[max(k - 1, 0)], places[min(k + 1, _POINTS - 1)]
        before = peaks[-1 - _LAST_ROUNDS]
        grown = (slopes(z[k:k + 1])[0] > _MIN_FLOW_GROWTH * fastest) & (fastest > 0.0)
        found = (peaks[-1] > _MIN_POLE_GROWTH * steepest and grown.any() and not (
            peaks[-1] < _MIN_ROUND_GROWTH**_LAST_ROUNDS * before < math.inf))
        return z[k] if found else None

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, 1, 0,
                     'the motion crossed a pole of H within the last two samples, which no exact '
                     'motion does; use a smaller step_size, or coordinates without a pole there',
                     '1')
