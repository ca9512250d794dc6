# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Plain network of a machine, with no mechanics in it: a baseline."""

from collections.abc import Sequence

from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.learning.families.structure import MotionScales
from hnn_vi_ros.models.mechanical_card import Kind
import numpy as np
import torch


class PlainNetwork(torch.nn.Module):
    """
    dv/dt = N(q, v, tau), a perceptron in float64: a neural ordinary differential equation.

    The inputs are the sine and cosine of coordinates that turn over.

    Parameters
    ----------
    kinds : sequence of str
        Of the coordinates.
    hidden : sequence of int
        Widths of the hidden layers.
    scales : MotionScales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    R. Chen, Y. Rubanova, J. Bettencourt, D. Duvenaud, Neural Ordinary Differential Equations,
    NeurIPS 2018.

    """

    has_masses = False

    def __init__(self, kinds: Sequence[Kind], hidden: Sequence[int], scales: MotionScales,
                 seed: int):
        super().__init__()
        self.scales = scales
        turns = np.array([kind == 'continuous' for kind in kinds])
        self._turning, self._others = np.flatnonzero(turns), np.flatnonzero(~turns)
        half = scales.q_half[~turns]
        centre = np.concatenate([np.zeros(2 * turns.sum()), scales.q_centre[~turns],
                                 np.zeros(len(kinds) + len(scales.command))])
        unit = np.concatenate([np.ones(2 * turns.sum()), np.where(half > 0.0, half, 1.0),
                               scales.v, scales.command])
        self.perceptron = Perceptron(hidden, centre, unit, scales.a, seed)

    def accelerations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return dv/dt, shape (N, d), at q and v of that shape and commands of shape (N, m)."""
        angles = q[:, self._turning]
        return self.perceptron(torch.cat([
            torch.sin(angles), torch.cos(angles), q[:, self._others], v, tau], dim=1))
