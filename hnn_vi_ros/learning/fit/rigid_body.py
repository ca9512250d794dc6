# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the parameters of a rigid body with friction to measured motions by least squares.

Linear regression of the forces initialises the fit, but noise of the accelerations biases it.
Nonlinear least squares on simulated windows (trust-region Levenberg-Marquardt) follow.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from hnn_vi_ros.learning.data.motions import EvenMotion, part_of
from hnn_vi_ros.learning.families.choices import Structure, Trajectory
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.machine import (
    acceleration_errors, mean_forces, Samples, samples_of, scales_of, window_errors, windows_of)
from hnn_vi_ros.learning.fit.steps import Solutions
from hnn_vi_ros.models import chain_angles, PLANAR_CHAIN
import numpy as np
from scipy.optimize import least_squares, lsq_linear, OptimizeResult
import torch

# Number of evenly spread samples and windows; more change the result by less than its error.
_SAMPLES, _WINDOWS = 4000, 500
# Maximum number of evaluations per fit; it usually ends earlier.
_EVALUATIONS = 60
# Ridge penalty of the regression, relative to the column norms.
_RIDGE = 1e-6
# Smallest initial inertia and friction, relative to the usual ones.
LEAST = 1e-4
# Finite-difference step for whole motions, far above the rounding error.
_DIFFERENCE = 1e-5
# Bounds of the Stribeck speed: this share of the usual speed, and one minus this share.
_SHARE = 0.01
# Maximum number of windows that start within the length of one.
_OVERLAP = 20
# Smallest initial distance from a lower bound, in the same units.
_ABOVE = 10.0 * LEAST


def fit_rigid_body(network: MechanicalNetwork, loss: Trajectory, motions: Sequence[EvenMotion]
                   ) -> dict[str, float]:
    """
    Fit prior and friction of a network; the friction widths stay fixed.

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
    samples = samples_of(motions, loss.step_size)
    physical = _Physical(network)
    # For rigid links, the forces are linear in the parameters.
    found = _regression(physical, samples) if physical.prior.linear else physical.now()
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    losses = {}
    found, losses['rigid_body_forward'] = _least_squares(
        physical, found, lambda _: acceleration_errors(network, samples, rows))
    for name, _, errors in window_fits(network, loss, samples, _WINDOWS):
        found, losses[name] = _least_squares(physical, found, errors)
    physical.give(found)
    return losses


def fit_records(network: MechanicalNetwork, loss: Trajectory, motions: Sequence[EvenMotion],
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
    fit = least_squares(errors, np.maximum(start, least + _ABOVE), diff_step=_DIFFERENCE,
                        bounds=(least, most), x_scale='jac', max_nfev=_EVALUATIONS // 2)
    return float(np.sqrt(np.mean(errors(fit.x)**2)))


def thinned(motions: Sequence[EvenMotion], step_size: float | None
            ) -> tuple[list[EvenMotion], np.ndarray]:
    """Downsample motions to this step, with held forces; return them and std(q), shape (d,)."""
    every = samples_of(motions, step_size).every
    return [replace(part_of(motion, slice(None, None, every)), held=True,
                    tau=mean_forces(motion, every)[::every]) for motion in motions
            ], np.concatenate([motion.q for motion in motions]).std(axis=0)


def best_rigid_body(loss: Trajectory, motions: Sequence[EvenMotion],
                    structure: Structure | None = None, learns_map: bool = False
                    ) -> tuple[MechanicalNetwork, dict[str, float]] | None:
    """
    Return a chain with one link per coordinate, and its losses after each fit.

    Parameters
    ----------
    loss : Trajectory
        Windows to simulate.
    motions : sequence of EvenMotion
        Training motions.
    structure : Structure, optional
        Joints and friction, and the angles of the links; without angles, the best ones are found.
        Default: continuous joints with viscous friction and two Coulomb terms.
    learns_map : bool
        True to fit an input map too.

    Returns
    -------
    tuple or None
        None if no chain has that many links, if all diverge in the last windows, or if the forces
        do not act on the joints.

    """
    d, motors = motions[0].q.shape[1], motions[0].tau.shape[1]
    known = structure or Structure(['revolute'] * d, [], [])
    if motors != d and not learns_map:
        return None
    scales = scales_of(motions, learns_map)
    fitted: list[tuple[float, int, MechanicalNetwork, dict[str, float]]] = []
    for angles in chain_angles(known.kinds, known.features) \
            if known.angles is None else [known.angles]:
        network = MechanicalNetwork(replace(
            known, features=known.features or np.eye(d).tolist(), mass_features=[],
            prior=PLANAR_CHAIN, angles=angles, left_out=(), residual=False,
            friction_features=None), [1], scales, 0)
        losses = fit_rigid_body(network, loss, motions)
        if np.isfinite([*losses.values()]).all():
            fitted.append(([*losses.values()][-1], len(fitted), network, losses))
    return min(fitted)[2:] if fitted else None


def window_fits(network: MechanicalNetwork, loss: Trajectory, samples: Samples, most: int
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
        free = [name.startswith(('coupling', 'gravity')) for name in self.prior.names]
        # Inertias are positive.
        super().__init__(network, self.prior.scale().numpy(), np.where(free, -np.inf, 0.0))

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
    # Regression may find no friction where windows do: start above the lower bound.
    friction = np.maximum(found[n:], 10.0 * physical.least[n:end] * physical.scale[n:end])
    return np.concatenate([values, friction, physical.now()[end:]])


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
    start = np.maximum(start, least + _ABOVE)
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
