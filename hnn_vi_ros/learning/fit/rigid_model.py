# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid body with friction and motors as a model with free numbers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from functools import cached_property
from typing import Any

from hnn_vi_ros.effects import Effect, ExternalForce, has_map, LearnedFriction
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.learning.families.joint_friction import NARROWEST, WIDEST
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.windows import FOREVER, ModelParts, Number
from hnn_vi_ros.models import (
    Checkpoint, CoordinateCard, force_unit, is_spring, MechanicalCard, ModelCard, OFFSET,
    prior_kernel)
from hnn_vi_ros.phase_space import Coordinate
import numpy as np
import torch

# Smallest inertia and friction, relative to the usual ones, and smallest initial distance from it.
LEAST, ABOVE = 1e-7, 1e-3
# Width of friction that the data do not tell, relative to the usual speed.
_SHARP = 0.02
# Bounds of the Stribeck speed: this share of the usual speed, and one minus this share.
_SHARE = 0.01
# Method of the windows of positions, so accurate that the parameters describe the machine.
_METHOD = 'gauss4'


class _PriorHamiltonian(Hamiltonian):
    """H of a prior alone."""

    def __init__(self, card: MechanicalCard):
        self._card = card
        self.coordinates = tuple(Coordinate(f'q{i}') for i in range(len(card.kinds)))

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        assert self._card.prior is not None
        return prior_kernel(self._card.prior, self._card.angles)


