# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The neural symplectic form: a one-form and an energy in coordinates of any kind."""

from typing import Any

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.families.base import gradient, Scales, Trainable
from hnn_vi_ros.learning.families.choices import SymplecticFormChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
from hnn_vi_ros.models.symplectic_form import irregularity, REMEDY
import numpy as np
import torch

_SAMPLES = 1024
_WEIGHT = 1e-5


class SymplecticForm(Trainable):
    """
    theta(u) = (M p, 0) + N(u) and H(u), u = (q, p): a constant diagonal M, and two networks.

    The variation of the integral of theta(u) . u' - H(u) is zero where W(u) u' = H'(u), with
    W_ij = d_i theta_j - d_j theta_i; see SymplecticFormHamiltonian. The loss compares
    u' = W^-1 H', not the residual of the equation, which is smallest for theta = 0, H = 0. M
    keeps W regular while N learns.

    Motions tell theta and H up to a common factor, which is another unit of energy, and theta up
    to the gradient of a function, which has no effect on anything. The factor is set by the mean
    of the first coordinate's mass, W_ij with i its p and j its q, which the configuration gives.
    In one degree of freedom any function f(H) will do as well, with f'(H) W; a small weight on
    the variation of W chooses among them.

    Parameters
    ----------
    choice : SymplecticFormChoice
        The mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers of both networks.
    scales : Scales
        Of the data, with the second half of the coordinates for p.
    seed : int
        Of the initial weights.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Neural Symplectic Form: Learning Hamiltonian Equations on
    General Coordinate Systems, NeurIPS 2021.

    """

    def __init__(self, choice: SymplecticFormChoice, hidden: list[int], scales: Scales,
                 seed: int):
        super().__init__()
        # Such that each pair of coordinates has as large an action.
        mass = choice.mass * (scales.p_half[0] * scales.q_half[0]
                              / (scales.p_half * scales.q_half))
        self.first_mass = choice.mass
        self.register_buffer('mass', torch.tensor(mass), persistent=False)
        action = mass[0] * scales.p_half[0] * scales.q_half[0]
        self.one_form = Perceptron(hidden, scales.centre, scales.half, action / scales.half, seed)
        rate = np.mean(np.concatenate([scales.q_rate, scales.p_rate]) / scales.half)
        self.energy = Perceptron(
            hidden, scales.centre, scales.half, np.array([action * rate]), seed + 1)
        with torch.no_grad():
            # An untrained network must not make W singular.
            self.one_form.linears[-1].weight.mul_(0.1)
        box = np.random.default_rng(0).uniform(-1.0, 1.0, (_SAMPLES, len(scales.centre)))
        self.register_buffer('samples', torch.tensor(scales.centre + scales.half * box),
                             persistent=False)

    def two_form(self, z: torch.Tensor) -> torch.Tensor:
        """Return W, shape (N, 2 d, 2 d), at states of shape (N, 2 d)."""
        d = len(self.mass)
        slope = self.one_form.slope(z)
        canonical = torch.zeros_like(slope[0])
        canonical[:d, d:] = torch.diag(self.mass)
        slope = slope + canonical
        return slope.transpose(1, 2) - slope

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """Return u' = W^-1 H', shape (N, 2 d), at states of shape (N, 2 d)."""
        rates = gradient(lambda x: self.energy(x)[:, 0], z)
        return torch.linalg.solve(self.two_form(z), rates[:, :, None])[:, :, 0]

    def preference(self, z: torch.Tensor, *others: torch.Tensor) -> torch.Tensor | None:
        """Return a small weight on the variation of W in one degree of freedom; see Trainable."""
        if len(self.mass) > 1:
            return None
        weight = self.two_form(z)[:, 1, 0]
        return _WEIGHT * (weight / weight.mean() - 1.0).square().mean()

    @property
    def factor(self) -> float:
        """
        Return the factor of theta and H that gives the mean mass its value.

        Raises
        ------
        DataError
            W is singular somewhere in the box of the data.

        """
        two_forms, d = self.two_form(self.samples).detach(), len(self.mass)
        problem = irregularity(two_forms.numpy(), self.one_form.scale.numpy())
        if problem:
            raise DataError(f'{problem}: {REMEDY}; or train longer, or with another seed')
        return self.first_mass / float(two_forms[:, d, 0].mean())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the networks N and H; see Trainable."""
        def scaled(layers: Layers) -> Layers:
            return Layers(*((*parts[:-1], self.factor * parts[-1]) for parts in layers))

        energy = self.energy.layers(z0, energy0 / self.factor)
        return {'one_form': scaled(self.one_form.layers()), 'energy': scaled(energy)}

    def constants(self) -> dict[str, Any]:
        """Return M."""
        return {'mass': torch.diag(self.factor * self.mass).tolist()}
