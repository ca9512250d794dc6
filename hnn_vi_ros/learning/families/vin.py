# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The variational integrator network, learned from positions alone."""

from typing import Any

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import EnergyFamily, gradient, Scales
from hnn_vi_ros.learning.families.choices import VINChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class VIN(EnergyFamily):
    """
    A constant mass matrix M and a network V(q): L(q, v) = v . M v / 2 - V(q).

    Positions tell M^-1 V' alone: what multiplies both by a number is another unit of energy. It is
    set by the mass of the first coordinate, M_11, which the configuration gives.

    Parameters
    ----------
    choice : VINChoice
        The mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    S. Saemundsson, A. Terenin, K. Hofmann, M. P. Deisenroth, Variational Integrator Networks for
    Physically Structured Embeddings, AISTATS 2020.

    """

    def __init__(self, choice: VINChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        # M = S F F^T S: coordinates of equal kinetic energy have equal masses in units of S.
        unit = np.sqrt(choice.mass) * scales.v_half[0] / scales.v_half
        self.register_buffer('unit', torch.tensor(unit), persistent=False)
        self.factor = torch.nn.Parameter(torch.eye(len(unit), dtype=torch.float64))
        acceleration = scales.p_rate / scales.p_half * scales.v_half
        self.potential = Perceptron(
            hidden, scales.q_centre, scales.q_half,
            np.array([np.mean(unit**2 * acceleration * scales.q_half)]), seed)

    @property
    def mass(self) -> torch.Tensor:
        """Return M, shape (d, d)."""
        factor = torch.tril(self.factor)
        # The first entry of F is one, which fixes M_11.
        factor = self.unit[:, None] * factor / factor[0, 0]
        return factor @ factor.T

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H = p . M^-1 p / 2 + V(q), shape (N,), of states z = (q, p), (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        v = torch.linalg.solve(self.mass, p.T).T
        return 0.5 * (p * v).sum(dim=1) + self.potential(q)[:, 0]

    def acceleration(self, q: torch.Tensor) -> torch.Tensor:
        """Return -M^-1 V'(q), shape (N, d), at coordinates of shape (N, d)."""
        return -torch.linalg.solve(self.mass, gradient(self.potential, q).T).T

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return V; see Trainable."""
        q0, p0 = np.split(z0, 2)
        kinetic = 0.5 * p0 @ np.linalg.solve(self.mass.detach().numpy(), p0)
        return {'potential': self.potential.layers(q0, float(energy0 - kinetic))}

    def constants(self) -> dict[str, Any]:
        """Return the mass matrix."""
        return {'mass': self.mass.detach().tolist()}

    def momenta(self, dataset: Dataset) -> np.ndarray:
        """Return M dq/dt, shape (N, d)."""
        return dataset.dq_dt @ self.mass.detach().numpy()
