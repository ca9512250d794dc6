# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Features of the coordinates that a network sees, in torch: models/features.py, for training."""

from collections.abc import Sequence
import math

from hnn_vi_ros.learning.families.structure import MotionScales
from hnn_vi_ros.models.mechanical_card import is_periodic, Kind
import numpy as np
import torch


class Seen(torch.nn.Module):
    """
    The inputs G q, or sin(G q) and cos(G q) of rows that turn; one input 0 where there is no row.

    Each input depends on one row of G alone: ``rows`` holds it for each input, ``features`` all
    of them once, and ``of_feature`` which inputs depend on which.

    Parameters
    ----------
    kinds : sequence of str
        Of the coordinates.
    features : sequence of sequence of float
        The rows of G.

    """

    def __init__(self, kinds: Sequence[Kind], features: Sequence[list[float]]):
        super().__init__()
        rows, phases, periodic, of_feature = [], [], [], []
        for number, row in enumerate(features):
            turns = is_periodic(kinds, row)
            # The cosine is a sine that is a quarter of a turn ahead.
            rows += [row, row] if turns else [row]
            phases += [0.0, 0.5 * math.pi] if turns else [0.0]
            periodic += [turns, turns] if turns else [turns]
            of_feature += [number, number] if turns else [number]
        if not features:
            rows, phases, periodic, of_feature = [[0.0] * len(kinds)], [0.0], [False], [0]
        self._turn = all(periodic)
        for key, values in (
                ('rows', rows), ('phase', phases), ('periodic', periodic),
                ('features', features or rows),
                ('of_feature', np.arange(len(features) or 1)[:, None] == of_feature)):
            self.register_buffer(key, torch.tensor(
                values, dtype=torch.bool if key == 'periodic' else torch.float64),
                persistent=False)

    def units(self, scales: MotionScales) -> tuple[np.ndarray, np.ndarray]:
        """Return centre and scale of the inputs, each of shape (n,)."""
        rows, periodic = self.rows.numpy(), self.periodic.numpy()
        centre = np.where(periodic, 0.0, rows @ scales.q_centre)
        half = np.where(periodic, 1.0, np.abs(rows) @ scales.q_half)
        return centre, np.where(half > 0.0, half, 1.0)

    def forward(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the inputs and their derivatives by their rows, (N, n), at q of (N, d)."""
        y = torch.addmm(self.phase, q, self.rows.T)
        if self._turn:
            return torch.sin(y), torch.cos(y)
        return (torch.where(self.periodic, torch.sin(y), y),
                torch.where(self.periodic, torch.cos(y), 1.0))
