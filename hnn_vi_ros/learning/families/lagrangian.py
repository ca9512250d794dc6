# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Families for data without canonical momenta: Lagrangians and a symplectic form."""

from typing import Any, ClassVar, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import (
    EnergyFamily, gradient, keep, Perceptron, Scales, Trainable)
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.models import irregularity, Layers, REMEDY
import numpy as np
from pydantic import Field
import torch

_SAMPLES = 256
_ITERATIONS = 50
_WEIGHT = 1e-2


class LagrangianChoice(FamilyChoice):
    """Configuration of L(q, v): a network plus a constant mass; see LagrangianNetwork."""

    kind: Literal['lagrangian']
    mass: float = Field(1.0, gt=0.0, description=(
        'mean mass of the first coordinate, which sets the unit of energy: motions do not '
        'determine it'))
    losses: ClassVar[tuple[str, ...]] = ('euler_lagrange',)


class LagrangianNetwork(Trainable):
    """
    L(q, v) = v . M v / 2 + N(q, v): a constant diagonal M and a network; needs accelerations.

    M keeps the Hessian L_vv regular during training. Motions determine L up to a factor, the unit
    of energy, and up to the time derivative of a function of q, which changes the momenta p = L_v.
    The configured mean mass of the first coordinate, (L_vv)_11, fixes the factor; a small penalty
    on the momenta at rest fixes the function. If only positions are known, use VIN; for other
    noncanonical coordinates, SymplecticForm.

    Parameters
    ----------
    choice : LagrangianChoice
        Configuration with the mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    M. Cranmer, S. Greydanus, S. Hoyer, P. Battaglia, D. Spergel, S. Ho, Lagrangian Neural
    Networks, 2020, arXiv:2003.04630.

    """

    schema = LagrangianChoice

    def __init__(self, choice: LagrangianChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        mass = choice.mass * (scales.v_half[0] / scales.v_half)**2
        acceleration = scales.p_rate / scales.p_half * scales.v_half
        self.first_mass = choice.mass
        centre = np.concatenate([scales.q_centre, scales.v_centre])
        half = np.concatenate([scales.q_half, scales.v_half])
        self.network = Perceptron(
            hidden, centre, half, np.array([np.mean(mass * acceleration * scales.q_half)]), seed)
        with torch.no_grad():
            # Small weights, so that L_vv is regular initially.
            self.network.linears[-1].weight.mul_(0.1)
        # Sample the inner half of the box: its corners may be far from all data.
        box = np.random.default_rng(0).uniform(-0.5, 0.5, (_SAMPLES, len(centre)))
        keep(self, mass=mass, samples=centre + half * box)

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

        This solves the Euler-Lagrange equation L_vv a + L_vq v = L_q for a: the residual of the
        equation itself would be minimal for L = 0.
        """
        slope, rows = self.derivatives(x)
        mixed, mass = rows.chunk(2, dim=2)
        force = slope.chunk(2, dim=1)[0] - (mixed @ x.chunk(2, dim=1)[1][:, :, None])[:, :, 0]
        return torch.linalg.solve(mass, force[:, :, None])[:, :, 0]

    def preference(self, x: torch.Tensor) -> torch.Tensor:
        """Return a small penalty on the momenta at rest, L_v(q, 0), in units of M v."""
        q, v = x.chunk(2, dim=1)
        slope = gradient(self.lagrangian, torch.cat([q, torch.zeros_like(v)], dim=1))
        unit = self.mass * self.network.scale.chunk(2)[1]
        return _WEIGHT * (slope.chunk(2, dim=1)[1] / unit).square().mean()

    @property
    def factor(self) -> float:
        """Return the factor of L that scales the mean of (L_vv)_11 to the configured mass."""
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
        # H = p . v - L at z0; the constant of N adjusts it to energy0.
        value = float(p0 @ v0 - 0.5 * factor * (self.mass * v0) @ v0) - energy0
        return {'lagrangian': self.network.layers(x0.numpy(), value, factor)}

    def constants(self) -> dict[str, Any]:
        """Return M and the range of velocities in the training data."""
        bounds = torch.stack([self.network.centre - self.network.scale,
                              self.network.centre + self.network.scale], dim=1)
        return {'mass': torch.diag(self.factor * self.mass).tolist(),
                'velocities': bounds.chunk(2)[1].tolist()}

    def momenta(self, dataset: Dataset) -> np.ndarray:
        """Return L_v(q, dq/dt), shape (N, d)."""
        x = torch.tensor(np.hstack([dataset.q, dataset.dq_dt]))
        return self.factor * gradient(self.lagrangian, x).chunk(2, dim=1)[1].detach().numpy()


class VINChoice(FamilyChoice):
    """Configuration of a constant mass matrix and a network V(q), from positions; see VIN."""

    kind: Literal['vin']
    mass: float = Field(1.0, gt=0.0, description=(
        'mass of the first coordinate, which sets the unit of energy: positions do not determine '
        'it'))
    losses: ClassVar[tuple[str, ...]] = ('discrete_lagrangian',)


class VIN(EnergyFamily):
    """
    A constant mass matrix M and a network V(q), from positions only: L = v . M v / 2 - V(q).

    Positions determine only M^-1 V': a common factor is the unit of energy, fixed by the
    configured mass M_11 of the first coordinate. With known accelerations, use LagrangianNetwork.

    Parameters
    ----------
    choice : VINChoice
        Configuration with the mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    S. Saemundsson, A. Terenin, K. Hofmann, M. P. Deisenroth, Variational Integrator Networks for
    Physically Structured Embeddings, AISTATS 2020.

    """

    schema = VINChoice

    def __init__(self, choice: VINChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        # M = S F F^T S: coordinates of equal kinetic energy have equal masses in units of S.
        unit = np.sqrt(choice.mass) * scales.v_half[0] / scales.v_half
        keep(self, unit=unit)
        self.factor = torch.nn.Parameter(torch.eye(len(unit), dtype=torch.float64))
        acceleration = scales.p_rate / scales.p_half * scales.v_half
        self.potential = Perceptron(
            hidden, scales.q_centre, scales.q_half,
            np.array([np.mean(unit**2 * acceleration * scales.q_half)]), seed)

    @property
    def mass(self) -> torch.Tensor:
        """Return M, shape (d, d)."""
        factor = torch.tril(self.factor)
        # Dividing by the first entry of F fixes M_11.
        factor = self.unit[:, None] * factor / factor[0, 0]
        return factor @ factor.T

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H = p . M^-1 p / 2 + V(q), shape (N,), at states z = (q, p), (N, 2 d)."""
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


_BOX = 1024
_EVENNESS = 1e-5


class SymplecticFormChoice(FamilyChoice):
    """Configuration of theta(u) and H(u), u for example (q, dq/dt); see SymplecticForm."""

    kind: Literal['symplectic_form']
    mass: float = Field(1.0, gt=0.0, description=(
        'mean of d theta_q / dp of the first coordinate, which sets the unit of energy: motions '
        'do not determine it'))
    losses: ClassVar[tuple[str, ...]] = ('vector_field',)


class SymplecticForm(Trainable):
    """
    theta(u) = (M p, 0) + N(u) and H(u), u = (q, p): a constant diagonal M and two networks.

    The variation of the integral of theta(u) . u' - H(u) vanishes if W(u) u' = H'(u), with
    W_ij = d_i theta_j - d_j theta_i; see SymplecticFormHamiltonian. The loss compares u' with
    W^-1 H', because the residual of the equation is minimal for theta = 0, H = 0. M keeps W
    regular during training. Use it for noncanonical coordinates; otherwise HNN.

    Motions determine theta and H up to a common factor, the unit of energy, and theta up to a
    gradient, which has no effect. The configured mean mass of the first coordinate, W_ij with i
    its p and j its q, fixes the factor. In one degree of freedom, any f(H) with f'(H) W is
    equivalent; a small penalty on the variation of W selects one.

    Parameters
    ----------
    choice : SymplecticFormChoice
        Configuration with the mass of the first coordinate.
    hidden : list of int
        Widths of the hidden layers of both networks.
    scales : Scales
        Scales of the data; p is the second half of the coordinates.
    seed : int
        Seed of the initial weights.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Neural Symplectic Form: Learning Hamiltonian Equations on
    General Coordinate Systems, NeurIPS 2021.

    """

    schema = SymplecticFormChoice

    def __init__(self, choice: SymplecticFormChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        # Masses for which all pairs of coordinates have equal actions.
        mass = choice.mass * (scales.p_half[0] * scales.q_half[0]
                              / (scales.p_half * scales.q_half))
        self.first_mass = choice.mass
        action = mass[0] * scales.p_half[0] * scales.q_half[0]
        self.one_form = Perceptron(hidden, scales.centre, scales.half, action / scales.half, seed)
        rate = np.mean(np.concatenate([scales.q_rate, scales.p_rate]) / scales.half)
        self.energy = Perceptron(
            hidden, scales.centre, scales.half, np.array([action * rate]), seed + 1)
        with torch.no_grad():
            # Small weights, so that W is regular initially.
            self.one_form.linears[-1].weight.mul_(0.1)
        box = np.random.default_rng(0).uniform(-1.0, 1.0, (_BOX, len(scales.centre)))
        keep(self, mass=mass, samples=scales.centre + scales.half * box)

    def two_form(self, z: torch.Tensor) -> torch.Tensor:
        """Return W, shape (N, 2 d, 2 d), at states of shape (N, 2 d)."""
        d = len(self.mass)
        every = torch.eye(2 * d, dtype=z.dtype, device=z.device)[:, None, :]
        slope = self.one_form.outputs(self.one_form.hidden(z, every))[1].permute(1, 2, 0)
        canonical = torch.zeros_like(slope[0])
        canonical[:d, d:] = torch.diag(self.mass)
        slope = slope + canonical
        return slope.transpose(1, 2) - slope

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None) -> torch.Tensor:
        """Return u' = W^-1 H', shape (N, 2 d), at states of shape (N, 2 d)."""
        return torch.linalg.solve(self.two_form(z), gradient(self.energy, z)[:, :, None])[:, :, 0]

    def preference(self, z: torch.Tensor, *others: torch.Tensor) -> torch.Tensor | None:
        """Return a small penalty on the variation of W in one degree of freedom; see Trainable."""
        if len(self.mass) > 1:
            return None
        weight = self.two_form(z)[:, 1, 0]
        return _EVENNESS * (weight / weight.mean() - 1.0).square().mean()

    @property
    def factor(self) -> float:
        """
        Return the factor of theta and H that scales the mean mass to the configured one.

        Raises
        ------
        DataError
            W is singular at some point of the data's box.

        """
        two_forms, d = self.two_form(self.samples).detach(), len(self.mass)
        problem = irregularity(two_forms.numpy(), self.one_form.scale.numpy())
        if problem:
            raise DataError(f'{problem}: {REMEDY}; or train longer, or with another seed')
        return self.first_mass / float(two_forms[:, d, 0].mean())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the networks N and H; see Trainable."""
        factor = self.factor
        return {'one_form': self.one_form.layers(factor=factor),
                'energy': self.energy.layers(z0, energy0, factor)}

    def constants(self) -> dict[str, Any]:
        """Return M."""
        return {'mass': torch.diag(self.factor * self.mass).tolist()}
