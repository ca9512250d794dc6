# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The modified energy tells whether the step resolves the motion."""

from collections.abc import Callable
import math

from hnn_vi_ros.guards.band import BandGuard
from hnn_vi_ros.guards.base import Alarm, Observed

# H may go this many times as far as the modified energy that the method keeps: that it does is
# the method's own, and no loss, but beyond a fifth of the energies in play it is no resolution.
PLAIN = 4.0


class ResolutionGuard(BandGuard):
    """
    The step resolves the motion: the modified energy stays within a share of the energy scale.

    H itself stays within four times that share; where no modified energy is known, within it.

    Parameters
    ----------
    share : float
        The band that is allowed, over the scale.
    scale : callable
        Returns the energy scale as of a sample [J]; see SampledScale.
    step_size : float
        h [s].
    order : int
        Of the method: the band of H is O(h^order).
    modified : bool, optional
        Whether a modified energy is known, with a band of O(h^(2 order)).

    """

    kind = 'under-resolved'
    remedy = 'use the step_size that the message names, or a method of higher order'

    def __init__(self, share: float, scale: Callable[[Observed], float], step_size: float,
                 order: int, modified: bool = False):
        super().__init__()
        self._share, self._scale = share, scale
        self._step_size, self._order, self._modified = step_size, order, modified
        self._lowest, self._highest = math.inf, -math.inf

    def allow(self, band: float, change: float) -> None:
        """See Guard."""
        self._share = band

    @property
    def band(self) -> float:
        """Return the range of the modified energy, or a quarter of that of H if larger [J]."""
        return max(super().band, self._plain_band / PLAIN) if self._modified else super().band

    @property
    def _plain_band(self) -> float:
        return max(self._highest - self._lowest, 0.0)

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        if sample.energy < self._lowest:
            self._lowest = sample.energy
        if sample.energy > self._highest:
            self._highest = sample.energy
        return super().update(sample)

    def _limit(self, sample: Observed) -> float:
        return self._share * self._scale(sample)

    def _alarm(self, step: int, limit: float) -> Alarm:
        # Of H, if that is what went too far.
        plain = self._modified and self.band > super().band
        order = self._order if plain or not self._modified else 2 * self._order
        band, limit = (PLAIN * x if plain else x for x in (self.band, limit))
        if not (limit > 0.0 and math.isfinite(band / limit)):
            return Alarm(self.kind, step, band, limit, 'the energy is infinite, or no number: '
                         'under-resolved; use a smaller step_size, or start elsewhere')
        share = self._share * self.band / limit * (PLAIN if plain else 1.0)
        enough = self._step_size * min(limit / band, 1.0) ** (1.0 / order)
        # Rounded down, to two digits.
        digits = 10.0 ** (math.floor(math.log10(enough)) - 1)
        enough = math.floor(enough / digits) * digits
        return Alarm(self.kind, step, band, limit,
                     f'the energy is kept only to {share:.2g} of the energies in play: '
                     f'under-resolved; use step_size <= {enough:.2g} s')
