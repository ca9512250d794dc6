# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit the parameters of a rigid body with friction to measured motions, by least squares.

The forces are linear in the parameters, and so the fit begins with them; but noise of the
accelerations biases this estimate. Windows that are simulated end the fit, by the trust-region
form of the Levenberg-Marquardt method.
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

# Evenly spread samples and windows; more change the parameters by less than their errors.
_SAMPLES, _WINDOWS = 4000, 500
# Evaluations of each fit at most; it usually ends earlier.
_EVALUATIONS = 60
# Weight of the size of numbers in a regression, in units of their columns.
_RIDGE = 1e-6
# Least inertia and friction that a fit begins with, in units of the usual ones.
LEAST = 1e-4
# Differences of numbers by which whole motions are differentiated, far above their rounding.
_DIFFERENCE = 1e-5
# Stribeck friction ends between this share of the usual speed and the rest of it.
_SHARE = 0.01
# Windows begin at most so many times in the time that one lasts.
_OVERLAP = 20
# How far above its bound a number begins, in the same units.
_ABOVE = 10.0 * LEAST


def fit_rigid_body(network: MechanicalNetwork, loss: Trajectory, motions: Sequence[EvenMotion]
                   ) -> dict[str, float]:
    """
    Fit prior and friction of a network, whose widths of friction stay what they are.

    Parameters
    ----------
    network : MechanicalNetwork
        With a prior and without networks; changed in place.
    loss : Trajectory
        Its windows are simulated.
    motions : sequence of EvenMotion
        What to learn from.

    Returns
    -------
    dict
        The loss after each fit, infinite where one had no place to begin: windows were thrown far.

    """
    samples = samples_of(motions, loss.step_size)
    physical = _Physical(network)
    # The forces are linear in the parameters of rigid links.
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
        With a prior and without networks; changed in place, never for the worse.
    loss : Trajectory
        Its step size, by which motions are thinned out, forces averaged.
    motions : sequence of EvenMotion
        What to learn from.
    simulate : callable
        ``simulate(motion)`` returns the positions, shape (N, d), of the network as it is, from
        the first smoothed state of a motion.

    Returns
    -------
    float
        The root mean square error, in units of the spread of each coordinate.

    """
    physical, (records, size) = _Physical(network), thinned(motions, loss.step_size)
    scale = physical.scale

    def errors(x: np.ndarray) -> np.ndarray:
        physical.give((x - 1.0) * scale)
        return np.concatenate([(simulate(motion) - motion.q) / size for motion in records]).ravel()
    # All numbers are one more than they are, so that differences are of one size.
    least, most, start = (1.0 + part for part in (
        physical.least, physical.most, physical.now() / scale))
    fit = least_squares(errors, np.maximum(start, least + _ABOVE), diff_step=_DIFFERENCE,
                        bounds=(least, most), x_scale='jac', max_nfev=_EVALUATIONS // 2)
    return float(np.sqrt(np.mean(errors(fit.x)**2)))


def thinned(motions: Sequence[EvenMotion], step_size: float | None
            ) -> tuple[list[EvenMotion], np.ndarray]:
    """Return motions by steps of this size, of held forces, and the spread of q, shape (d,)."""
    every = samples_of(motions, step_size).every
    return [replace(part_of(motion, slice(None, None, every)), held=True,
                    tau=mean_forces(motion, every)[::every]) for motion in motions
            ], np.concatenate([motion.q for motion in motions]).std(axis=0)


def best_rigid_body(loss: Trajectory, motions: Sequence[EvenMotion],
                    structure: Structure | None = None, learns_map: bool = False
                    ) -> tuple[MechanicalNetwork, dict[str, float]] | None:
    """
    Return a chain of as many links as there are coordinates, and its losses after each fit.

    Parameters
    ----------
    loss : Trajectory
        Its windows are simulated.
    motions : sequence of EvenMotion
        What to learn from.
    structure : Structure, optional
        Joints and friction. The links have its angles, or those that fit best if it names none.
        Default: joints that turn, with viscous friction and two Coulomb terms.
    learns_map : bool
        Whether an input map is fitted as well.

    Returns
    -------
    tuple or None
        None if no chain has so many links, if none follows the motions through the last windows,
        or if the forces are not those on the joints.

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
    """Yield the name of each stage, at most about so many starts of windows, and their errors."""
    for stage in loss.windows:
        windows, starts = windows_of(loss, stage, samples)
        # Windows that are nearly as long as their motion are nearly the same.
        length = windows.steps * samples.every
        chosen = spread(starts, min(most, 1 + _OVERLAP * len(starts) // length))
        yield f'rigid_body_{stage.duration:g}', chosen, partial(
            window_errors, network, samples, chosen, windows)


def spread(rows: torch.Tensor, most: int) -> torch.Tensor:
    """Return at most about so many rows, evenly spread."""
    return rows[:: max(1, len(rows) // most)]


class RigidUnknowns(ABC):
    """
    Numbers that give the parameters of a prior, of friction and of motors, in that order.

    Parameters
    ----------
    network : MechanicalNetwork
        A network with a prior.
    scale, least : np.ndarray, shape (n,)
        Usual sizes of the numbers of the prior, and their lower bounds in units of these.

    Attributes
    ----------
    sizes : list of int
        How many there are of the prior, of viscous and of other friction, of offsets, of the
        input map, of fades, and of the speeds of Stribeck friction.
    scale, least, most : np.ndarray, shape (k,)
        The same of all numbers, and upper bounds. Friction has no slope below its least.

    """

    # Whether numbers by which forces are not linear are among them: fades and those speeds.
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
        """Return the parameters of the prior, by their names in the network."""

    def raw(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the parameters of the network, of all numbers in SI units."""
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
        """Give the network these numbers, in SI units."""
        with torch.no_grad():
            for name, parameter in self.raw(torch.tensor(values)).items():
                self.network.get_parameter(name).copy_(parameter)


class _Physical(RigidUnknowns):
    """The parameters of a prior themselves."""

    def __init__(self, network: MechanicalNetwork):
        assert network.prior is not None
        self.prior = network.prior
        free = [name.startswith(('coupling', 'gravity')) for name in self.prior.names]
        # Inertia is positive.
        super().__init__(network, self.prior.scale().numpy(), np.where(free, -np.inf, 0.0))

    def raw_prior(self, values: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the raw parameters; see RigidUnknowns."""
        return {'prior.raw': self.prior.raw_of(values)}

    def now(self) -> np.ndarray:
        """Return the numbers that the network has, in SI units."""
        network = self.network
        parts = [self.prior.values(), network.friction.values()]
        if self.sizes[4]:
            parts.append(network.raw_map.flatten())
        if self.sizes[5]:
            parts.append(network.fade())
        parts.append(network.friction.coefficients()[3].flatten())
        return torch.cat(parts).detach().numpy()


def _inverse_softplus(x: torch.Tensor) -> torch.Tensor:
    """Return log(exp(x) - 1), of LEAST at the least."""
    x = torch.clamp(x, min=LEAST)
    # exp(x) of a large x is infinite.
    return x + torch.log(-torch.expm1(-x))


def _regression(physical: _Physical, samples: Samples) -> np.ndarray:
    """Return the parameters that explain the forces best, by the input map that there is."""
    rows = spread(torch.arange(len(samples.q)), _SAMPLES)
    q, v, a, tau = (part[rows] for part in (samples.q, samples.v, samples.a, samples.tau))
    with torch.no_grad():
        tau = physical.network.joint_forces(tau)
    # Each joint in units of its own force.
    scales = physical.network.scales
    unit = torch.tensor(scales.inertia * scales.a)
    matrix = (physical.network.columns(q, v, a, tau) / unit[:, None]).flatten(0, 1).numpy()
    right = (tau / unit).flatten().numpy()
    # Columns that are the same, such as the weight of a carriage and the offset of its motor,
    # share their force, instead of cancelling one another in enormous numbers.
    matrix = np.vstack([matrix, _RIDGE * np.diag(np.linalg.norm(matrix, axis=0))])
    right = np.append(right, np.zeros(matrix.shape[1]))
    least = (physical.least * physical.scale)[:matrix.shape[1]]
    if right.any():
        found = lsq_linear(matrix, right, (least, np.inf)).x
    else:
        # Without forces all is known up to a common factor: the first inertia is one.
        found = np.append(1.0, lsq_linear(
            matrix[:, 1:], -matrix[:, 0], (least[1:], np.inf)).x)
    n = physical.sizes[0]
    values = physical.prior.possible(torch.tensor(found[:n])).numpy()
    end = n + sum(physical.sizes[1:4])
    # Accelerations may show no friction, where windows do: it begins above its least.
    friction = np.maximum(found[n:], 10.0 * physical.least[n:end] * physical.scale[n:end])
    return np.concatenate([values, friction, physical.now()[end:]])


def _least_squares(physical: _Physical, start: np.ndarray,
                   errors: Callable[[Solutions], torch.Tensor]) -> tuple[np.ndarray, float]:
    """Return the parameters of the least soft size of errors, and that size."""
    scale = torch.tensor(physical.scale)
    found = fit_errors(physical.network, lambda x: physical.raw(x * scale),
                       start / physical.scale, physical.least, errors, physical.most)
    return (start if found is None else found.x * physical.scale), loss_of(found)


def loss_of(found: OptimizeResult | None) -> float:
    """Return the loss after a fit, infinite where it had no place to begin."""
    # The cost is half a sum; the losses of networks are means of the same terms.
    return np.inf if found is None else 2.0 * float(found.cost) / len(found.fun)


def fit_errors(network: MechanicalNetwork,
               raw: Callable[[torch.Tensor], dict[str, torch.Tensor]], start: np.ndarray,
               least: np.ndarray, errors: Callable[[Solutions], torch.Tensor],
               most: np.ndarray | float = np.inf) -> OptimizeResult | None:
    """
    Fit numbers by the soft size of errors.

    Parameters
    ----------
    network : MechanicalNetwork
        Whose errors they are.
    raw : callable
        ``raw(x)`` returns parameters of the network by name.
    start, least : np.ndarray, shape (k,)
        Numbers to begin with, and their lower bounds. What rests on its bound begins above it: a
        step ends where it meets a bound, so that one number there would hold all the others.
    errors : callable
        Errors of the network; takes the solver of its steps, which keeps solutions.
    most : np.ndarray, shape (k,), optional
        Upper bounds.

    Returns
    -------
    OptimizeResult or None
        What scipy.optimize.least_squares returns; None where errors are infinite to begin with.

    """
    module = _Errors(network, errors)

    def residuals(x: torch.Tensor, solutions: Solutions) -> torch.Tensor:
        parts = {f'network.{name}': part for name, part in raw(x).items()}
        return torch.func.functional_call(module, parts, (solutions,)).reshape(-1)

    def values(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            # Infinite where M would not be positive, and where a window is thrown far.
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
    """Errors of a network, as a module whose parameters can be replaced."""

    def __init__(self, network: MechanicalNetwork, errors: Callable[[Solutions], torch.Tensor]):
        super().__init__()
        self.network, self.errors = network, errors

    def forward(self, solutions: Solutions) -> torch.Tensor:
        """Return them."""
        return self.errors(solutions)
