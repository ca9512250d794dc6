# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hamiltonian neural network."""

from hnn_vi_ros.learning.families.base import EnergyFamily, Scales
from hnn_vi_ros.learning.families.choices import HNNChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class HNN(EnergyFamily):
    """
    One network H(q, p).

    Parameters
    ----------
    choice : HNNChoice
        Of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    S. Greydanus, M. Dzamba, J. Yosinski, Hamiltonian Neural Networks, NeurIPS 2019.

    """

    def __init__(self, choice: HNNChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.network = Perceptron(
            hidden, scales.centre, scales.half, np.array([scales.energy]), seed)

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        return self.network(z)[:, 0]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the network; see Trainable."""
        return {'energy': self.network.layers(z0, energy0)}
