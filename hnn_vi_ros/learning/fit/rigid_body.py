# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the parameters of a rigid body with friction to measured motions by least squares.

Linear regression of the forces initialises the fit, but noise of the accelerations biases it.
Nonlinear least squares on simulated windows follow. If velocities were measured, windows start
from smoothed states; with positions alone, the initial states are unknowns as well (see shooting),
because noise that is differentiated looks like friction. ``records`` fits whole motions instead.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
import math
from typing import Any

from hnn_vi_ros.effects import Effect, ExternalForce, has_map, LearnedFriction
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.learning.data.motions import cutoff_of, EvenMotion, part_of, smoothed
from hnn_vi_ros.learning.families.choices import Structure, TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.input_courses import input_courses, InputCourses
from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.fit.machine import (
    acceleration_errors, Samples, samples_of, scales_of, window_errors, windows_of)
from hnn_vi_ros.learning.fit.noise import covariances, Process
from hnn_vi_ros.learning.fit.shooting import (
    cost_at_start, fit_numbers, Fitted, projected, refitted, units_of)
from hnn_vi_ros.learning.fit.steps import Solutions
from hnn_vi_ros.learning.fit.windows import (
    CannotFollow, constant_forces, FOREVER, KnownModel, ModelParts, Number)
from hnn_vi_ros.models import (
    chain_angles, Checkpoint, CoordinateCard, FittedNumber, force_unit, is_spring, MechanicalCard,
    ModelCard, PLANAR_CHAIN, prior_kernel)
from hnn_vi_ros.phase_space import Coordinate
import numpy as np
from scipy.optimize import least_squares, lsq_linear, OptimizeResult
import torch

# Number of evenly spread samples and windows; more change the result by less than its error.
_SAMPLES, _WINDOWS = 4000, 500
# Maximum number of evaluations per fit; it usually ends earlier.
_EVALUATIONS = 60
# Cut-offs of the coarser states of further regressions, relative to the automatic one.
_COARSE = 0.3, 0.1
# Ridge penalty of the regression, relative to the column norms.
_RIDGE = 1e-6
# Smallest inertia and friction, relative to the usual ones, and smallest initial distance from it.
LEAST, ABOVE = 1e-7, 1e-3
# Plain friction, without the terms of drives.
_PLAIN = {'stribeck': 0, 'directed': False, 'offset': False, 'fade': False, 'load': False}
# Finite-difference step for whole motions, far above the rounding error.
_DIFFERENCE = 1e-5
# Bounds of the Stribeck speed: this share of the usual speed, and one minus this share.
_SHARE = 0.01
# Maximum number of windows that start within the length of one.
_OVERLAP = 20
# Relative tolerance of the fit to positions: errors of the numbers are far larger.
_TOLERANCE = 1e-5
# Method of the windows of positions, so accurate that the parameters are those of the machine.
_METHOD = 'gauss4'
# Half-width of 95 % intervals in standard deviations, and singular values of normalised columns
# below which a direction, such as the scale of the energy, is open.
_QUANTILE, _OPEN = 1.96, 1e-12