class RigidModel:
    """
    A rigid body with friction and motors whose parameters are free; see ParametricModel.

    Parameters
    ----------
    unknowns : PriorUnknowns
        The k parameters, and the network that they belong to.
    start : np.ndarray, shape (k,)
        Their initial values in SI units.
    step_size : float
        Step size [s].
    driven : bool
        True if forces were measured.

    """

    name = 'the rigid body'

    def __init__(self, unknowns: 'PriorUnknowns', start: np.ndarray, step_size: float,
                 driven: bool):
        self.unknowns, self.step_size, self._driven = unknowns, step_size, driven
        # A number that starts at its bound could stay there.
        least, most = unknowns.least * unknowns.scale, unknowns.most * unknowns.scale
        room = ABOVE * unknowns.scale
        start = np.minimum(np.maximum(start, least + room), most - room)
        self.numbers = [Number(str(k), '', '', x, low, high, size, True)
                        for k, (x, low, high, size) in enumerate(zip(*(
                            part.tolist() for part in (start, least, most, unknowns.scale)),
                            strict=True))]
        self._own = deepcopy(unknowns.network)
        # Parameters that are left out stay at these values.
        self._base = np.zeros(len(start))

    @property
    def optional(self) -> list[int]:
        """Return the numbers of spare terms, friction and offsets, which a body may lack."""
        first, last = self.unknowns.sizes[0], sum(self.unknowns.sizes[:4])
        spare = self.unknowns.spare
        return [k for k, number in enumerate(self.numbers) if int(number.name) in spare
                or first <= int(number.name) < last]

    @property
    def motors(self) -> list[int]:
        """Return the numbers of the input map."""
        first, last = sum(self.unknowns.sizes[:4]), sum(self.unknowns.sizes[:5])
        return [k for k, number in enumerate(self.numbers) if first <= int(number.name) < last]

    def without(self, idle: Sequence[int]) -> 'RigidModel':
        """Return the model with some numbers fixed at their least value or 0; widths are usual."""
        other = copy(self)
        other._base = self._base.copy()
        first = sum(self.unknowns.sizes[:7])
        for k in idle:
            place = int(self.numbers[k].name)
            other._base[place] = max(self.numbers[k].low, 0.0) if place < first else \
                _SHARP * self.unknowns.scale[place]
        other.numbers = [number for k, number in enumerate(self.numbers) if k not in idle]
        return other

    def useless_widths(self, idle: Sequence[int]) -> list[int]:
        """Return the numbers of widths of friction that would be without force."""
        sizes, friction = self.unknowns.sizes, self.unknowns.network.friction
        d = self.unknowns.network.d
        acts, first = np.zeros(sum(sizes), bool), sum(sizes[:2])
        acts[[int(number.name) for k, number in enumerate(self.numbers) if k not in idle]] = True
        forces = acts[first:first + sizes[2]].reshape(-1, d)
        n, sides = friction.choice.coulomb, 1 + friction.choice.directed
        used = np.concatenate([forces[:sides * n].reshape(n, sides, d).any(axis=1),
                               forces[sides * n:]]).ravel()
        first = sum(sizes[:7])
        return [k for k, number in enumerate(self.numbers)
                if int(number.name) >= first and not used[int(number.name) - first]]

    def at_step(self, step_size: float) -> 'RigidModel':
        """Return the model with another step size [s]."""
        other = copy(self)
        other.step_size = step_size
        return other

    def network_at(self, values: np.ndarray) -> MechanicalNetwork:
        """Return the network at values of the numbers."""
        return self.unknowns.network_at(self._parameters(values))

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts at values of the numbers; see ParametricModel."""
        raw = self.unknowns.raw(torch.tensor(self._parameters(values)))
        if not all(bool(part.isfinite().all()) for part in raw.values()):
            raise ModelError('the mass matrix is not positive definite')
        # Copies of a network take longer than a simulation.
        return parts_of_card(self._own.take_parameters(raw).card(), self.step_size, self._driven)

    def _parameters(self, values: np.ndarray) -> np.ndarray:
        """Return all parameters at values of the numbers."""
        parameters = self._base.copy()
        parameters[[int(number.name) for number in self.numbers]] = values
        return parameters


def parts_of_card(card: MechanicalCard, step_size: float, driven: bool) -> ModelParts:
    """Return the parts of a rigid body without networks; see RigidModel."""
    fields: dict[str, Any] = {'mechanical': card, 'lie_group': None, 'family': 'mechanical'}
    checkpoint = Checkpoint(ModelCard.model_construct(**fields), {})
    hamiltonian = _PriorHamiltonian(card)
    effects: list[Effect] = [LearnedFriction.of(checkpoint)]
    if driven:
        effects.insert(0, ExternalForce.of(checkpoint, FOREVER) if has_map(checkpoint) else
                       ExternalForce([one.name for one in hamiltonian.coordinates], FOREVER))
    return ModelParts(hamiltonian, INTEGRATORS[_METHOD](), effects, step_size)


class RigidUnknowns(ABC):
    """
    Unknown parameters of a prior, of friction and of motors, in that order.

    Parameters
    ----------
    network : MechanicalNetwork
        A network with a prior.
    scale, least : np.ndarray, shape (n,)
        Usual sizes of the prior's numbers, and their lower bounds in units of these.
    widths : bool
        True if the widths of friction are unknowns too.

    Attributes
    ----------
    sizes : list of int
        Counts of numbers: prior, viscous friction, other friction, offsets, input map, fades,
        Stribeck speeds, and widths of friction.
    scale, least, most : np.ndarray, shape (k,)
        Sizes and bounds of all numbers. The gradient of friction vanishes below its lower bound.

    """

    # True if fades and Stribeck speeds, in which forces are nonlinear, are unknowns too.
    everything = True

    def __init__(self, network: MechanicalNetwork, scale: np.ndarray, least: np.ndarray,
                 widths: bool = False):
        friction, self.network = network.friction, network
        sides, offsets = (len(friction.raw_viscous) * friction.choice.viscous,
                          friction.raw_offset.numel())
        motors = network.raw_map.numel() if network.scales.input_map is not None else 0
        fades = network.scales.command[:None if friction.choice.fade and self.everything else 0]
        viscous, force, speed = (unit.numpy() for unit in (
            friction.viscous_unit, friction.force_unit, friction.speed_unit))
        parts = [(scale, least, np.inf), (np.tile(viscous, sides), LEAST, np.inf),
                 (np.tile(force, len(friction.raw_force)), LEAST, np.inf),
                 (force[:offsets], -np.inf, np.inf), (np.ones(motors), -np.inf, np.inf),
                 (1.0 / fades, LEAST, np.inf),
                 (np.tile(speed, len(friction.raw_speed) * self.everything), _SHARE, 1.0 - _SHARE),
                 (np.tile(speed, len(friction.raw_width) * widths), NARROWEST, WIDEST)]
        self.sizes = [len(scale) for scale, _, _ in parts]
        self.scale, self.least, self.most = (
            np.concatenate([np.broadcast_to(part, len(own[0])) for own, part in zip(
                parts, column, strict=True)]) for column in zip(*parts, strict=True))

    @abstractmethod
    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the parameters of the prior, keyed by name in the network."""

    def raw(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the network's parameters from all numbers, given in SI units."""
        network, friction, d = self.network, self.network.friction, self.network.d
        prior, *others = values.split(self.sizes)
        raw: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
            'friction.raw_viscous': lambda x: inverse_softplus(
                x.reshape(-1, d) / friction.viscous_unit),
            'friction.raw_force': lambda x: inverse_softplus(
                x.reshape(-1, d) / friction.force_unit),
            'friction.raw_offset': lambda x: x.reshape(-1, d) / friction.force_unit,
            'raw_map': lambda x: x.reshape(d, -1),
            'raw_fade': lambda x: inverse_softplus(x * network.command_unit),
            'friction.raw_speed': lambda x: torch.logit(x.reshape(-1, d) / friction.speed_unit),
            'friction.raw_width': lambda x: friction.raw_of_widths(x.reshape(-1, d))}
        return self.raw_prior(prior) | {
            name: raw[name](part) for name, part in zip(raw, others, strict=True) if len(part)}

    def network_at(self, values: np.ndarray) -> MechanicalNetwork:
        """Return the network with given numbers in SI units."""
        with torch.no_grad():
            return deepcopy(self.network).take_parameters(self.raw(torch.tensor(values)))


