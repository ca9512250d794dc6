# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of H(q, p, t) in time, which the integral of dH/dt does not contain."""

from collections.abc import Iterator

from hnn_vi_ros.simulation.guards.samples import SampleBlock
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Smallest change of the accounted energy that is examined, relative to the energies; halvings of
# an interval between samples; share of the change of H at one state that a jump makes up.
_MIN_CHANGE, _HALVINGS, _SHARE = 1e-9, 45, 0.5


class TimeJumps:
    """
    Work that a drive does at once, where H jumps in time, as in piecewise(t > 1, ...).

    Between samples whose accounted energies differ, H at one state is followed by bisection to
    its largest change; a jump is one that stays as the interval vanishes. Its size is that at the
    states before and after, interpolated.

    Parameters
    ----------
    simulation : Simulation
        Simulation to watch.

    """

    def __init__(self, simulation: Simulation):
        self._hamiltonian, self._step_size = simulation.hamiltonian, simulation.step_size
        self._last: SampleBlock | None = None
        self._work = 0.0

    def __call__(self, block: SampleBlock) -> np.ndarray:
        """Return the work of all jumps so far at each sample of the next block, shape (k,)."""
        first = self._last
        samples = block if first is None else SampleBlock(*(
            np.concatenate(parts) for parts in zip(first, block, strict=True)))
        self._last = SampleBlock(*(part[-1:] for part in block))
        work = np.full(len(samples.step), self._work)
        for i, jump in self._found(samples):
            work[i:] += jump
        self._work = float(work[-1])
        return work[-len(block.step):]

    def _found(self, samples: SampleBlock) -> Iterator[tuple[int, float]]:
        """Yield the index of the sample after each jump, and the jump [J]."""
        changes = np.abs(np.diff(samples.accounted))
        size = np.abs(samples.energy[1:]) + np.abs(samples.work[1:])
        for i in np.flatnonzero(changes > _MIN_CHANGE * size).tolist():
            low, high = (samples.step[i:i + 2] * self._step_size).tolist()
            whole, start, end = self._change(samples, i, low, high), low, high
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                before, after = (abs(self._change(samples, i, *ends)) for ends in (
                    (low, middle), (middle, high)))
                low, high = (low, middle) if before > after else (middle, high)
            now = self._change(samples, i, low, high)
            if abs(now) > _SHARE * abs(whole):
                share = (low - start) / (end - start)
                yield i + 1, (1.0 - share) * now + share * self._change(samples, i + 1, low, high)

    def _change(self, samples: SampleBlock, i: int, low: float, high: float) -> float:
        """Return the change of H at a sample's state between two times [J]."""
        q, p = samples.q[i], samples.p[i]
        before, after = self._hamiltonian.energy(
            np.array([q, q]), np.array([p, p]), np.array([low, high]))
        return float(after - before)