class RigidProblem(TrainingProblem):
    """
    A fitted rigid body, of which nothing is left to train.

    Parameters
    ----------
    network : MechanicalNetwork
        The rigid body.
    losses : mapping of str to float
        Losses of its fits; of positions the residuals in units of the noise.
    fitted : Fitted or None
        The fit to positions, None if velocities were measured.

    """

    def __init__(self, network: MechanicalNetwork, losses: Mapping[str, float],
                 fitted: Fitted | None = None):
        super().__init__(network, losses=losses)
        self.fitted, self.noise = fitted, None if fitted is None else fitted.noise

    def known(self) -> KnownModel:
        """Return a rigid body that was fitted to positions as a model without free numbers."""
        assert self.fitted is not None
        model = self.fitted.problem.model
        return KnownModel(model.name, model.parts_at(self.fitted.solution.values))

    def courses(self, motions: Sequence[EvenMotion], loss: TrajectoryLoss, stated: bool
                ) -> InputCourses:
        """Return how well other courses of the forces fit, of a fit to positions."""
        assert self.fitted is not None
        return input_courses(
            self.fitted.solution, self.fitted.problem, motions[0].inputs, stated,
            lambda other: thinned([replace(motion, inputs=other) for motion in motions],
                                  loss.step_size)[0])

    def estimates(self, coordinates: Sequence[CoordinateCard], q: np.ndarray | None
                  ) -> dict[str, FittedNumber]:
        """
        Return the numbers of a rigid body that was fitted to positions, with 95 % intervals.

        Parameters
        ----------
        coordinates : sequence of CoordinateCard
            Names and units of the coordinates.
        q : np.ndarray, shape (N, d), or None
            Coordinates whose mean first inertia is 1, if no forces fix the scale of the energy.

        """
        assert self.fitted is not None
        solution, model = self.fitted.solution, self.fitted.problem.model
        assert isinstance(model, RigidModel)
        values, covariance = solution.values, covariance_of(self.fitted)
        labels = model.unknowns.labels(coordinates)
        own = [labels[int(number.name)] for number in model.numbers]
        if q is not None:
            # Numbers x / (w . x): the common factor, which is open, does not change them.
            inertia = model.unknowns.mean_inertia(q)
            w = np.array([inertia[int(number.name)] for number in model.numbers])
            values = values / (w @ values)
            slopes = (np.eye(len(w)) - np.outer(values, w)) / (w @ solution.values)
            covariance = slopes @ covariance @ slopes.T
        motors = [k for k, (name, _) in enumerate(own) if name.startswith('input map')]
        if motors:
            # The norm of the map is open too; that of MechanicalNetwork.input_map is taken.
            values, size = values.copy(), float(np.linalg.norm(values[motors]))
            unit_map = values[motors] / size
            norm = math.sqrt(model.unknowns.network.raw_map.shape[1])
            slopes = np.eye(len(values))
            slopes[np.ix_(motors, motors)] = norm / size * (
                np.eye(len(motors)) - np.outer(unit_map, unit_map))
            values[motors], covariance = norm * unit_map, slopes @ covariance @ slopes.T
        half = _QUANTILE * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {name: FittedNumber(value=x, unit=unit, interval=[x - e, x + e])
                for (name, unit), x, e in zip(own, values.tolist(), half.tolist(), strict=True)}


def positions_alone(motions: Sequence[EvenMotion]) -> bool:
    """Return True unless velocities were measured in all motions."""
    return any(motion.v is None for motion in motions)


def fit_rigid_body(networks: Sequence[MechanicalNetwork], loss: TrajectoryLoss,
                   motions: Sequence[EvenMotion]) -> RigidProblem | None:
    """
    Fit prior and friction of the best of some networks; the friction widths stay fixed.

    Parameters
    ----------
    networks : sequence of MechanicalNetwork
        Networks with a prior and without residual networks; the best one is changed in place.
    loss : Trajectory
        Windows to simulate. Without ``records``, those of positions alone have initial states as
        unknowns and grow up to whole motions, as long as the residuals do not.
    motions : sequence of EvenMotion
        Training motions.

    Returns
    -------
    RigidProblem or None
        None if none of them follows the motions.

    """
    if positions_alone(motions) and not loss.records:
        try:
            return _fit_positions(networks, loss, motions)
        except CannotFollow:
            return None
    found = [(fit_smoothed(network, loss, motions), network) for network in networks]
    usable = [(losses, network) for losses, network in found
              if np.isfinite([*losses.values()]).all()]
    if not usable:
        return None
    losses, network = min(usable, key=lambda one: _last(one[0]))
    return RigidProblem(network, losses)


