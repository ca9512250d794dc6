# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The energy scale of a run as of each of its samples."""

import math

from hnn_vi_ros.accuracy.diagnostics import rounding_walk
from hnn_vi_ros.accuracy.energy_scale import EnergyScale
from hnn_vi_ros.guards.base import accounted_energy, Observed
from hnn_vi_ros.hamiltonians.base import Hamiltonian

# An error of energy must be this many times larger, over the scale, to differ from rounding: a
# share of a fiftieth is the smallest that can be watched.
_ABOVE_ROUNDING = 50.0
# From rest, energies grow as the square of the time, and an error of the first order in h by the
# share 1 / (2 n) of them in n steps: less than a fortieth beyond this many.
_EARLY = 20.0


class SampledScale:
    """
    Energy scale by which the guards of a run measure: one for all of them.

    It is the EnergyScale of the samples so far, but no less than what rounding makes of H, as
    for a system at rest. As long as energy has not been turned over, the first n steps may have
    seen too little of it, as from a start at rest where the potential is zero: they count
    1 + 20 / n times.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H of the run.

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self._scale, self._rounding = EnergyScale(hamiltonian), hamiltonian.kernel.energy_scale
        self._last: Observed | None = None
        self._first, self._newest, self._size, self._value = 0, 0, 0.0, 0.0

    def __call__(self, sample: Observed) -> float:
        """Return the scale [J] as of a sample, the newest one or that before it again."""
        if sample is not self._last:
            if self._last is None:
                self._first = self._newest = sample.step
            weight = max(sample.step - self._newest, 1)
            self._last, self._newest = sample, sample.step
            scale = self._scale.add(sample.q, sample.p, sample.dH_dq, sample.dH_dp, weight)
            steps = sample.step - self._first + 1
            if not self._scale.turned:
                scale *= 1.0 + _EARLY / steps
            size = abs(accounted_energy(sample)) + abs(sample.work) + self._rounding
            if math.isfinite(size) and size > self._size:
                self._size = size
            floor = _ABOVE_ROUNDING * rounding_walk(self._size, steps)
            self._value = floor if floor > scale else scale
        return self._value
