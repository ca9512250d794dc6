# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that guards check, one by one or in blocks."""

from struct import Struct
from typing import NamedTuple

from hnn_vi_ros.recording import Sample
import numpy as np


class GuardState(NamedTuple):
    """State and energies of a run after `step` steps; see Sample."""

    step: int
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: float
    modified_energy: float
    work: float = 0.0


# A state that guards check.
Observed = Sample | GuardState


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H if there is none, minus the work done on the system [J]."""
    modified = sample.modified_energy
    # Only NaN compares unequal to itself.
    return (modified if modified == modified else sample.energy) - sample.work


class SampleBlock(NamedTuple):
    """
    Batch of k consecutive samples.

    Parameters
    ----------
    step : np.ndarray, shape (k,)
        Steps since the start of the run.
    q, p, dH_dq, dH_dp : np.ndarray, shape (k, d), or (k, m, d) for m trajectories
        States, and derivatives of H at them.
    energy, accounted, work : np.ndarray, shape (k,)
        H, accounted energy, and work so far [J].

    """

    step: np.ndarray
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: np.ndarray
    accounted: np.ndarray
    work: np.ndarray


# Step, H, accounted energy and work of a sample.
_REST = Struct('4d')


class SampleBuffer:
    """
    Buffer of samples to be checked together as a block.

    Samples are copied on arrival, which is cheaper than keeping the objects.

    Parameters
    ----------
    most : int
        Capacity in coordinates q; at least one sample fits.

    Attributes
    ----------
    full : bool
        True if the capacity is reached.

    """

    def __init__(self, most: int):
        # Capacity in bytes.
        self._most = 8 * most
        self.full = False
        self._shapes: list[tuple[int, ...]] = []
        self._q, self._p = bytearray(), bytearray()
        self._dH_dq, self._dH_dp, self._rest = bytearray(), bytearray(), bytearray()

    def __len__(self) -> int:
        """Return the number of samples in the buffer."""
        return len(self._rest) // _REST.size

    def add(self, sample: Observed) -> float:
        """Append a sample; return its accounted energy [J]."""
        accounted = accounted_energy(sample)
        self._q += sample.q.tobytes()
        self._p += sample.p.tobytes()
        self._dH_dq += sample.dH_dq.tobytes()
        self._dH_dp += sample.dH_dp.tobytes()
        self._rest += _REST.pack(sample.step, sample.energy, accounted, sample.work)
        self.full = len(self._q) >= self._most
        if not self._shapes:
            self._shapes = [one.shape for one in (sample.q, sample.p, sample.dH_dq, sample.dH_dp)]
        return accounted

    def block(self, first: int = 0) -> SampleBlock | None:
        """Return the buffered samples from index `first` on as a block; None if there are none."""
        n = len(self)
        if first >= n:
            return None
        states = (np.frombuffer(part).reshape(n, *shape)[first:].copy() for part, shape in zip(
            (self._q, self._p, self._dH_dq, self._dH_dp), self._shapes, strict=True))
        step, *energies = np.frombuffer(self._rest).reshape(n, _REST.size // 8)[first:].T.copy()
        return SampleBlock(step.astype(np.int64), *states, *energies)