def _fit_positions(networks: Sequence[MechanicalNetwork], loss: TrajectoryLoss,
                   motions: Sequence[EvenMotion]) -> RigidProblem:
    """Fit the best of some networks in windows whose initial states are unknowns."""
    motions = [replace(motion, v=None) for motion in motions]
    cutoff, models = cutoff_of(motions, motions[0].spacing), []
    # Coarser states have less noise: derivatives of noise look like friction.
    samples = [samples_of(states, None) for states in (motions, *(
        [smoothed(motion.name, motion.t, motion.q, motion.v, motion.tau, share * cutoff)
         for motion in motions] for share in _COARSE))]
    thin, driven = thinned(motions, loss.step_size)[0], any(
        motion.tau.any() for motion in motions)
    for network in networks:
        physical = _Physical(network)
        models.append(min((
            RigidModel(physical, _first(physical, states)[0], thin[0].spacing, driven)
            for states in samples), key=lambda model: cost_at_start(model, thin)))
    fitted = _without_idle_numbers(fit_numbers(
        models, thin, None, True, tolerance=_TOLERANCE))
    model = fitted.problem.model
    assert isinstance(model, RigidModel)
    model.give(fitted.solution.values)
    return RigidProblem(model.unknowns.network, {
        f'rigid_body_{length:.3g}': misfit for length, misfit in fitted.stages}, fitted)


def covariance_of(fitted: Fitted) -> np.ndarray:
    """
    Return the covariance of fitted numbers, shape (n, n).

    It is that of the noise of the sensors, or of residuals where errors of the model exceed it.
    """
    solution, excess = fitted.solution, max(1.0, fitted.stages[-1][1])
    weights = fitted.problem.weights(solution.residuals)
    units = units_of(solution)
    slopes = projected(solution, weights)[0] / units
    matrix = slopes.reshape(-1, len(units))
    inverse = np.linalg.pinv(matrix.T @ matrix, rcond=_OPEN, hermitian=True)
    found = covariances(slopes @ inverse, sensors_of(fitted))[0]
    # For the robust loss psi = w r has slope w^3.
    bend = float((weights[solution.windows.there]**3).mean())
    return (excess / bend)**2 * found / np.outer(units, units)


def sensors_of(fitted: Fitted) -> list[list[Process]]:
    """Return the noise of the sensors in units of that of the fit."""
    return [[one._replace(variance=one.variance / scale**2)]
            for one, scale in zip(fitted.sensor, fitted.solution.noise, strict=True)]


def _without_idle_numbers(fitted: Fitted) -> Fitted:
    """
    Return the fit without the friction and the springs that the data do not show.

    Each number removed lowers the Bayesian information criterion, chi^2 + n log(N), at the
    linearised optimum of the others; chi^2 takes the noise as correlated as its sensor shows it.
    """
    solution, model = fitted.solution, fitted.problem.model
    assert isinstance(model, RigidModel)
    weights = fitted.problem.weights(solution.residuals)
    units = units_of(solution)
    slopes = np.sqrt(weights)[..., None] * projected(solution, weights)[0] / units
    n = len(units)
    _, R = np.linalg.qr(slopes.reshape(-1, n))
    C = np.linalg.pinv(R.T @ R, hermitian=True) / np.outer(units, units)
    B = np.outer(units, units) * covariances(slopes, sensors_of(fitted))[0]
    x, price, idle = solution.values.copy(), math.log(solution.freedom), list[int]()
    low = np.array([number.low for number in model.numbers])
    least = np.maximum(low, 0.0)
    while left := [k for k in model.optional if k not in idle and C[k, k] > 0.0]:
        spread = np.einsum('ki,ij,kj->k', C, B, C)
        above = np.where(np.isfinite(low), np.maximum(x - least, 0.0), x)
        k = min(left, key=lambda k: above[k]**2 / spread[k])
        if above[k]**2 > price * spread[k]:
            break
        x -= C[:, k] / C[k, k] * (x[k] - least[k])
        C -= np.outer(C[:, k], C[:, k]) / C[k, k]
        idle.append(k)
    if not idle:
        return fitted
    kept = np.delete(np.arange(n), idle)
    return refitted(fitted, model.without(idle), np.maximum(x, low)[kept], _TOLERANCE)


