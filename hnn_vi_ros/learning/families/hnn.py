# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hamiltonian neural networks: H(q, p), with friction, dissipation or commands."""

from typing import Any, ClassVar, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.families.base import EnergyFamily, gradient, keep, Perceptron, Scales
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.models import Layers
import numpy as np
from pydantic import Field
import torch


class _OneNetwork(EnergyFamily):
    """Base of families whose H(q, p) is one network of all of the state."""

    def __init__(self, choice: FamilyChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.network = Perceptron(
            hidden, scales.centre, scales.half, np.array([scales.energy]), seed)

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""
        return self.network(z)[:, 0]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the network; see Trainable."""
        return {'energy': self.network.layers(z0, energy0)}


class HNNChoice(FamilyChoice):
    """One network H(q, p)."""

    kind: Literal['hnn']


class HNN(_OneNetwork):
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


class SeparableHNNChoice(FamilyChoice):
    """Networks T(p) and V(q), for explicit methods."""

    kind: Literal['separable_hnn']


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


_WEIGHT = 1e-3


class DissipativeHNNChoice(FamilyChoice):
    """Networks H(q, p) and D(q, p): q' = H_p + D_q, p' = -H_q + D_p."""

    kind: Literal['dissipative_hnn']


class DissipativeHNN(_OneNetwork):
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
        super().__init__(choice, hidden, scales, seed)
        # D_p is of the order of dp/dt.
        power = np.mean(np.concatenate(
            [scales.q_rate * scales.q_half, scales.p_rate * scales.p_half]))
        self.dissipation = Perceptron(
            hidden, scales.centre, scales.half, np.array([power]), seed + 1)
        keep(self, rates=np.concatenate([scales.q_rate, scales.p_rate]))

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """Return (H_p + D_q, -H_q + D_p); see EnergyFamily."""
        return super().vector_field(z) + gradient(self.dissipation, z)

    def preference(self, z: torch.Tensor, *others: torch.Tensor) -> torch.Tensor:
        """Return a small weight on D_q and on the mean of D_p, in units of the rates."""
        D_q, D_p = (gradient(self.dissipation, z) / self.rates).chunk(2, dim=1)
        return _WEIGHT * (D_q.square().mean() + D_p.mean(dim=0).square().mean())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return H and D; see Trainable."""
        return super().networks(z0, energy0) | {'dissipation': self.dissipation.layers(z0, 0.0)}


class DGNetChoice(FamilyChoice):
    """One network H(q, p), and linear friction."""

    kind: Literal['dgnet']
    friction: bool = Field(True, description='whether dp/dt = -H_q - gamma p, or gamma = 0')
    losses: ClassVar[tuple[str, ...]] = ('discrete_gradient', 'vector_field')


class DGNet(_OneNetwork):
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
        super().__init__(choice, hidden, scales, seed)
        # Squared, for it is never negative; it begins at a tenth of the data's fastest rates.
        keep(self, unit=scales.p_rate / scales.p_half)
        self.root = torch.nn.Parameter(
            torch.full_like(self.unit, 0.1**0.5 if choice.friction else 0.0),
            requires_grad=choice.friction)

    @property
    def friction(self) -> torch.Tensor:
        """Return gamma, shape (d,) [1/s]."""
        return self.unit * self.root.square()

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

    def constants(self) -> dict[str, Any]:
        """Return the friction."""
        return {'friction': self.friction.detach().tolist()}


class ControlAffineChoice(FamilyChoice):
    """Networks for the mass matrix, the potential and the input map of commands."""

    kind: Literal['control_affine']
    losses: ClassVar[tuple[str, ...]] = ('vector_field',)


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
        # At first A is about diagonal.
        self.root = Perceptron(hidden, *where, root[self.rows], seed,
                               torch.tensor(self.rows == self.columns))
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
