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
    gauge : np.ndarray, shape (d, d), optional
        Of magnetic fields, c A(q) = gauge q: the model was trained in P = p - c A(q).

    Attributes
    ----------
    excess : float
        How far the last sample is outside, in half-widths of the box; 0 inside.
    largest : float
        The largest of these so far.

    """

    kind = 'out of the training box'
    remedy = ('start inside of the training domain, or train on a larger box; `confine: '
              'true` closes it with walls, and `stop_outside_box` ends such a run')

    def __init__(self, box: tuple[np.ndarray, np.ndarray], gauge: np.ndarray | None = None):
        self._gauge = gauge
        self.excess = self.largest = 0.0
        bounds = np.concatenate(box)
        # Plain floats: for the few coordinates of a model they are faster than arrays.
        self._low, self._high = bounds.T.tolist()

    def update(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        p = sample.p if self._gauge is None else sample.p - self._gauge @ sample.q
        values, low, high = sample.q.tolist() + p.tolist(), self._low, self._high
        for i, x in enumerate(values):
            if not low[i] <= x <= high[i]:
                before, self.excess = self.excess, self._excess(values)
                self.largest = max(self.largest, self.excess)
                return None if before > 0.0 else self.renew(sample)
        self.excess = 0.0
        return None

    def renew(self, sample: Observed) -> Alarm | None:
        """See Guard."""
        what = (f'outside of the box that the model was trained in, by {self.excess:.2g} of its '
                'half-width: H is a guess there; train a model on a larger box')
        if self.excess == 0.0:
            what = (f'inside again, but was up to {self.largest:.2g} of its half-width outside of '
                    'the box that the model was trained in: H is a guess there; train a model on '
                    'a larger box')
        return Alarm(self.kind, sample.step, self.excess, 0.0, what, 'half-widths')

    def _excess(self, values: list[float]) -> float:
        return max(2.0 * max(x - high, low - x) / (high - low)
                   for x, low, high in zip(values, self._low, self._high, strict=True))