def fit_smoothed(network: MechanicalNetwork, loss: TrajectoryLoss, motions: Sequence[EvenMotion]
                 ) -> dict[str, float]:
    """
    Fit a network in windows that start from smoothed states; the friction widths stay fixed.

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a prior and without residual networks; changed in place.
    loss : Trajectory
        Windows to simulate.
    motions : sequence of EvenMotion
        Training motions.

    Returns
    -------
    dict
        Loss after each fit, inf if windows diverge at its initial values.

    """
    samples, physical = samples_of(motions, loss.step_size), _Physical(network)
    found, first = _first(physical, samples)
    found, losses = _in_windows(physical, found, loss, samples)
    choice = network.friction.choice
    simple = choice.model_copy(update=_PLAIN)
    if simple != choice:
        plain = _Physical(MechanicalNetwork(replace(network.structure, friction=simple), [1],
                                            network.scales, 0))
        numbers, least = _in_windows(plain, _first(plain, samples)[0], loss, samples)
        # More friction contains less, so an end above it is a local minimum.
        if _last(least) < _last(losses):
            found, losses = _in_windows(
                physical, _with_more_friction(physical, plain, numbers), loss, samples)
    physical.give(found)
    return {'rigid_body_forward': first} | losses


def _in_windows(physical: '_Physical', found: np.ndarray, loss: TrajectoryLoss, samples: Samples
                ) -> tuple[np.ndarray, dict[str, float]]:
    """Fit numbers to the windows of each stage; return them and the losses."""
    losses = {}
    for name, _, errors in window_fits(physical.network, loss, samples, _WINDOWS):
        found, losses[name] = _least_squares(physical, found, errors)
    return found, losses


def _with_more_friction(physical: '_Physical', plain: '_Physical', numbers: np.ndarray
                        ) -> np.ndarray:
    """Return the numbers of plain friction in a model with more: both sides alike, the rest 0."""
    d, sides = physical.network.d, 1 + physical.network.friction.choice.directed
    known, found = (np.split(x, np.cumsum(one.sizes)[:-1]) for x, one in (
        (numbers, plain), (physical.now(), physical)))
    force = np.repeat(known[2].reshape(-1, d), sides, axis=0).ravel()
    added = len(found[2]) - len(force)
    return np.concatenate([known[0], np.tile(known[1], sides), force, np.zeros(added),
                           0.0 * found[3], known[4], 0.0 * found[5], found[6]])


def _last(losses: Mapping[str, float]) -> float:
    return [*losses.values()][-1]


