# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The box of the training data as a bound."""

from hnn_vi_ros.guards.base import Alarm, Guard, Observed
import numpy as np


class BoxGuard(Guard):
    """
    The state is inside the box that the model was trained in.

    Parameters
    ----------
    box : tuple of np.ndarray
        Bounds of q and of p, each (d, 2), as ``Hamiltonian.box``.

    Attributes
    ----------
    excess : float
        How far the last sample is outside, in half-widths of the box; 0 inside.

    """

    kind = 'out of the training box'

    def __init__(self, box: tuple[np.ndarray, np.ndarray]):
        self.excess = 0.0
        bounds = np.concatenate(box)
        # Plain floats: for the few coordinates of a model they are faster than arrays.
        self._low, self._high = bounds.T.tolist()

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        values, low, high = sample.q.tolist() + sample.p.tolist(), self._low, self._high
        for i, x in enumerate(values):
            if not low[i] <= x <= high[i]:
                return self._outside(sample.step, values)
        self.excess = 0.0
        return None

    def _outside(self, step: int, values: list[float]) -> Alarm | None:
        before = self.excess
        self.excess = max(2.0 * max(x - high, low - x) / (high - low)
                          for x, low, high in zip(values, self._low, self._high, strict=True))
        if before > 0.0:
            return None
        return Alarm(self.kind, step, self.excess, 0.0,
                     f'outside of the box that the model was trained in, by {self.excess:.2g} of '
                     'its half-width: H is a guess there; train a model on a larger box')
