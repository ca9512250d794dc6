# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Lagrangian neural network."""

from typing import Any

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import gradient, Scales, Trainable
from hnn_vi_ros.learning.families.choices import LagrangianChoice
from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch

_SAMPLES = 256
_ITERATIONS = 50
_WEIGHT = 1e-2


class LagrangianNetwork(Trainable):
    """
    L(q, v) = v . M v / 2 + N(q, v): a constant diagonal M, and a network for all the rest.

    M keeps the Hessian L_vv regular while the network learns. Motions tell L up to a factor,
    which is another unit of energy, and up to the rate of change of a function of q, which
    changes the momenta p = L_v. The factor is set by the mean of the first coordinate's mass,
    (L_vv)_11, which the configuration gives; a small weight on the momenta at rest chooses the
    rest.

    Parameters
    ----------
    choice : LagrangianChoice
        The mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Of the data.
    seed : int
        Of the initial weights.

    References
    ----------
    M. Cranmer, S. Greydanus, S. Hoyer, P. Battaglia, D. Spergel, S. Ho, Lagrangian Neural
    Networks, 2020, arXiv:2003.04630.

    """

    def __init__(self, choice: LagrangianChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        mass = choice.mass * (scales.v_half[0] / scales.v_half)**2
        acceleration = scales.p_rate / scales.p_half * scales.v_half
        self.first_mass = choice.mass
        self.register_buffer('mass', torch.tensor(mass), persistent=False)
        centre = np.concatenate([scales.q_centre, scales.v_centre])
        half = np.concatenate([scales.q_half, scales.v_half])
        self.network = Perceptron(
            hidden, centre, half, np.array([np.mean(mass * acceleration * scales.q_half)]), seed)
        with torch.no_grad():
            # An untrained network must not make L_vv singular.
            self.network.linears[-1].weight.mul_(0.1)
        # The inner half of the box: its corners may be far from any data.
        box = np.random.default_rng(0).uniform(-0.5, 0.5, (_SAMPLES, len(centre)))
        self.register_buffer('samples', torch.tensor(centre + half * box), persistent=False)

    def lagrangian(self, x: torch.Tensor) -> torch.Tensor:
        """Return L, shape (N,), at points x = (q, v), shape (N, 2 d)."""
        _, v = x.chunk(2, dim=1)
        return 0.5 * (self.mass * v.square()).sum(dim=1) + self.network(x)[:, 0]

    def derivatives(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (L_q, L_v), shape (N, 2 d), and the rows (L_vq, L_vv), shape (N, d, 2 d)."""
        x = x.detach().requires_grad_(True)
        slope = gradient(self.lagrangian, x)
        rows = [torch.autograd.grad(entry.sum(), x, create_graph=True)[0]
                for entry in slope.chunk(2, dim=1)[1].unbind(dim=1)]
        return slope, torch.stack(rows, dim=1)

    def acceleration(self, x: torch.Tensor) -> torch.Tensor:
        """
        Return L_vv^-1 (L_q - L_vq v), shape (N, d), at points x = (q, v), shape (N, 2 d).

        That is the Euler-Lagrange equation L_vv a + L_vq v = L_q, solved for a: a residual of
        the equation itself would be smallest for L = 0.
        """
        slope, rows = self.derivatives(x)
        mixed, mass = rows.chunk(2, dim=2)
        force = slope.chunk(2, dim=1)[0] - (mixed @ x.chunk(2, dim=1)[1][:, :, None])[:, :, 0]
        return torch.linalg.solve(mass, force[:, :, None])[:, :, 0]

    def preference(self, x: torch.Tensor) -> torch.Tensor:
        """Return a small weight on the momenta at rest, L_v(q, 0), in units of M v."""
        q, v = x.chunk(2, dim=1)
        slope = gradient(self.lagrangian, torch.cat([q, torch.zeros_like(v)], dim=1))
        unit = self.mass * self.network.scale.chunk(2)[1]
        return _WEIGHT * (slope.chunk(2, dim=1)[1] / unit).square().mean()

    @property
    def factor(self) -> float:
        """Return the factor of L that gives the mean of (L_vv)_11 its value."""
        d = len(self.mass)
        return self.first_mass / float(self.derivatives(self.samples)[1][:, 0, d].mean().detach())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the network N; see Trainable."""
        factor = self.factor
        (q0, p0), v0 = torch.tensor(z0).chunk(2), torch.zeros(len(self.mass), dtype=torch.float64)
        for _ in range(_ITERATIONS):
            slope, rows = self.derivatives(torch.cat([q0, v0])[None])
            mass, missing = rows[0].chunk(2, dim=1)[1], p0 / factor - slope[0].chunk(2)[1]
            v0 = (v0 + torch.linalg.solve(mass, missing)).detach()
        x0 = torch.cat([q0, v0])
        # H = p . v - L there; the constant of N supplies the rest.
        value = float(p0 @ v0 - 0.5 * factor * (self.mass * v0) @ v0) - energy0
        weights, biases = self.network.layers()
        layers = Layers((*weights[:-1], factor * weights[-1]), biases)
        a = x0.numpy()
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            a = np.tanh(weight @ a + bias)
        return {'lagrangian': layers._replace(
            biases=(*biases[:-1], value - layers.weights[-1] @ a))}

    def constants(self) -> dict[str, Any]:
        """Return M, and the velocities in which L was learned."""
        bounds = torch.stack([self.network.centre - self.network.scale,
                              self.network.centre + self.network.scale], dim=1)
        return {'mass': torch.diag(self.factor * self.mass).tolist(),
                'velocities': bounds.chunk(2)[1].tolist()}

    def momenta(self, dataset: Dataset) -> np.ndarray:
        """Return L_v(q, dq/dt), shape (N, d)."""
        x = torch.tensor(np.hstack([dataset.q, dataset.dq_dt]))
        return self.factor * gradient(self.lagrangian, x).chunk(2, dim=1)[1].detach().numpy()