class PriorUnknowns(RigidUnknowns):
    """The physical parameters of a prior as unknowns."""

    def __init__(self, network: MechanicalNetwork, widths: bool = False):
        assert network.prior is not None
        self.prior = network.prior
        free = [self.prior.linear and 'inertia' not in name for name in self.prior.names]
        # Inertias are positive.
        super().__init__(network, self.prior.scale().numpy(), np.where(free, -np.inf, 0.0), widths)

    @property
    def spare(self) -> list[int]:
        """Return the indices of weights, springs, rotors and offsets."""
        return [k for k, name in enumerate(self.prior.names) if self.prior.linear and (
            is_spring(name) or name.startswith(('gravity', 'motor_inertia', OFFSET)))]

    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the raw parameters of the prior, as in RigidUnknowns."""
        return {'prior.raw': self.prior.raw_of(values)}

    def labels(self, coordinates: Sequence[CoordinateCard]) -> list[tuple[str, str]]:
        """Return name and unit of each number."""
        forces = [force_unit(one.p_unit) for one in coordinates]
        speeds = [f'{one.q_unit}/s' for one in coordinates]
        found = [(name, one.unit) for name, one in self.prior.quantities(
            [one.p_unit for one in coordinates]).items()]
        for kind, count, units in zip(
                ('viscous friction', 'dry friction', 'offset', 'input map', 'fade',
                 'Stribeck speed', 'width of dry friction'), self.sizes[1:], (
                     [f'{force} / ({speed})' for force, speed in zip(forces, speeds, strict=True)],
                     forces, forces, ['1'], ['1'], speeds, speeds), strict=True):
            for k in range(count):
                of = f' of {coordinates[k].name}' if count == len(coordinates) else f' {k + 1}'
                found.append((kind + of, units[k % len(units)]))
        return found

    @property
    def scaled(self) -> np.ndarray:
        """Return the mask (k,) of numbers that grow with the scale of the energy."""
        return np.concatenate([
            [not name.startswith(OFFSET) for name in self.prior.names],
            np.repeat(np.arange(1, len(self.sizes)) < 5, self.sizes[1:])])

    def mean_inertia(self, q: np.ndarray) -> np.ndarray:
        """Return the mean first inertia at coordinates (N, d) per unit of each number."""
        found = np.zeros(sum(self.sizes))
        found[:self.sizes[0]] = [float(self.prior.mass(torch.tensor(q), unit)[:, 0, 0].mean())
                                 for unit in torch.eye(self.sizes[0], dtype=torch.float64)]
        return found

    def now(self) -> np.ndarray:
        """Return the current numbers of the network, in SI units."""
        network = self.network
        parts = [self.prior.values(), network.friction.values()]
        if self.sizes[4]:
            parts.append(network.raw_map.flatten())
        if self.sizes[5]:
            parts.append(network.fade())
        _, _, widths, speeds, _ = network.friction.coefficients()
        parts += [speeds.flatten(), widths.flatten()[:self.sizes[7]]]
        return torch.cat(parts).detach().numpy()


def inverse_softplus(x: torch.Tensor) -> torch.Tensor:
    """Return log(exp(x) - 1), for x clamped to LEAST or more."""
    x = torch.clamp(x, min=LEAST)
    # exp(x) overflows for large x.
    return x + torch.log(-torch.expm1(-x))
