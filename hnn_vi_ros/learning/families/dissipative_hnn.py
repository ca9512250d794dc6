# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The dissipative Hamiltonian neural network."""

from hnn_vi_ros.learning.families.base import EnergyFamily, gradient, Scales
from hnn_vi_ros.learning.families.choices import DissipativeHNNChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch

_WEIGHT = 1e-3


class DissipativeHNN(EnergyFamily):
    """
    Networks H(q, p) and D(q, p), with q' = H_p + D_q and p' = -H_q + D_p.

    The field leaves them open up to a pair of conjugate harmonic functions. What rubs changes
    momenta: a small weight on D_q, and on the mean of D_p, makes H the energy where it can.

    Parameters
    ----------
    choice : DissipativeHNNChoice
        Of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    A. Sosanya, S. Greydanus, Dissipative Hamiltonian Neural Networks: Learning Dissipative and
    Conservative Dynamics Separately, 2022, arXiv:2201.10085.

    """

    def __init__(self, choice: DissipativeHNNChoice, hidden: list[int], scales: Scales,
                 seed: int):
        super().__init__()
        self.conservative = Perceptron(
            hidden, scales.centre, scales.half, np.array([scales.energy]), seed)
        # D_p is of the order of dp/dt.
        power = np.mean(np.concatenate(
            [scales.q_rate * scales.q_half, scales.p_rate * scales.p_half]))
        self.dissipation = Perceptron(
            hidden, scales.centre, scales.half, np.array([power]), seed + 1)
        rates = np.concatenate([scales.q_rate, scales.p_rate])
        self.register_buffer('rates', torch.tensor(rates), persistent=False)

    def _dissipation(self, z: torch.Tensor) -> torch.Tensor:
        return self.dissipation(z)[:, 0]

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        return self.conservative(z)[:, 0]

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """Return (H_p + D_q, -H_q + D_p); see EnergyFamily."""
        return super().vector_field(z) + gradient(self._dissipation, z)

    def preference(self, z: torch.Tensor, *others: torch.Tensor) -> torch.Tensor:
        """Return a small weight on D_q and on the mean of D_p, in units of the rates."""
        D_q, D_p = (gradient(self._dissipation, z) / self.rates).chunk(2, dim=1)
        return _WEIGHT * (D_q.square().mean() + D_p.mean(dim=0).square().mean())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return H and D; see Trainable."""
        return {'energy': self.conservative.layers(z0, energy0),
                'dissipation': self.dissipation.layers(z0, 0.0)}
