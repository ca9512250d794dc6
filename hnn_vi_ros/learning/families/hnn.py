# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hamiltonian neural networks H(q, p), some with friction, dissipation or commands."""

from typing import Any, ClassVar, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.families.base import EnergyFamily, gradient, keep, Perceptron, Scales
from hnn_vi_ros.learning.families.choices import FamilyChoice
from hnn_vi_ros.models import Layers
import numpy as np
from pydantic import Field
import torch


class _OneNetwork(EnergyFamily):
    """Base class of families with H(q, p) as one network of the whole state."""

    def __init__(self, choice: FamilyChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.network = Perceptron(
            hidden, scales.centre, scales.half, np.array([scales.energy]), seed)

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), at states z = (q, p), shape (N, 2 d)."""
        return self.network(z)[:, 0]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return the network of H; see Trainable."""
        return {'energy': self.network.layers(z0, energy0)}


class HNNChoice(FamilyChoice):
    """Configuration of one network H(q, p), for conservative systems; see HNN."""

    kind: Literal['hnn']


class HNN(_OneNetwork):
    """
    One network H(q, p) for conservative systems; if H = T(p) + V(q), SeparableHNN is better.

    Parameters
    ----------
    choice : HNNChoice
        Configuration of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    S. Greydanus, M. Dzamba, J. Yosinski, Hamiltonian Neural Networks, NeurIPS 2019.

    """

    schema = HNNChoice


class SeparableHNNChoice(FamilyChoice):
    """Configuration of networks T(p) and V(q), for explicit methods; see SeparableHNN."""

    kind: Literal['separable_hnn']


