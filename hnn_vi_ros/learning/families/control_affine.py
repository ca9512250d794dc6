# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The control-affine network: mass matrix, potential and input map."""

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.families.base import EnergyFamily, Scales
from hnn_vi_ros.learning.families.choices import ControlAffineChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class ControlAffine(EnergyFamily):
    """
    H(q, p) = p . M^-1(q) p / 2 + V(q), driven by commands u: q' = H_p, p' = -H_q + g(q) u.

    M^-1 = A A^T with a lower triangular A(q); networks give its entries, row by row, V, and the
    entries of the input map g, of shape (d, m), row by row.

    Parameters
    ----------
    choice : ControlAffineChoice
        Of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    Raises
    ------
    DataError
        The data hold no commands.

    References
    ----------
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net: Learning Hamiltonian Dynamics with
    Control, ICLR 2020.

    """

    def __init__(self, choice: ControlAffineChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        d, m = len(scales.q_half), len(scales.command)
        if m == 0:
            raise DataError('the family control_affine learns what commands do, but the data hold '
                            'none; name them in data.commands')
        where = scales.q_centre, scales.q_half
        self.rows, self.columns = np.tril_indices(d)
        root = np.sqrt(scales.v_half / scales.p_half)
        self.root = Perceptron(hidden, *where, root[self.rows], seed)
        with torch.no_grad():
            # At first A is about diagonal and changes little.
            self.root.linears[-1].weight.mul_(0.1)
            self.root.linears[-1].bias.copy_(torch.tensor(1.0 * (self.rows == self.columns)))
        self.potential = Perceptron(
            hidden, *where, np.array([np.mean(scales.p_rate * scales.q_half)]), seed + 1)
        self.input_map = Perceptron(
            hidden, *where, np.outer(scales.p_rate, 1.0 / scales.command).ravel(), seed + 2)
        self.shape = d, m

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        root = torch.zeros(len(q), *2 * self.shape[:1], dtype=q.dtype, device=q.device)
        root[:, self.rows, self.columns] = self.root(q)
        speed = (root * p[:, :, None]).sum(dim=1)
        return 0.5 * speed.square().sum(dim=1) + self.potential(q)[:, 0]

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """Return (H_p, -H_q + g(q) u); see EnergyFamily."""
        field = super().vector_field(z)
        if commands is None:
            return field
        q, _ = z.chunk(2, dim=1)
        force = self.input_map(q).reshape(-1, *self.shape) @ commands[:, :, None]
        return field + torch.cat([torch.zeros_like(q), force[:, :, 0]], dim=1)

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return A, V and g; see Trainable."""
        q0, _ = np.split(z0, 2)
        z = torch.tensor(z0)[None]
        kinetic = float((self.energy(z) - self.potential(z.chunk(2, dim=1)[0])[:, 0]).detach())
        return {'mass_inverse': self.root.layers(),
                'potential': self.potential.layers(q0, energy0 - kinetic),
                'input_map': self.input_map.layers()}
