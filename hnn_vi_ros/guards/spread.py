# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The spread of an ensemble as a bound."""

from collections.abc import Callable

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
import numpy as np


class SpreadGuard(Guard):
    """
    The members of an ensemble have not come apart.

    Parameters
    ----------
    spread : callable
        Returns the half-widths of the bands of q, then of p, shape (2 d,).
    box : tuple of np.ndarray
        Bounds of q and of p in the data of training, each (d, 2).
    limit : float
        Largest allowed spread, in half-widths of the box.

    Attributes
    ----------
    value : float
        The largest spread of the last sample, in half-widths of the box.

    """

    kind = 'spread of the ensemble'
    remedy = ('start where the data are dense, or train on more of them along this motion; '
              '`uncertainty: {limit: ...}` of the scene is the bound')

    def __init__(self, spread: Callable[[], np.ndarray], box: tuple[np.ndarray, np.ndarray],
                 limit: float):
        self._spread, self._limit, self.value = spread, limit, 0.0
        low, high = np.concatenate(box).T
        self._half = 0.5 * (high - low)

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        before, self.value = self.value, float((self._spread() / self._half).max())
        return self.renew(sample) if before <= self._limit < self.value else None

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        if self.value <= self._limit:
            return None
        what = (f'the members of the ensemble are {self.value:.2g} half-widths of the training '
                'domain apart: the motion is no longer known; reset, or train on more data there')
        return Alarm(self.kind, sample.step, self.value, self._limit, what, 'half-widths')