class SeparableHNN(EnergyFamily):
    """
    H(q, p) = T(p) + V(q), one network each, for explicit methods like stormer_verlet; else HNN.

    Parameters
    ----------
    choice : SeparableHNNChoice
        Configuration of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each network.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    Z. Chen, J. Zhang, M. Arjovsky, L. Bottou, Symplectic Recurrent Neural Networks, ICLR 2020.

    """

    schema = SeparableHNNChoice

    def __init__(self, choice: SeparableHNNChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        self.kinetic = Perceptron(
            hidden, scales.p_centre, scales.p_half,
            np.array([np.mean(scales.q_rate * scales.p_half)]), seed)
        self.potential = Perceptron(
            hidden, scales.q_centre, scales.q_half,
            np.array([np.mean(scales.p_rate * scales.q_half)]), seed + 1)

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), at states z = (q, p), shape (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        return self.kinetic(p)[:, 0] + self.potential(q)[:, 0]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return T with value zero at the momenta of z0, and V; see Trainable."""
        q0, p0 = np.split(z0, 2)
        return {'kinetic': self.kinetic.layers(p0, 0.0),
                'potential': self.potential.layers(q0, energy0)}


_WEIGHT = 1e-3


class DissipativeHNNChoice(FamilyChoice):
    """Configuration of H and D with q' = H_p + D_q, p' = -H_q + D_p; see DissipativeHNN."""

    kind: Literal['dissipative_hnn']


class DissipativeHNN(_OneNetwork):
    """
    Networks H and D for nonlinear friction, q' = H_p + D_q, p' = -H_q + D_p; if linear, DGNet.

    The field determines H and D up to a pair of conjugate harmonic functions. Friction changes
    only momenta: a small penalty on D_q and on the mean of D_p makes H the energy where possible.

    Parameters
    ----------
    choice : DissipativeHNNChoice
        Configuration of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each network.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    A. Sosanya, S. Greydanus, Dissipative Hamiltonian Neural Networks: Learning Dissipative and
    Conservative Dynamics Separately, 2022, arXiv:2201.10085.

    """

    schema = DissipativeHNNChoice

    def __init__(self, choice: DissipativeHNNChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__(choice, hidden, scales, seed)
        # D_p has the order of magnitude of dp/dt.
        power = np.mean(np.concatenate(
            [scales.q_rate * scales.q_half, scales.p_rate * scales.p_half]))
        self.dissipation = Perceptron(
            hidden, scales.centre, scales.half, np.array([power]), seed + 1)
        keep(self, rates=np.concatenate([scales.q_rate, scales.p_rate]))

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None) -> torch.Tensor:
        """Return (H_p + D_q, -H_q + D_p), as in EnergyFamily."""
        return super().vector_field(z) + gradient(self.dissipation, z)

    def preference(self, z: torch.Tensor, *others: torch.Tensor) -> torch.Tensor:
        """Return a small penalty on D_q and on the mean of D_p, in units of the rates."""
        D_q, D_p = (gradient(self.dissipation, z) / self.rates).chunk(2, dim=1)
        return _WEIGHT * (D_q.square().mean() + D_p.mean(dim=0).square().mean())

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """Return H and D; see Trainable."""
        return super().networks(z0, energy0) | {'dissipation': self.dissipation.layers(z0, 0.0)}


class DGNetChoice(FamilyChoice):
    """Configuration of one network H(q, p) with linear friction; see DGNet."""

    kind: Literal['dgnet']
    friction: bool = Field(True, description='include linear damping, dp/dt = -H_q - gamma p')
    losses: ClassVar[tuple[str, ...]] = ('discrete_gradient', 'vector_field')


class DGNet(_OneNetwork):
    """
    H(q, p) with q' = H_p, p' = -H_q - gamma p, for large time steps or noise; otherwise HNN.

    Parameters
    ----------
    choice : DGNetChoice
        Configuration of the family, with or without friction.
    hidden : list of int
        Widths of the hidden layers.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    T. Matsubara, A. Ishikawa, T. Yaguchi, Deep energy-based modeling of discrete-time physics,
    NeurIPS 2020.

    """

    schema = DGNetChoice

    def __init__(self, choice: DGNetChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__(choice, hidden, scales, seed)
        # The square keeps gamma nonnegative; it starts at a tenth of the data's fastest rates.
        keep(self, unit=scales.p_rate / scales.p_half)
        self.root = torch.nn.Parameter(
            torch.full_like(self.unit, 0.1**0.5 if choice.friction else 0.0),
            requires_grad=choice.friction)

    @property
    def friction(self) -> torch.Tensor:
        """Return gamma, shape (d,) [1/s]."""
        return self.unit * self.root.square()

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None) -> torch.Tensor:
        """Return (H_p, -H_q - gamma p), as in EnergyFamily."""
        q, p = z.chunk(2, dim=1)
        return super().vector_field(z) - torch.cat([torch.zeros_like(q), self.friction * p], dim=1)

    def discrete_field(self, z0: torch.Tensor, z1: torch.Tensor) -> torch.Tensor:
        """
        Return (D_p, -D_q - gamma (p0 + p1) / 2), shape (N, 2 d), to fit (z1 - z0) / h.

        (D_q, D_p) is the discrete gradient of H between the states, as in DiscreteGradient.
        """
        middle, change = 0.5 * (z0 + z1), z1 - z0
        slope = self.gradient(middle)
        rest = self.energy(z1) - self.energy(z0) - (slope * change).sum(dim=1)
        # Avoid division by zero for equal states.
        square = change.square().sum(dim=1).clamp_min(torch.finfo(change.dtype).tiny)
        D_q, D_p = (slope + (rest / square)[:, None] * change).chunk(2, dim=1)
        return torch.cat([D_p, -D_q - self.friction * middle.chunk(2, dim=1)[1]], dim=1)

    def constants(self) -> dict[str, Any]:
        """Return the friction."""
        return {'friction': self.friction.detach().tolist()}


class ControlAffineChoice(FamilyChoice):
    """Configuration of mass matrix, potential and input map; see ControlAffine."""

    kind: Literal['control_affine']
    driven: ClassVar[bool] = True
    losses: ClassVar[tuple[str, ...]] = ('vector_field',)


class ControlAffine(EnergyFamily):
    """
    H(q, p) = p . M^-1(q) p / 2 + V(q), driven by commands u: q' = H_p, p' = -H_q + g(q) u.

    M^-1 = A A^T with a lower triangular A(q). Networks return the entries of A by rows, V, and the
    entries of the input map g, shape (d, m), by rows. Use it for an unknown map g; otherwise HNN.

    Parameters
    ----------
    choice : ControlAffineChoice
        Configuration of the family; it has no settings.
    hidden : list of int
        Widths of the hidden layers of each network.
    scales : Scales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    Raises
    ------
    DataError
        The data contain no commands.

    References
    ----------
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net: Learning Hamiltonian Dynamics with
    Control, ICLR 2020.

    """

    schema = ControlAffineChoice

    def __init__(self, choice: ControlAffineChoice, hidden: list[int], scales: Scales, seed: int):
        super().__init__()
        d, m = len(scales.q_half), len(scales.command)
        if m == 0:
            raise DataError('the family control_affine learns the effect of commands, but the '
                            'data contain none; name them in data.commands')
        where = scales.q_centre, scales.q_half
        self.rows, self.columns = np.tril_indices(d)
        root = np.sqrt(scales.v_half / scales.p_half)
        # A is initially almost diagonal.
        self.root = Perceptron(hidden, *where, root[self.rows], seed,
                               torch.tensor(self.rows == self.columns))
        self.potential = Perceptron(
            hidden, *where, np.array([np.mean(scales.p_rate * scales.q_half)]), seed + 1)
        self.input_map = Perceptron(
            hidden, *where, np.outer(scales.p_rate, 1.0 / scales.command).ravel(), seed + 2)
        self.shape = d, m

    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), at states z = (q, p), shape (N, 2 d)."""
        q, p = z.chunk(2, dim=1)
        root = torch.zeros(len(q), *2 * self.shape[:1], dtype=q.dtype, device=q.device)
        root[:, self.rows, self.columns] = self.root(q)
        speed = (root * p[:, :, None]).sum(dim=1)
        return 0.5 * speed.square().sum(dim=1) + self.potential(q)[:, 0]

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None) -> torch.Tensor:
        """Return (H_p, -H_q + g(q) u), as in EnergyFamily."""
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
