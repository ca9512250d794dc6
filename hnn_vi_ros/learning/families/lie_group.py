# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lie group network: mass, potential, dissipation and input map of a rotating body."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import ClassVar, Literal

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.learning.families.base import keep, newton, Perceptron
from hnn_vi_ros.learning.families.choices import FamilyChoice, ON_THE_CPU
from hnn_vi_ros.models import Checkpoint, group_of, Layers, LieGroupCard, PoseInput
import numpy as np
from pydantic import Field
import torch

# Initial diagonals of the root of D, and of M, for which log(1 + exp(0.54)) is 1.
_FIRST, _UNIT_ROOT = 0.1, 0.54
# Smallest eigenvalue of S^-1 M^-1 S^-1 of a rotating body.
_FLOOR = 1e-3
LieMethod = Literal['lie_leapfrog', 'lie_variational_euler']
RetractionName = Literal['cayley', 'exponential']


class LieGroupChoice(FamilyChoice):
    """Networks of a rotating body: M(q)^-1 and V(q), or H(q, p); dissipation and input map."""

    kind: Literal['lie_group']
    losses: ClassVar[tuple[str, ...]] = ()
    refuses: ClassVar[Mapping[str, str]] = ON_THE_CPU
    structured: bool = Field(True, description=(
        'true: H = p . M^-1 p / 2 + V(q); false: the momentum is an input of V too, and M is '
        'constant'))
    mass_depends_on: list[PoseInput] = Field([], max_length=2, description=(
        'inputs of M; none: M is constant in the frame of the body'))
    potential_depends_on: list[PoseInput] = Field(
        ['attitude'], min_length=1, max_length=2, description='inputs of V')
    dissipation: Literal['none', 'constant', 'learned'] = Field('none', description=(
        'positive semidefinite D of the force -D v: constant, or with the inputs of M'))
    input_map: Literal['identity', 'learned'] = Field('learned', description=(
        'identity: the inputs are forces in the frame of the body, one for each velocity; '
        'learned: a matrix from inputs to forces is learned'))
    input_map_depends_on: list[PoseInput] = Field([], max_length=2, description=(
        'inputs of the learned map'))

    def _check(self) -> None:
        if not self.structured and self.mass_depends_on:
            raise ValueError('mass_depends_on: M is constant with structured: false; remove this '
                             'key')

    def card(self, kind: str, mass_scale: list[float], driven: bool) -> LieGroupCard:
        """Return the network inputs; raise ValueError for one that this body does not have."""
        potential: list[str] = [*self.potential_depends_on]
        if not self.structured:
            potential.append('momentum')
        drag = {'none': None, 'constant': [], 'learned': self.mass_depends_on or ['attitude']}
        return LieGroupCard.model_validate({
            'kind': kind, 'mass_scale': mass_scale, 'floor': _FLOOR,
            'mass_depends_on': self.mass_depends_on, 'potential_depends_on': potential,
            'dissipation_depends_on': drag[self.dissipation],
            'input_map_depends_on': self.input_map_depends_on
            if driven and self.input_map == 'learned' else None})


class BodyStage(StrictModel):
    """A number of steps on windows of a number of data intervals."""

    intervals: int = Field(ge=1, description='data intervals in each window')
    adam_steps: int = Field(0, ge=0, le=1_000_000)
    lbfgs_steps: int = Field(0, ge=0, le=1_000_000, description=(
        'number of L-BFGS steps, on the same windows each'))
    lbfgs_windows: int = Field(1024, ge=1, description=(
        'maximum number of these windows, drawn at random'))


@dataclass(frozen=True)
class BodyScales:
    """
    Scales of the motions of a body.

    Parameters
    ----------
    centre, half : np.ndarray, shape (k + 6,)
        Centre and half-range of the positions and of the entries of R; the half-range is 0 for
        constants.
    velocity, momentum, force : np.ndarray, shape (k,)
        Usual sizes in the body frame.
    input_map : np.ndarray, shape (k, m), optional
        Initial effect of one unit of each input.
    input_size : np.ndarray, shape (m,), optional
        Usual sizes of the inputs.

    """

    centre: np.ndarray
    half: np.ndarray
    velocity: np.ndarray
    momentum: np.ndarray
    force: np.ndarray
    input_map: np.ndarray | None = None
    input_size: np.ndarray | None = None


