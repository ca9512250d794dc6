# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Energy scale of the samples of a run, which the limits of its guards are shares of."""

from collections.abc import Callable
import math

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.simulation.accuracy.diagnostics import EnergyScale, follow, RECORD, rounding_walk
from hnn_vi_ros.simulation.guards.samples import SampleBlock, SampleBuffer
import numpy as np

# Returns the energy scale at each sample of a block [J].
Scale = Callable[[SampleBlock], np.ndarray]

# Minimum of the energy scale, relative to the energies and per square root of the number of
# steps: 50 times the rounding error, so that limits down to 1 / 50 of the scale exceed rounding.
_MIN_SCALE = 50.0 * rounding_walk(1.0, 1.0)
# Starting from rest, energies grow as t^2, and an error of first order in h is 1 / (2 n) of them
# after n steps: less than 1 / 40 beyond this number of steps.
_EARLY_STEPS = 20.0


@kept(error_model='numpy')
def _follow_samples(record: np.ndarray, own: np.ndarray, step: np.ndarray, potential: np.ndarray,
                    virial: np.ndarray, accounted: np.ndarray, work: np.ndarray,
                    rounding: float) -> np.ndarray:
    """Return the scales of the next samples; own: first and last step, largest energy."""
    scales = np.empty(len(step))
    for i in range(len(step)):
        if math.isnan(own[0]):
            own[0] = own[1] = step[i]
        scale, turned = follow(record, potential[i], virial[i], max(step[i] - own[1], 1.0))
        own[1] = step[i]
        size = abs(accounted[i]) + abs(work[i]) + rounding
        if own[2] < size < math.inf:
            own[2] = size
        steps = step[i] - own[0] + 1.0
        scales[i] = max(_MIN_SCALE * own[2] * math.sqrt(steps),
                        scale if turned else scale * (1.0 + _EARLY_STEPS / steps))
    return scales


class SampledScale:
    """
    Energy scale shared by all guards of a run.

    It is the EnergyScale of the samples so far, with a minimum from the rounding error of H, for
    example for a system at rest. Until kinetic and potential energy have been exchanged once, it
    is multiplied by 1 + 20 / n after n steps, since it may be too small then, for example after
    a start at rest at zero potential.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of the run.

    Attributes
    ----------
    value : float
        Scale at the last sample [J].

    """

    def __init__(self, hamiltonian: Hamiltonian):
        self.value = math.nan
        self._scale, self._rounding = EnergyScale(hamiltonian), hamiltonian.kernel.energy_scale
        self._record, self._own = np.zeros(RECORD), np.array([math.nan, math.nan, 0.0])
        # The last block and its scales; scales of the first samples of the next block.
        self._block: SampleBlock | None = None
        self._values = np.zeros(0)
        self._ahead: list[float] = []

    def __call__(self, block: SampleBlock) -> np.ndarray:
        """Return the scale at each sample of the next block, or of the last block again [J]."""
        if block is not self._block:
            ahead, self._ahead, self._block = self._ahead, [], block
            later = self._take(
                SampleBlock(*(part[len(ahead):] for part in block)) if ahead else block)
            self._values = np.array([*ahead, *later]) if ahead else later
        return self._values

    def ahead(self, waiting: SampleBuffer) -> float:
        """Return the scale [J] at the last buffered sample of the next block."""
        if (new := waiting.block(len(self._ahead))) is not None:
            self._ahead.extend(self._take(new))
        return self.value

    def _take(self, block: SampleBlock) -> np.ndarray:
        potential, virial = self._scale.virials(block.q, block.p, block.dH_dq, block.dH_dp)
        if potential.ndim > 1:
            # Sum the energies of trajectories that step together.
            potential, virial = potential.sum(axis=1), virial.sum(axis=1)
        scales = _follow_samples(self._record, self._own, block.step, potential, virial,
                                 block.accounted, block.work, self._rounding)
        if scales.size:
            self.value = float(scales[-1])
        return scales
