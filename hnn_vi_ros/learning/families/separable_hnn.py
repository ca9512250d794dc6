# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The separable Hamiltonian neural network."""

from hnn_vi_ros.learning.families.base import EnergyFamily, Scales
from hnn_vi_ros.learning.families.choices import SeparableHNNChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class SeparableHNN(EnergyFamily):
    """
    H(q, p) = T(p) + V(q), a network each, for explicit methods like stormer_verlet.

    Parameters
    ----------
    choice : SeparableHNNChoice
        Of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    Z. Chen, J. Zhang, M. Arjovsky, L. Bottou, Symplectic Recurrent Neural Networks, ICLR 2020.

    """

    def __init__(self, choice: SeparableHNNChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.kinetic = Perceptron(
            hidden, scales.p_centre, scales.p_half,
            np.array([np.mean(scales.q_rate * scales.p_half)]), seed)
        self.potential = Perceptron(
            hidden, scales.q_centre, scales.q_half,
            np.array([np.mean(scales.p_rate * scales.q_half)]), seed + 1)

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        return self.kinetic(p)[:, 0] + self.potential(q)[:, 0]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return T, zero at the momenta of z0, and V; see Trainable."""
        q0, p0 = np.split(z0, 2)
        return {'kinetic': self.kinetic.layers(p0, 0.0),
                'potential': self.potential.layers(q0, energy0)}
