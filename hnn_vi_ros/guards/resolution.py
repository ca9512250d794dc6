# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The modified energy shows whether the step resolves the motion."""

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
    modified : bool, optional
        Whether a modified energy is known.

    """

    kind = 'under-resolved'
    remedy = ('use a smaller step_size, such as the one that `simulate` and `hnn run` name, or a '
              'method of higher order')

    def __init__(self, share: float, scale: Callable[[Observed], float], modified: bool = False):
        super().__init__()
        self._share, self._scale, self._modified = share, scale, modified
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
        # Report H, if H went too far.
        plain = self._modified and self.band > super().band
        band, limit = (PLAIN * x if plain else x for x in (self.band, limit))
        if not (limit > 0.0 and math.isfinite(band / limit)):
            return Alarm(self.kind, step, band, limit, 'the energy is infinite, or no number: '
                         'under-resolved; use a smaller step_size, or start elsewhere')
        share = self._share * self.band / limit * (PLAIN if plain else 1.0)
        return Alarm(self.kind, step, band, limit,
                     f'the energy is kept only to {share:.2g} of the energies in play: '
                     'under-resolved; use a smaller step_size, or a method of higher order')