class LieGroupNetwork(torch.nn.Module):
    """
    H = pi . M(g)^-1 pi / 2 + V, dissipation -D v and input map B u, in float64.

    See LieGroupHamiltonian, and the effects learned_friction and external_force.

    Parameters
    ----------
    card : LieGroupCard
        Card with the inputs of the networks.
    hidden : sequence of int
        Widths of the hidden layers of each network with inputs.
    scales : BodyScales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    """

    def __init__(self, card: LieGroupCard, hidden: Sequence[int], scales: BodyScales, seed: int):
        super().__init__()
        self.card, self.k = card, card.size
        k, entries = card.size, card.entries
        rows, columns = np.array(entries).T
        keep(self, velocity_unit=scales.velocity, momentum_unit=scales.momentum,
             scale=np.array(card.mass_scale), place=np.eye(k * k)[rows * k + columns],
             on_diagonal=rows == columns)
        self.rows, self.entry_columns = rows.tolist(), columns.tolist()
        still = np.concatenate([scales.half == 0.0, np.zeros(k, dtype=bool)])
        centre = np.concatenate([scales.centre, np.zeros(k)])
        unit = np.concatenate([scales.half, scales.momentum])
        unit[still] = 1.0
        self.features = {name: card.columns(getattr(card, f'{name}_depends_on'))
                         for name in card.networks}
        outputs = {
            'mass': np.ones(len(entries)), 'potential': np.array([float(scales.force.mean())]),
            'dissipation': np.sqrt((scales.force / scales.velocity)[rows])}
        first = {'mass': _UNIT_ROOT * self.on_diagonal, 'dissipation': _FIRST * self.on_diagonal}
        if scales.input_map is not None and scales.input_size is not None:
            outputs['input_map'] = np.outer(scales.force, 1.0 / scales.input_size).ravel()
            first['input_map'] = torch.tensor(scales.input_map.ravel() / outputs['input_map'])
        for i, (name, at) in enumerate(self.features.items()):
            network = Perceptron(hidden if at else [1], centre[at] if at else np.zeros(1),
                                 unit[at] if at else np.ones(1), outputs[name], seed + i,
                                 first.get(name))
            self.add_module(name, network)
            if at:
                # Zero weights for constant inputs, whose effect the data do not determine.
                network.linears[0].weight.data[:, still[at]] = 0.0
            else:
                # A network without inputs is only its last bias.
                network.linears[0].requires_grad_(False)
                network.linears[-1].weight.requires_grad_(False).zero_()

    @classmethod
    def of(cls, model: Checkpoint) -> 'LieGroupNetwork':
        """Return the network of a model file."""
        card = group_of(model)
        ones = np.ones(card.size)
        inputs = model.networks['input_map'].widths[-1] // card.size \
            if 'input_map' in model.networks else 0
        scales = BodyScales(np.zeros(card.size + 6), np.ones(card.size + 6), ones, ones, ones,
                            np.zeros((card.size, inputs)), np.ones(inputs))
        network = cls(card, [1], scales, 0)
        for name, layers in model.networks.items():
            inputs, *hidden, count = layers.widths
            own = Perceptron(hidden, np.zeros(inputs), np.ones(inputs), np.ones(count), 0)
            own.load_state_dict({
                f'linears.{k}.{key}': torch.tensor(part)
                for key, parts in zip(('weight', 'bias'), layers, strict=True)
                for k, part in enumerate(parts)})
            network.add_module(name, own)
        return network

    def outputs(self, name: str, z: torch.Tensor) -> torch.Tensor:
        """Return the outputs of a network at (x, R, pi), a row per state, or one if constant."""
        at = self.features[name]
        return getattr(self, name)(z[:, at] if at else z.new_zeros((1, 1)))

    def slope(self, name: str, z: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Return the derivative by z of the weighted sum of outputs, with the shape of z."""
        at = self.features[name]
        return torch.zeros_like(z).index_copy(
            1, torch.tensor(at), getattr(self, name).gradient(z[:, at], weights))

    def roots(self, name: str, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return outputs, (N, e), and their lower triangular matrix, (N, k, k)."""
        y = self.outputs(name, z)
        entries = y
        if name == 'mass' and self.card.diagonal == 'softplus':
            # The default threshold of torch would cut off values below 2e-9.
            entries = torch.where(
                self.on_diagonal, torch.nn.functional.softplus(y, threshold=40.0), y)
        return y, (entries @ self.place).reshape(-1, self.k, self.k)

    def momenta(self, x: torch.Tensor, R: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Solve H_p(p) = v for p, shape (N, k); the velocities v are in the body frame."""
        held = HeldBody(self, x, R, v.new_zeros((len(v), 0)))
        pi = torch.linalg.solve_ex(held.inverse.expand(len(v), -1, -1), v[:, :, None])[0][:, :, 0]
        if 'momentum' in self.card.potential_depends_on:
            def residual(pi: torch.Tensor) -> torch.Tensor:
                return held.body_rates(pi)[0] - v
            found, J = newton(residual, pi.detach(), None, self.momentum_unit, self.velocity_unit)
            pi = found - torch.linalg.solve_ex(J, residual(found)[:, :, None])[0][:, :, 0]
        return held.in_space(pi)

    def inputs(self, x: torch.Tensor, R: torch.Tensor, u: torch.Tensor) -> torch.Tensor | None:
        """Return the force B u in the body frame, shape (N, k), or None without inputs."""
        if not u.shape[1]:
            return None
        if 'input_map' not in self.features:
            return u
        z = torch.cat([x, R.reshape(-1, 9)], dim=1)
        B = self.outputs('input_map', z).reshape(-1, self.k, u.shape[1])
        return (B @ u[:, :, None])[:, :, 0]

    def layers(self) -> dict[str, Layers]:
        """Return the networks for the model file."""
        return {name: getattr(self, name).layers() for name in self.features}

    def scaled(self, factor: float) -> 'LieGroupNetwork':
        """Return M, V, D and B times a factor, which leaves motions unchanged."""
        other = deepcopy(self)
        with torch.no_grad():
            other.scale.mul_(factor**-0.5)
            other.potential.output_scale.mul_(factor)
            for name, share in (('dissipation', factor**0.5), ('input_map', factor)):
                if name in other.features:
                    getattr(other, name).output_scale.mul_(share)
        other.card = other.card.model_copy(update={'mass_scale': other.scale.tolist()})
        return other


class HeldBody:
    """
    A body at a constant pose and input.

    Parameters
    ----------
    network : LieGroupNetwork
        The network of the body.
    x, R, u : torch.Tensor, shapes (N, k - 3), (N, 3, 3), (N, m)
        Position, attitude and input of the body.

    """

    def __init__(self, network: LieGroupNetwork, x: torch.Tensor, R: torch.Tensor,
                 u: torch.Tensor):
        self._network, self._x, self._R = network, x, R
        self._z = torch.cat([x, R.reshape(-1, 9)], dim=1)
        self._y, self._L = network.roots('mass', self._z)
        S, k = network.scale, network.k
        gram = self._L @ self._L.transpose(1, 2)
        floor = network.card.floor * torch.eye(k, dtype=gram.dtype)
        self.inverse = S[:, None] * (gram + floor) * S
        self._u = u
        self._known: tuple[torch.Tensor, torch.Tensor | None, torch.Tensor | None] | None = None

    def in_space(self, body: torch.Tensor) -> torch.Tensor:
        """Rotate the first three components of vectors, shape (N, k), from the body to space."""
        if not self._x.shape[1]:
            return body
        return torch.cat([(self._R @ body[:, :3, None])[:, :, 0], body[:, 3:]], dim=1)

    def _in_body(self, space: torch.Tensor) -> torch.Tensor:
        if not self._x.shape[1]:
            return space
        first = (self._R.transpose(1, 2) @ space[:, :3, None])[:, :, 0]
        return torch.cat([first, space[:, 3:]], dim=1)

    def velocity(self, p: torch.Tensor) -> torch.Tensor:
        """Return H_p, shape (N, k)."""
        return self.in_space(self.of_body(p))

    def of_body(self, p: torch.Tensor) -> torch.Tensor:
        """Return the velocities in the body frame at momenta p, shape (N, k) each."""
        return self.body_rates(self._in_body(p))[0]

    def body_rates(self, pi: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Return body velocities and, if H is one network, its derivative by the pose."""
        v = (pi[:, None, :] @ self.inverse)[:, 0]
        if 'momentum' not in self._network.card.potential_depends_on:
            return v, None
        z = torch.cat([self._z, pi], dim=1)
        c = self._network.slope('potential', z, z.new_ones((len(z), 1)))
        return v + c[:, self._z.shape[1]:], c[:, :self._z.shape[1]]

    def rates(self, p: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return H_p, and g^* H_g minus all forces, shape (N, k) each."""
        network, pi = self._network, self._in_body(p)
        v, c = self.body_rates(pi)
        own, B_u, D = self._at_pose()
        c = own if c is None else c
        if network.features['mass']:
            u = network.scale * pi
            w = (u[:, None, :] @ self._L)[:, 0]
            a = u[:, network.rows] * w[:, network.entry_columns]
            if network.card.diagonal == 'softplus':
                a = torch.where(network.on_diagonal, a * torch.sigmoid(self._y), a)
            c = c + network.slope('mass', self._z, a)
        slope = self._trivialised(c, pi, v)
        force = B_u
        if D is not None:
            drag = -(v[:, None, :] @ D)[:, 0]
            force = drag if force is None else force + drag
        if force is not None:
            slope = slope - self.in_space(force)
        return self.in_space(v), slope

    def _at_pose(self) -> tuple[torch.Tensor, torch.Tensor | None, torch.Tensor | None]:
        """Return the cached V slope, input force and D, which do not depend on the momentum."""
        if self._known is None:
            network, z = self._network, self._z
            structured = 'momentum' not in network.card.potential_depends_on
            own = network.slope('potential', z, z.new_ones((len(z), 1))) if structured else z
            D = None
            if 'dissipation' in network.features:
                root = network.roots('dissipation', z)[1]
                D = root @ root.transpose(1, 2)
            self._known = own, network.inputs(self._x, self._R, self._u), D
        return self._known

    def _trivialised(self, c: torch.Tensor, pi: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Return g^* of a derivative by (x, R) plus the derivative of (R^T p) . v by R."""
        places = self._x.shape[1]
        A = self._R.transpose(1, 2) @ c[:, places:].reshape(-1, 3, 3)
        turn = torch.stack([A[:, 2, 1] - A[:, 1, 2], A[:, 0, 2] - A[:, 2, 0],
                            A[:, 1, 0] - A[:, 0, 1]], dim=1)
        if not places:
            return turn
        return torch.cat([c[:, :3], turn + torch.linalg.cross(v[:, :3], pi[:, :3])], dim=1)
