# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Networks of machines, trained on (q, v, tau): mass and potential; and a plain one."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
import math
from typing import Any, NamedTuple

from hnn_vi_ros.learning.families.base import keep, Layer, Perceptron
from hnn_vi_ros.learning.families.choices import FeaturesChoice, MotionScales, Structure
from hnn_vi_ros.learning.families.joint_friction import JointFrictionModule
from hnn_vi_ros.learning.families.priors import ExactPrior, PlanarChain, RigidTree
from hnn_vi_ros.models import CHAINS, entries_of, Kind, Layers, MechanicalCard, PriorCard
import numpy as np
import torch


class Linearised(NamedTuple):
    """
    Result p = M(q) v and F = dp/dt - tau, with derivatives.

    Parameters
    ----------
    p, rate : torch.Tensor, shape (N, d)
        Values of p and F.
    p_v, p_q, rate_q, rate_v : torch.Tensor, shape (N, d, d)
        Derivatives M, p_q, F_q and F_v.

    """

    p: torch.Tensor
    rate: torch.Tensor
    p_v: torch.Tensor
    p_q: torch.Tensor
    rate_q: torch.Tensor
    rate_v: torch.Tensor


def _friction(friction: JointFrictionModule, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor
              ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return friction, (N, d), and its derivatives by q and v, (N, d, d) each."""
    if friction.structure.friction_features is not None:
        return _differentiated(lambda q, v: friction(q, v, tau), q, v)
    with torch.enable_grad():
        at = v.detach().requires_grad_()
        value = friction(q, at, tau)
        # A joint's friction depends on its own velocity only.
        (slope,) = torch.autograd.grad(value.sum(), at)
    found = torch.diag_embed(slope)
    return value.detach(), torch.zeros_like(found), found


def _differentiated(function: Callable[..., torch.Tensor], q: torch.Tensor, v: torch.Tensor
                    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return a function, (N, d), and its derivatives by q and v, from one backward pass."""
    with torch.enable_grad():
        at = q.detach().requires_grad_(), v.detach().requires_grad_()
        # Adding zero keeps the graph for systems whose rates are constant.
        value = function(*at) + torch.zeros_like(at[0]) * at[0]
        units = torch.eye(q.shape[1], dtype=q.dtype)[:, None, :].expand(-1, len(q), -1)
        rows = torch.autograd.grad(value, at, units, is_grads_batched=True, allow_unused=True)
    none = torch.zeros_like(units)
    by_q, by_v = ((none if part is None else part).transpose(0, 1) for part in rows)
    return value.detach(), by_q, by_v


def _of_networks(network: Any, q: torch.Tensor, v: torch.Tensor) -> Linearised:
    """
    Return p and F of the networks' M and V without friction.

    The kinetic energy T(q, v) = |L^T S v|^2 / 2 gives p = T_v and F = T_q - V_q, so F_v is the
    transpose of p_q.

    With a = tanh(z) in each layer, the second derivatives of a network f(x) by the features i and
    j of its inputs x are f_ij = sum over the layers of f_a tanh''(z) z_i z_j + f_x x_ij. One
    forward pass yields the derivatives z_i, and one backward pass yields f_a.
    """
    S, on_diagonal = network.root_inertia, network.on_diagonal
    inputs, layers = _layers(network.mass, network.mass_features, q)
    y, y_rates = network.mass.outputs(layers)
    share = torch.sigmoid(y)
    rise = torch.where(on_diagonal, share, 1.0)
    L, u = network.matrix(network.positive(y)), (S * v)[:, :, None]
    w = L.transpose(1, 2) @ u
    # Derivatives of T by the entries of L.
    by_entries = (u * w.transpose(1, 2)).flatten(1) @ network.place.T
    T_f, T_ff = _curvature(network.mass, network.mass_features, inputs, layers, by_entries * rise)
    L_rates = ((rise * y_rates) @ network.place).unflatten(2, L.shape[1:])
    w_rates = L_rates.transpose(2, 3) @ u
    bend = torch.where(on_diagonal, share * (1.0 - share), 0.0) * by_entries
    T_ff = (T_ff + _products(bend * y_rates, y_rates)
            + _products(w_rates[..., 0], w_rates[..., 0]))
    G, at = network.mass_features.features, network.potential_features.features
    p_q = S[:, None] * ((L @ w_rates + L_rates @ w)[..., 0].permute(1, 2, 0) @ G)
    V_f, V_ff = _curvature(network.potential, network.potential_features, *_layers(
        network.potential, network.potential_features, q), torch.ones_like(q[:1, :1]))
    M = S[:, None] * (L @ L.transpose(1, 2) + network.floor * network.identity) * S
    return Linearised((M @ v[:, :, None])[:, :, 0], T_f @ G - V_f @ at, M, p_q,
                      G.T @ T_ff @ G - at.T @ V_ff @ at, p_q.transpose(1, 2))


def _layers(network: Perceptron, features: FeaturesChoice, q: torch.Tensor
            ) -> tuple[tuple[torch.Tensor, torch.Tensor], list[Layer]]:
    """Return the inputs with their derivatives by their rows, and the hidden layers."""
    inputs = features(q)
    return inputs, network.hidden(inputs[0], inputs[1] * features.of_feature[:, None, :])


def _curvature(network: Perceptron, features: FeaturesChoice,
               inputs: tuple[torch.Tensor, torch.Tensor], layers: list[Layer],
               weights: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the derivatives by features, (N, m) and (N, m, m), of weighted outputs (N, k)."""
    *hidden, last = network.linears
    back, curved = (weights * network.output_scale) @ last.weight, torch.zeros(())
    for linear, (a, slope, rates) in zip(hidden[::-1], layers[::-1], strict=True):
        back = slope * back
        curved = curved + _products(-2.0 * a * back * rates, rates)
        back = back @ linear.weight
    back, (x, slope) = back / network.scale, inputs
    own = features.of_feature.T.to(x.dtype)
    # The second derivative of a sine is the negative sine.
    return (back * slope) @ own, curved + torch.diag_embed(
        (torch.where(features.periodic, -x, 0.0) * back) @ own)


def _products(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return pairwise products, shape (N, m, m), of m vectors of shape (N, n) with m others."""
    return (a[:, None] * b).sum(dim=-1).permute(2, 0, 1)


class PlainNetwork(torch.nn.Module):
    """
    dv/dt = N(q, v, tau), a perceptron in float64: a neural ordinary differential equation.

    The inputs include the sine and cosine of continuous coordinates. It serves as a baseline.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of the coordinates.
    hidden : sequence of int
        Widths of the hidden layers.
    scales : MotionScales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    References
    ----------
    R. Chen, Y. Rubanova, J. Bettencourt, D. Duvenaud, Neural Ordinary Differential Equations,
    NeurIPS 2018.

    """

    has_masses = False

    def __init__(self, kinds: Sequence[Kind], hidden: Sequence[int], scales: MotionScales,
                 seed: int):
        super().__init__()
        self.scales = scales
        turns = np.array([kind == 'continuous' for kind in kinds])
        self._turning, self._others = np.flatnonzero(turns), np.flatnonzero(~turns)
        half = scales.q_half[~turns]
        centre = np.concatenate([np.zeros(2 * turns.sum()), scales.q_centre[~turns],
                                 np.zeros(len(kinds) + len(scales.command))])
        unit = np.concatenate([np.ones(2 * turns.sum()), np.where(half > 0.0, half, 1.0),
                               scales.v, scales.command])
        self.perceptron = Perceptron(hidden, centre, unit, scales.a, seed)

    def accelerations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return dv/dt, shape (N, d), at q and v of that shape and commands of shape (N, m)."""
        angles = q[:, self._turning]
        return self.perceptron(torch.cat([
            torch.sin(angles), torch.cos(angles), q[:, self._others], v, tau], dim=1))


_NETWORKS = ('mass', 'potential')
# Smallest eigenvalue of S^-1 M S^-1.
_FLOOR = 1e-3
# Initial scale of the network added to a prior's M, relative to the prior's inertias; share of
# these inertias, and of the forces they cause, that the fading penalty regards as large.
_ADDED, _LARGE = 0.1, 0.05

# Maps the flattened entries of a symmetric 2 x 2 matrix to the entries of its adjugate.
_ADJUGATE = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0],
                      [1.0, 0.0, 0.0, 0.0]])


class MechanicalNetwork(torch.nn.Module):
    """
    M(q) v' + (M v)' at constant v' - (v . M v)_q / 2 + V_q + friction = A tau, in float64.

    M = S (L L^T + floor) S, the networks ``mass`` (L) and ``potential`` (V), and ``friction`` are
    as in MechanicalHamiltonian and LearnedFriction; M and V of a prior are added.

    Parameters
    ----------
    structure : Structure
        Structure of the networks.
    hidden : sequence of int
        Widths of the hidden layers of each network.
    scales : MotionScales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    """

    has_masses = True

    def __init__(self, structure: Structure, hidden: Sequence[int], scales: MotionScales,
                 seed: int):
        super().__init__()
        d = len(structure.kinds)
        self.structure, self.scales, self.d = structure, scales, d
        self.friction = JointFrictionModule(structure, hidden, scales, seed + 2)
        if scales.input_map is not None:
            self.raw_map = torch.nn.Parameter(torch.tensor(scales.input_map))
        if structure.friction.fade:
            keep(self, command_unit=scales.command)
            self.raw_fade = torch.nn.Parameter(torch.full_like(self.command_unit, -3.0))
        # M of a prior is positive definite without the floor.
        self.floor = _FLOOR if structure.prior is None else 0.0
        self.prior = _prior(structure, float(scales.inertia.mean()))
        keep(self, identity=np.eye(d))
        rows, columns = np.array(entries_of(d, structure.diagonal_mass)).T
        keep(self, place=np.eye(d * d)[rows * d + columns], on_diagonal=rows == columns,
             adjugate=_ADJUGATE, root_inertia=np.sqrt(scales.inertia))
        self.mass_features = FeaturesChoice(structure.kinds, structure.mass_features)
        self.potential_features = FeaturesChoice(structure.kinds, structure.features)
        hidden = hidden if structure.residual else [1]
        mass_hidden = hidden if structure.mass_features else [1]
        # M is initially about S^2: log(1 + exp(0.54)) is 1.
        self.mass = Perceptron(
            mass_hidden, *self.mass_features.units(scales), np.ones(len(rows)), seed,
            0.54 * self.on_diagonal)
        energy = float(np.mean(scales.inertia * scales.a))
        self.potential = Perceptron(hidden, *self.potential_features.units(scales),
                                    np.array([energy]), seed + 1)
        self._leave_out_networks(structure.left_out if structure.residual else _NETWORKS)

    @classmethod
    def of_model(cls, card: MechanicalCard, networks: Mapping[str, torch.nn.Module]
                 ) -> 'MechanicalNetwork':
        """Return the networks of a model file as a machine, without prior and joint friction."""
        zero, one = np.zeros(len(card.kinds)), np.ones(len(card.kinds))
        own = cls(Structure(card.kinds, card.features, card.mass_features, card.diagonal_mass,
                            friction_features=card.friction_features), (),
                  MotionScales(zero, zero, one, one, np.square(card.mass_scale), one), 0)
        own.floor, own.mass, own.potential = card.floor, networks['mass'], networks['potential']
        if card.friction_features is not None:
            own.friction.network = networks['friction']
        return own

    def _leave_out_networks(self, names: Sequence[str]) -> None:
        with torch.no_grad():
            for name in names:
                network = self.get_submodule(name)
                network.linears[-1].weight.zero_()
                network.linears[-1].bias.zero_()
                network.requires_grad_(False)
            if 'mass' in names:
                # log(1 + exp(-80)) is below the rounding error of any other inertia.
                self.mass.linears[-1].bias.copy_(-80.0 * self.on_diagonal)

    def with_prior_of(self, rigid: 'MechanicalNetwork') -> 'MechanicalNetwork':
        """Return small networks on the prior and friction of a fitted rigid body, both frozen."""
        other = deepcopy(self)
        assert other.prior is not None and rigid.prior is not None
        with torch.no_grad():
            known = dict(rigid.named_parameters())
            for name, parameter in other.named_parameters():
                if name.startswith(('prior.', 'friction.raw_', 'raw_map', 'raw_fade')):
                    # Far from the data, where networks fade, the least-squares result remains.
                    parameter.copy_(known[name]).requires_grad_(False)
            states = other.random_states(256, torch.Generator().manual_seed(0))
            inertia = other.prior.mass(states, other.prior.values()).mean(dim=0)
            other.root_inertia.copy_((_ADDED * torch.diagonal(inertia)).sqrt())
            if 'mass' not in other.structure.left_out:
                other.mass.linears[-1].bias.copy_(-1.5 * other.on_diagonal)
            other.potential.linears[-1].weight.mul_(0.1)
        other.prior.identification = rigid.prior.identification
        return other

    def take_parameters(self, parameters: Mapping[str, torch.Tensor]) -> 'MechanicalNetwork':
        """Set values of some parameters, by name, and return this network."""
        with torch.no_grad():
            for name, values in parameters.items():
                self.get_parameter(name).copy_(values)
        return self

    def random_states(self, count: int, generator: torch.Generator, reach: float = 1.0
                      ) -> torch.Tensor:
        """Draw coordinates, (count, d): all turns, or `reach` times the range of the data."""
        turns = torch.tensor([kind == 'continuous' for kind in self.structure.kinds])
        centre, half = torch.tensor(self.scales.q_centre), torch.tensor(self.scales.q_half)
        share = 2.0 * torch.rand(count, self.d, generator=generator, dtype=torch.float64) - 1.0
        return torch.where(turns, math.pi * share, centre + reach * half * share)

    def residual_sizes(self, q: torch.Tensor) -> torch.Tensor:
        """Return the mean squared network parts of M, V_q and D, shape (N,), at q (N, d)."""
        L = self._factor(q)
        inertia = self.root_inertia.square() / _ADDED
        force = self._potential_slope(q)
        unit = _LARGE * inertia * torch.tensor(self.scales.a)
        size = ((_ADDED / _LARGE * (L @ L.transpose(1, 2))).square().mean(dim=(1, 2))
                + (force / unit).square().mean(dim=1))
        if self.structure.friction_features is None:
            return size
        B = self.friction.roots(q) / self.friction.viscous_unit.sqrt()[:, None]
        return size + (B @ B.transpose(1, 2) / _LARGE).square().mean(dim=(1, 2))

    def speed_sizes(self, q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Return the mean squared network forces that grow with v^2, shape (N,)."""
        L, slopes, u, w, inertial = self._kinetic(q, v)
        forces = self.root_inertia * self._turned(L, slopes, u, w, v) - inertial
        unit = _LARGE * self.root_inertia.square() / _ADDED * torch.tensor(self.scales.a)
        return (forces / unit).square().mean(dim=1)

    def positive(self, y: torch.Tensor) -> torch.Tensor:
        """Return the entries of L from network outputs: log(1 + exp(y)) on the diagonal."""
        # The default threshold of torch would cut off values below 2e-9.
        return torch.where(self.on_diagonal, torch.nn.functional.softplus(y, threshold=40.0), y)

    def _potential_slope(self, q: torch.Tensor) -> torch.Tensor:
        """Return the derivatives by q of the network's part of V, shape (N, d) each."""
        x, slope = self.potential_features(q)
        return (slope * self.potential.gradient(x)) @ self.potential_features.rows

    def lagrangian(self, q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Return v . M v / 2 - V without the prior, shape (N,)."""
        kinetic = 0.5 * (v * (self.masses(q) @ v[:, :, None])[:, :, 0]).sum(dim=1)
        return kinetic - self.potential(self.potential_features(q)[0])[:, 0]

    def masses(self, q: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        S = self.root_inertia
        return S[:, None] * self._gram(q, self._factor(q)) * S

    def _factor(self, q: torch.Tensor) -> torch.Tensor:
        """Return L, shape (N, d, d)."""
        return self.matrix(self.positive(self.mass(self.mass_features(q)[0])))

    def matrix(self, entries: torch.Tensor) -> torch.Tensor:
        """Return lower triangular matrices, shape (N, d, d), from entries (N, k)."""
        return (entries @ self.place).reshape(-1, self.d, self.d)

    def input_map(self) -> torch.Tensor | None:
        """
        Return A, shape (d, m), of the forces A u that m motors exert for commands u.

        The mean square of its columns is 1, because a common factor of A, M, V and friction does
        not change motions.
        """
        if self.scales.input_map is None:
            return None
        return self.raw_map * (math.sqrt(self.raw_map.shape[1]) / self.raw_map.norm())

    def fade(self) -> torch.Tensor:
        """Return g, shape (m,), of motors whose output is u / (1 + g abs(u)) for a command u."""
        return torch.nn.functional.softplus(self.raw_fade) / self.command_unit

    def joint_forces(self, tau: torch.Tensor) -> torch.Tensor:
        """Return the joint forces, shape (N, d), for commands of shape (N, m)."""
        input_map = self.input_map()
        if self.structure.friction.fade:
            tau = tau / (1.0 + self.fade() * tau.abs())
        return tau if input_map is None else tau @ input_map.T

    def accelerations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return dv/dt, shape (N, d), at q and v of that shape and commands of shape (N, m)."""
        tau = self.joint_forces(tau)
        if self.prior is not None and not self.structure.residual:
            values = self.prior.values()
            force = tau - self.prior.forces(q, v, values) - self.friction(q, v, tau)
            return self._solve(self.prior.mass(q, values), force)
        gram, needed = self._equations(q, v, tau)
        return self._solve(gram, tau / self.root_inertia - needed) / self.root_inertia

    def forces(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor,
               tau: torch.Tensor | None = None) -> torch.Tensor:
        """Return the forces that cause accelerations a, with friction at tau, (N, d) each."""
        gram, needed = self._equations(q, v, tau)
        S = self.root_inertia
        return S * (needed + (gram @ (S * a)[:, :, None])[:, :, 0])

    def added_forces(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor, tau: torch.Tensor
                     ) -> torch.Tensor:
        """Return the networks' part of `forces`, in addition to the prior, shape (N, d)."""
        assert self.prior is not None
        rubbing = self.friction.columns(v, tau) @ self.friction.values()
        needed = self.prior.needed(q, v, a, self.prior.values())
        return self.forces(q, v, a, tau) - needed - rubbing

    def columns(self, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor, tau: torch.Tensor
                ) -> torch.Tensor:
        """Return the forces per unit of each parameter of prior and friction, (N, d, k)."""
        assert self.prior is not None
        return torch.cat([self.prior.columns(q, v, a), self.friction.columns(v, tau)], dim=2)

    def momenta(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor | None = None
                ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return p = M v and dp/dt - tau (default 0), all of shape (N, d)."""
        p, rate = torch.zeros_like(v), -self.friction(q, v, tau)
        if self.prior is None or self.structure.residual:
            L, _, u, w, inertial = self._kinetic(q, v)
            p = self.root_inertia * (L @ w + self.floor * u)[:, :, 0]
            rate = rate + inertial - self._potential_slope(q)
        if self.prior is not None:
            values = self.prior.values()
            p = p + (self.prior.mass(q, values) @ v[:, :, None])[:, :, 0]
            rate = rate + self.prior.slopes(q, v, values)[1]
        return p, rate

    def linearised(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> Linearised:
        """Return the result of ``momenta`` with its derivatives, detached from autograd."""
        found, prior = [], self.prior
        with torch.no_grad():
            if prior is None or self.structure.residual:
                found.append(_of_networks(self, q, v))
            if prior is not None:
                values = prior.values()
                rate, rate_q, rate_v = _differentiated(
                    lambda q, v: prior.slopes(q, v, values)[1], q, v)
                M = prior.mass(q, values)
                # p = T_v and F = T_q - V_q follow from the same energy.
                found.append(Linearised((M @ v[:, :, None])[:, :, 0], rate, M,
                                        rate_v.transpose(1, 2), rate_q, rate_v))
            both = found[0] if len(found) == 1 else Linearised(*map(torch.add, *found))
            rubbing, by_q, by_v = _friction(self.friction, q, v, tau)
            return both._replace(rate=both.rate - rubbing, rate_q=both.rate_q - by_q,
                                 rate_v=both.rate_v - by_v)

    def velocities(self, q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        """Return M^-1 p, shape (N, d)."""
        if self.prior is not None and not self.structure.residual:
            return self._solve(self.prior.mass(q, self.prior.values()), p)
        S = self.root_inertia
        return self._solve(self._gram(q, self._factor(q)), p / S) / S

    def _equations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor | None
                   ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return S^-1 M S^-1, shape (N, d, d), and S^-1 tau at zero acceleration, (N, d)."""
        L, slopes, u, w, inertial = self._kinetic(q, v)
        rest = inertial - self._potential_slope(q) - self.friction(q, v, tau)
        needed, values = self._turned(L, slopes, u, w, v) - rest / self.root_inertia, None
        if self.prior is not None:
            values = self.prior.values()
            needed = needed + self.prior.forces(q, v, values) / self.root_inertia
        return self._gram(q, L, values), needed

    def _gram(self, q: torch.Tensor, L: torch.Tensor, values: torch.Tensor | None = None
              ) -> torch.Tensor:
        """Return S^-1 M S^-1, shape (N, d, d); `values` are known parameters of the prior."""
        S, gram = self.root_inertia, L @ L.transpose(1, 2) + self.floor * self.identity
        if self.prior is None:
            return gram
        values = self.prior.values() if values is None else values
        return gram + self.prior.mass(q, values) / (S[:, None] * S)

    def _turned(self, L: torch.Tensor, slopes: torch.Tensor, u: torch.Tensor, w: torch.Tensor,
                v: torch.Tensor) -> torch.Tensor:
        """Return S^-1 (M v)' at constant v for the networks' M, shape (N, d)."""
        by_time = ((v @ self.mass_features.features.T)[:, :, None] * slopes).sum(dim=1)
        L_dot = self.matrix(by_time)
        return (L_dot @ w + L @ (L_dot.transpose(1, 2) @ u))[:, :, 0]

    def _kinetic(self, q: torch.Tensor, v: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return L, its entries' slopes, S v, L^T S v and (v . M v)_q / 2 for the networks' M."""
        y, rates = self.mass.outputs(_layers(self.mass, self.mass_features, q)[1])
        rises = torch.where(self.on_diagonal, torch.sigmoid(y), 1.0)
        slopes = rises[:, None, :] * rates.transpose(0, 1)
        L, u = self.matrix(self.positive(y)), (self.root_inertia * v)[:, :, None]
        w = L.transpose(1, 2) @ u
        # Derivatives of |L^T S v|^2 / 2 by the entries of L, and then by q.
        by_entries = (u * w.transpose(1, 2)).flatten(1) @ self.place.T
        inertial = (slopes * by_entries[:, None, :]).sum(dim=2) @ self.mass_features.features
        return L, slopes, u, w, inertial

    def _solve(self, matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Solve positive definite systems (N, d, d) for (N, d), in closed form if small."""
        if self.d > 2:
            return torch.linalg.solve(matrix, right)
        if self.d == 1:
            return right / matrix[:, 0]
        entries = matrix.flatten(1)
        adjugate = entries @ self.adjugate
        # The sum of the products is twice the determinant.
        determinant = 0.5 * (entries * adjugate).sum(dim=1, keepdim=True)
        return (adjugate.view_as(matrix) @ right[:, :, None])[:, :, 0] / determinant

    def scaled(self, factor: float) -> 'MechanicalNetwork':
        """Return M, V and friction times a factor, which leaves motions without tau unchanged."""
        other = deepcopy(self)
        other.root_inertia *= math.sqrt(factor)
        for unit in (other.friction.viscous_unit, other.friction.force_unit):
            unit *= factor
        if other.structure.friction_features is not None:
            other.friction.network.output_scale *= math.sqrt(factor)
        other.potential.output_scale *= factor
        if isinstance(other.prior, PlanarChain):
            other.prior.unit *= factor
        return other

    @property
    def _perceptrons(self) -> dict[str, Perceptron]:
        own = {'mass': self.mass, 'potential': self.potential}
        return own if self.structure.friction_features is None else \
            own | {'friction': self.friction.network}

    def networks(self) -> dict[str, Layers]:
        """Return the networks for the model file, with V = 0 at the centre of the data."""
        centre = torch.tensor(self.scales.q_centre)[None]
        x0 = self.potential_features(centre)[0][0].numpy()
        return {name: network.layers(x0) if name == 'potential' else network.layers()
                for name, network in self._perceptrons.items()}

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the trained weights of the networks, named as in a simulation."""
        return {f'hamiltonian.{name}.linear{k}.{kind}': part
                for name, network in self._perceptrons.items()
                if any(one.requires_grad for one in network.parameters())
                for kind, parts in zip(('weight', 'bias'), network.folded(), strict=True)
                for k, part in enumerate(parts, 1)}

    def card(self, p_units: Sequence[str] | None = None) -> MechanicalCard:
        """Return the model card entry for momenta in these units, by default N m s."""
        structure, input_map = self.structure, self.input_map()
        if input_map is None and structure.friction.fade:
            input_map = self.identity
        motors = None if input_map is None else input_map.tolist()
        fade = self.fade().tolist() if structure.friction.fade else None
        return MechanicalCard(
            kinds=structure.kinds, features=structure.features, friction=self.friction.card(),
            floor=self.floor, mass_features=structure.mass_features,
            mass_scale=self.root_inertia.tolist(), diagonal_mass=structure.diagonal_mass,
            prior=self._prior_card(p_units or ['N m s'] * self.d),
            friction_features=structure.friction_features, input_map=motors, fade=fade)

    def _prior_card(self, p_units: Sequence[str]) -> PriorCard | None:
        structure = self.structure
        if self.prior is None or structure.prior is None:
            return None
        return PriorCard(
            kind=structure.prior, parameters=self.prior.quantities(p_units), tree=structure.tree,
            angles=structure.angles, identification=self.prior.identification,
            alone=not structure.residual)


def _prior(structure: Structure, inertia: float) -> PlanarChain | ExactPrior | RigidTree | None:
    if structure.prior is None:
        return None
    if structure.tree is not None and structure.values is not None:
        return RigidTree(structure.tree, structure.values)
    if structure.prior in CHAINS:
        assert structure.angles is not None, 'a chain has them'
        return PlanarChain(structure.angles, inertia, structure.springs,
                           structure.sensor_offsets, structure.spring_knots)
    return ExactPrior(structure.prior)
