# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a network sees of the coordinates, in torch: models/features.py, for training."""

from collections.abc import Sequence
import math

from hnn_vi_ros.learning.families.structure import MotionScales
from hnn_vi_ros.models.mechanical_card import is_periodic, Kind
import numpy as np
import torch


class Seen(torch.nn.Module):
    """
    The inputs G q, or sin(G q) and cos(G q) of rows that turn; one input 0 where there is no row.

    Parameters
    ----------
    kinds : sequence of str
        Of the coordinates.
    features : sequence of sequence of float
        The rows of G.

    """

    def __init__(self, kinds: Sequence[Kind], features: Sequence[list[float]]):
        super().__init__()
        rows, phases, periodic = [], [], []
        for row in features:
            turns = is_periodic(kinds, row)
            # The cosine is a sine that is a quarter of a turn ahead.
            rows += [row, row] if turns else [row]
            phases += [0.0, 0.5 * math.pi] if turns else [0.0]
            periodic += [turns, turns] if turns else [turns]
        if not features:
            rows, phases, periodic = [[0.0] * len(kinds)], [0.0], [False]
        for key, values in (('rows', rows), ('phase', phases), ('periodic', periodic)):
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
        """Return the inputs, shape (N, n), and their derivatives, (N, n, d), at q of (N, d)."""
        y = q @ self.rows.T + self.phase
        slope = torch.where(self.periodic, torch.cos(y), 1.0)
        return torch.where(self.periodic, torch.sin(y), y), slope[:, :, None] * self.rows
