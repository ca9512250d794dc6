# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The modified energy tells whether the step resolves the motion."""

import math

from hnn_vi_ros.guards.band import BandGuard
from hnn_vi_ros.guards.base import Alarm


class ResolutionGuard(BandGuard):
    """
    The step resolves the motion: the modified energy stays within a share of the energy.

    Parameters
    ----------
    share : float
        The band that is allowed, over the scale.
    scale : float
        Of the energies in play [J]; see ``diagnostics.rounding_scale``.
    step_size : float
        h [s].
    order : int
        The band is O(h^order): 2 for the modified energy of a method of order 1, else the order
        of the method.

    """

    kind = 'under-resolved'

    def __init__(self, share: float, scale: float, step_size: float, order: int):
        super().__init__(share * scale)
        self._scale, self._step_size, self._order = scale, step_size, order

    def allow(self, share: float) -> None:
        """Change what is allowed."""
        self.limit = share * self._scale

    def _alarm(self, step: int) -> Alarm:
        share = self.band / self._scale
        enough = self._step_size * (self.limit / self.band) ** (1.0 / self._order)
        # Rounded down, to two digits.
        digits = 10.0 ** (math.floor(math.log10(enough)) - 1)
        enough = math.floor(enough / digits) * digits
        return Alarm(self.kind, step, self.band, self.limit,
                     f'the energy is kept only to {share:.2g} of its size: under-resolved; use '
                     f'step_size <= {enough:.2g} s')