def fit_records(network: MechanicalNetwork, loss: TrajectoryLoss, motions: Sequence[EvenMotion],
                simulate: Callable[[EvenMotion], np.ndarray]) -> float:
    """
    Fit prior and friction of a network to the positions of whole motions (output error).

    Parameters
    ----------
    network : MechanicalNetwork
        Network with a prior and without residual networks; changed in place only if it improves.
    loss : Trajectory
        Source of the step size to which motions are downsampled; forces are averaged.
    motions : sequence of EvenMotion
        Training motions.
    simulate : callable
        ``simulate(motion)`` returns positions, shape (N, d), of the current network, from
        the first smoothed state of a motion.

    Returns
    -------
    float
        Root mean square error, in units of the standard deviation of each coordinate.

    """
    physical, (records, size) = _Physical(network), thinned(motions, loss.step_size)
    scale = physical.scale

    def errors(x: np.ndarray) -> np.ndarray:
        physical.give((x - 1.0) * scale)
        return np.concatenate([(simulate(motion) - motion.q) / size for motion in records]).ravel()
    # All numbers are shifted by one, so that difference steps have similar sizes.
    least, most, start = (1.0 + part for part in (
        physical.least, physical.most, physical.now() / scale))
    fit = least_squares(errors, np.maximum(start, least + ABOVE), diff_step=_DIFFERENCE,
                        bounds=(least, most), x_scale='jac', max_nfev=_EVALUATIONS // 2)
    return float(np.sqrt(np.mean(errors(fit.x)**2)))


def thinned(motions: Sequence[EvenMotion], step_size: float | None
            ) -> tuple[list[EvenMotion], np.ndarray]:
    """Downsample motions to this step, with held forces; return them and std(q), shape (d,)."""
    every, found = samples_of(motions, step_size).every, []
    for motion in motions:
        coarse, h = part_of(motion, slice(None, None, every)), every * motion.spacing
        found.append(replace(coarse, inputs='held', tau=constant_forces(
            motion, h * np.arange(len(coarse.t) + 1), h, rates=False)))
    return found, np.concatenate([motion.q for motion in motions]).std(axis=0)


def best_rigid_body(loss: TrajectoryLoss, motions: Sequence[EvenMotion],
                    structure: Structure | None = None, learns_map: bool = False
                    ) -> RigidProblem | None:
    """
    Return a fitted chain with one link per coordinate.

    Parameters
    ----------
    loss : Trajectory
        Windows to simulate; see fit_rigid_body.
    motions : sequence of EvenMotion
        Training motions.
    structure : Structure, optional
        Joints and friction, and the angles of the links; without angles, the best ones are found.
        Default: continuous joints with viscous friction and two Coulomb terms.
    learns_map : bool
        True to fit an input map too.

    Returns
    -------
    RigidProblem or None
        None if no chain has that many links, if none follows the motions, or if the forces do not
        act on the joints.

    """
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    known = structure or Structure(['revolute'] * d, [], [])
    if motors != d and not learns_map:
        return None
    scales = scales_of(motions, learns_map)
    networks = [MechanicalNetwork(replace(
        known, features=known.features or np.eye(d).tolist(), mass_features=[],
        prior=PLANAR_CHAIN, angles=angles, left_out=(), residual=False, friction_features=None),
        [1], scales, 0) for angles in (
            chain_angles(known.kinds, known.features) if known.angles is None else [known.angles])]
    return fit_rigid_body(networks, loss, motions) if networks else None


def window_fits(network: MechanicalNetwork, loss: TrajectoryLoss, samples: Samples, most: int
                ) -> Iterator[tuple[str, torch.Tensor, Callable[[Solutions], torch.Tensor]]]:
    """Yield the name of each stage, the starts of about `most` windows, and their errors."""
    for stage in loss.windows:
        windows, starts = windows_of(loss, stage, samples)
        # Windows nearly as long as their motion are nearly identical.
        length = windows.steps * samples.every
        chosen = spread(starts, min(most, 1 + _OVERLAP * len(starts) // length))
        yield f'rigid_body_{stage.duration:g}', chosen, partial(
            window_errors, network, samples, chosen, windows)


def spread(rows: torch.Tensor, most: int) -> torch.Tensor:
    """Return about `most` rows or fewer, evenly spread."""
    return rows[:: max(1, len(rows) // most)]


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
    unknowns : RigidUnknowns
        The k parameters, and the network that they belong to.
    start : np.ndarray, shape (k,)
        Their initial values in SI units.
    step_size : float
        Step size [s].
    driven : bool
        True if forces were measured.

    """

    name = 'the rigid body'

    def __init__(self, unknowns: 'RigidUnknowns', start: np.ndarray, step_size: float,
                 driven: bool):
        self.unknowns, self._h, self._driven = unknowns, step_size, driven
        # A number that starts at its bound could stay there.
        least, most = unknowns.least * unknowns.scale, unknowns.most * unknowns.scale
        room = ABOVE * unknowns.scale
        start = np.minimum(np.maximum(start, least + room), most - room)
        self.numbers = [Number(str(k), '', '', *map(float, one)) for k, one in enumerate(zip(
            start, least, most, unknowns.scale, strict=True))]
        # Parameters that are left out stay at these values.
        self._base = np.zeros(len(start))

    @property
    def optional(self) -> list[int]:
        """Return the numbers of springs, friction and offsets, without which it is a body too."""
        first, last = self.unknowns.sizes[0], sum(self.unknowns.sizes[:4])
        springs = self.unknowns.springs
        return [k for k, number in enumerate(self.numbers) if int(number.name) in springs
                or first <= int(number.name) < last]

    def without(self, idle: Sequence[int]) -> 'RigidModel':
        """Return the model with some numbers fixed at their least value, or 0."""
        other = copy(self)
        other._base = self._base.copy()
        for k in idle:
            other._base[int(self.numbers[k].name)] = max(self.numbers[k].low, 0.0)
        other.numbers = [number for k, number in enumerate(self.numbers) if k not in idle]
        return other

    def give(self, values: np.ndarray) -> None:
        """Set the network's parameters from values of the numbers."""
        parameters = self._base.copy()
        parameters[[int(number.name) for number in self.numbers]] = values
        self.unknowns.give(parameters)

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts at values of the numbers; see ParametricModel."""
        self.give(values)
        network = self.unknowns.network
        if not all(bool(part.isfinite().all()) for part in network.parameters()):
            raise ModelError('the mass matrix is not positive definite')
        return parts_of_card(network.card(), self._h, self._driven)


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

    Attributes
    ----------
    sizes : list of int
        Counts of numbers: prior, viscous friction, other friction, offsets, input map, fades, and
        Stribeck speeds.
    scale, least, most : np.ndarray, shape (k,)
        Sizes and bounds of all numbers. The gradient of friction vanishes below its lower bound.

    """

    # True if fades and Stribeck speeds, in which forces are nonlinear, are unknowns too.
    everything = True

    def __init__(self, network: MechanicalNetwork, scale: np.ndarray, least: np.ndarray):
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
                 (np.tile(speed, len(friction.raw_speed) * self.everything), _SHARE, 1.0 - _SHARE)]
        self.sizes = [len(scale) for scale, _, _ in parts]
        self.scale, self.least, self.most = (
            np.concatenate([np.broadcast_to(part, len(own[0])) for own, part in zip(
                parts, column, strict=True)]) for column in zip(*parts, strict=True))

    @property
    def springs(self) -> list[int]:
        """Return the indices of the numbers of springs."""
        return []

    @abstractmethod
    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the parameters of the prior, keyed by name in the network."""

    def raw(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the network's parameters from all numbers, given in SI units."""
        network, friction, d = self.network, self.network.friction, self.network.d
        prior, *others = values.split(self.sizes)
        raw: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
            'friction.raw_viscous': lambda x: _inverse_softplus(
                x.reshape(-1, d) / friction.viscous_unit),
            'friction.raw_force': lambda x: _inverse_softplus(
                x.reshape(-1, d) / friction.force_unit),
            'friction.raw_offset': lambda x: x.reshape(-1, d) / friction.force_unit,
            'raw_map': lambda x: x.reshape(d, -1),
            'raw_fade': lambda x: _inverse_softplus(x * network.command_unit),
            'friction.raw_speed': lambda x: torch.logit(x.reshape(-1, d) / friction.speed_unit)}
        return self.raw_prior(prior) | {
            name: raw[name](part) for name, part in zip(raw, others, strict=True) if len(part)}

    def labels(self, coordinates: Sequence[CoordinateCard]) -> list[tuple[str, str]]:
        """Return name and unit of each number."""
        prior = self.network.prior
        assert prior is not None
        forces = [force_unit(one.p_unit) for one in coordinates]
        speeds = [f'{one.q_unit}/s' for one in coordinates]
        found = [(name, one.unit) for name, one in prior.quantities(
            coordinates[0].p_unit).items()]
        for kind, count, units in zip(
                ('viscous friction', 'dry friction', 'offset', 'input map', 'fade',
                 'Stribeck speed'), self.sizes[1:], (
                     [f'{force} / ({speed})' for force, speed in zip(forces, speeds, strict=True)],
                     forces, forces, ['1'], ['1'], speeds), strict=True):
            for k in range(count):
                of = f' of {coordinates[k].name}' if count == len(coordinates) else f' {k + 1}'
                found.append((kind + of, units[k % len(units)]))
        return found

    def mean_inertia(self, q: np.ndarray) -> np.ndarray:
        """Return the mean first inertia at coordinates (N, d) per unit of each number."""
        prior, found = self.network.prior, np.zeros(sum(self.sizes))
        assert prior is not None and prior.linear
        found[:self.sizes[0]] = [float(prior.mass(torch.tensor(q), unit)[:, 0, 0].mean())
                                 for unit in torch.eye(self.sizes[0], dtype=torch.float64)]
        return found

    def give(self, values: np.ndarray) -> None:
        """Set the network's parameters from numbers in SI units."""
        with torch.no_grad():
            for name, parameter in self.raw(torch.tensor(values)).items():
                self.network.get_parameter(name).copy_(parameter)


class _Physical(RigidUnknowns):
    """The physical parameters of a prior as unknowns."""

    def __init__(self, network: MechanicalNetwork):
        assert network.prior is not None
        self.prior = network.prior
        free = [self.prior.linear and 'inertia' not in name for name in self.prior.names]
        # Inertias are positive.
        super().__init__(network, self.prior.scale().numpy(), np.where(free, -np.inf, 0.0))

    @property
    def springs(self) -> list[int]:
        """Return the indices of the numbers of springs, as in RigidUnknowns."""
        return [k for k, name in enumerate(self.prior.names) if is_spring(name)]

    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the raw parameters of the prior, as in RigidUnknowns."""
        return {'prior.raw': self.prior.raw_of(values)}

    def now(self) -> np.ndarray:
        """Return the current numbers of the network, in SI units."""
        network = self.network
        parts = [self.prior.values(), network.friction.values()]
        if self.sizes[4]:
            parts.append(network.raw_map.flatten())
        if self.sizes[5]:
            parts.append(network.fade())
        parts.append(network.friction.coefficients()[3].flatten())
        return torch.cat(parts).detach().numpy()


def _inverse_softplus(x: torch.Tensor) -> torch.Tensor:
    """Return log(exp(x) - 1), for x clamped to LEAST or more."""
    x = torch.clamp(x, min=LEAST)
    # exp(x) overflows for large x.
    return x + torch.log(-torch.expm1(-x))


def _first(physical: _Physical, samples: Samples) -> tuple[np.ndarray, float]:
    """Return the parameters that best explain the accelerations, and the loss."""
    # For rigid links, the forces are linear in the parameters.
    found = _regression(physical, samples) if physical.prior.linear else physical.now()
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    return _least_squares(physical, found, lambda _: acceleration_errors(
        physical.network, samples, rows))


def _regression(physical: _Physical, samples: Samples) -> np.ndarray:
    """Return the parameters that best explain the forces, with the current input map."""
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    q, v, a, tau = (part[rows] for part in (samples.q, samples.v, samples.a, samples.tau))
    with torch.no_grad():
        tau = physical.network.joint_forces(tau)
    # Scale each joint by its usual force.
    scales = physical.network.scales
    unit = torch.tensor(scales.inertia * scales.a)
    matrix = (physical.network.columns(q, v, a, tau) / unit[:, None]).flatten(0, 1).numpy()
    right = (tau / unit).flatten().numpy()
    # The ridge splits the force between equal columns, such as a carriage's weight and its motor's
    # offset; otherwise they could cancel with huge coefficients.
    matrix = np.vstack([matrix, _RIDGE * np.diag(np.linalg.norm(matrix, axis=0))])
    right = np.append(right, np.zeros(matrix.shape[1]))
    least = (physical.least * physical.scale)[:matrix.shape[1]]
    if right.any():
        found = lsq_linear(matrix, right, (least, np.inf)).x
    else:
        # Without forces, parameters are known up to a common factor: set the first inertia to one.
        found = np.append(1.0, lsq_linear(
            matrix[:, 1:], -matrix[:, 0], (least[1:], np.inf)).x)
    n = physical.sizes[0]
    values = physical.prior.possible(torch.tensor(found[:n])).numpy()
    end = n + sum(physical.sizes[1:4])
    return np.concatenate([values, found[n:], physical.now()[end:]])


def _least_squares(physical: _Physical, start: np.ndarray,
                   errors: Callable[[Solutions], torch.Tensor]) -> tuple[np.ndarray, float]:
    """Return the parameters of the smallest soft loss, and that loss."""
    scale = torch.tensor(physical.scale)
    found = fit_errors(physical.network, lambda x: physical.raw(x * scale),
                       start / physical.scale, physical.least, errors, physical.most)
    return (start if found is None else found.x * physical.scale), loss_of(found)


def loss_of(found: OptimizeResult | None) -> float:
    """Return the loss after a fit, inf if its initial values were invalid."""
    # The cost is half a sum; the losses of networks are means of the same terms.
    return np.inf if found is None else 2.0 * float(found.cost) / len(found.fun)


def fit_errors(network: MechanicalNetwork,
               raw: Callable[[torch.Tensor], dict[str, torch.Tensor]], start: np.ndarray,
               least: np.ndarray, errors: Callable[[Solutions], torch.Tensor],
               most: np.ndarray | float = np.inf) -> OptimizeResult | None:
    """
    Minimise the soft loss of errors over parameters.

    Parameters
    ----------
    network : MechanicalNetwork
        Network that the errors depend on.
    raw : callable
        ``raw(x)`` returns the network's parameters by name.
    start, least : np.ndarray, shape (k,)
        Initial values, and lower bounds. Values on a bound are moved above it: a step ends where
        it meets a bound, and one such number would block all others.
    errors : callable
        Errors of the network, a function of the solver that caches its steps.
    most : np.ndarray, shape (k,), optional
        Upper bounds.

    Returns
    -------
    OptimizeResult or None
        Result of scipy.optimize.least_squares; None if the initial errors are not finite.

    """
    module = _Errors(network, errors)

    def residuals(x: torch.Tensor, solutions: Solutions) -> torch.Tensor:
        parts = {f'network.{name}': part for name, part in raw(x).items()}
        return torch.func.functional_call(module, parts, (solutions,)).reshape(-1)

    def values(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            # Errors are inf if M is not positive definite, or a window diverges.
            return np.nan_to_num(residuals(torch.tensor(x), Solutions()).numpy(), nan=np.inf)

    def jacobian(x: np.ndarray) -> np.ndarray:
        at, solutions = torch.tensor(x), Solutions()
        with torch.no_grad():
            residuals(at, solutions)
            return torch.func.jacfwd(
                lambda x: residuals(x, solutions.again()))(at).numpy()
    start = np.maximum(start, least + ABOVE)
    if not np.isfinite(values(start)).all():
        return None
    return least_squares(values, start, jacobian, (least, most), loss='soft_l1', x_scale='jac',
                         ftol=1e-5, max_nfev=_EVALUATIONS)


class _Errors(torch.nn.Module):
    """Error function as a module, whose parameters can be replaced."""

    def __init__(self, network: MechanicalNetwork, errors: Callable[[Solutions], torch.Tensor]):
        super().__init__()
        self.network, self.errors = network, errors

    def forward(self, solutions: Solutions) -> torch.Tensor:
        """Return the errors."""
        return self.errors(solutions)
