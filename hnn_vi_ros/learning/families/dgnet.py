# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The network that is trained by the discrete gradient."""

from typing import Any

from hnn_vi_ros.learning.families.base import EnergyFamily, Scales
from hnn_vi_ros.learning.families.choices import DGNetChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class DGNet(EnergyFamily):
    """
    One network H(q, p), and friction: q' = H_p, p' = -H_q - gamma p.

    Parameters
    ----------
    choice : DGNetChoice
        Whether there is friction.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    T. Matsubara, A. Ishikawa, T. Yaguchi, Deep energy-based modeling of discrete-time physics,
    NeurIPS 2020.

    """

    def __init__(self, choice: DGNetChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.network = Perceptron(
            hidden, scales.centre, scales.half, np.array([scales.energy]), seed)
        # Squared, for it is never negative; it begins at a tenth of the data's fastest rates.
        self.register_buffer('unit', torch.tensor(scales.p_rate / scales.p_half), persistent=False)
        self.root = torch.nn.Parameter(
            torch.full_like(self.unit, 0.1**0.5 if choice.friction else 0.0),
            requires_grad=choice.friction)

    @property
    def friction(self) -> torch.Tensor:
        """Return gamma, shape (d,) [1/s]."""
        return self.unit * self.root.square()

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        return self.network(z)[:, 0]

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """Return (H_p, -H_q - gamma p); see EnergyFamily."""
        q, p = z.chunk(2, dim=1)
        return super().vector_field(z) - torch.cat([torch.zeros_like(q), self.friction * p], dim=1)

    def discrete_field(self, z0: torch.Tensor, z1: torch.Tensor) -> torch.Tensor:
        """
        Return (D_p, -D_q - gamma (p0 + p1) / 2), which (z1 - z0) / h must equal, shape (N, 2 d).

        D is the discrete gradient of H between the states; see the integrator DiscreteGradient.
        """
        middle, change = 0.5 * (z0 + z1), z1 - z0
        slope = self.gradient(middle)
        rest = self.energy(z1) - self.energy(z0) - (slope * change).sum(dim=1)
        # States that do not differ have no direction to correct along.
        square = change.square().sum(dim=1).clamp_min(torch.finfo(change.dtype).tiny)
        D_q, D_p = (slope + (rest / square)[:, None] * change).chunk(2, dim=1)
        return torch.cat([D_p, -D_q - self.friction * middle.chunk(2, dim=1)[1]], dim=1)

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the network; see Trainable."""
        return {'energy': self.network.layers(z0, energy0)}

    def constants(self) -> dict[str, Any]:
        """Return the friction."""
        return {'friction': self.friction.detach().tolist()}
