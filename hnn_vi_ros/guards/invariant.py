# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An invariant besides the energy as a bound."""

from collections.abc import Callable

from hnn_vi_ros.accuracy.diagnostics import state_scales
from hnn_vi_ros.guards.band import BandGuard
from hnn_vi_ros.guards.base import Alarm, Observed
from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np

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
