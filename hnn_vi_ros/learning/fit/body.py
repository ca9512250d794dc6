# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit the network of a rotating body to windows of motions: steps, losses and stages."""

from collections.abc import Callable, Iterator, Sequence
import math
from typing import Any, cast, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.integrators import cayley, Coefficients
from hnn_vi_ros.learning.data.arrays import BodyMotions
from hnn_vi_ros.learning.families.base import newton
from hnn_vi_ros.learning.families.lie_group import (
    BodyScales, BodyStage, HeldBody, LieGroupNetwork, LieMethod, RetractionName)
from hnn_vi_ros.learning.families.priors import NumpyTensor
from hnn_vi_ros.learning.fit.config import BodyConfig
from hnn_vi_ros.learning.fit.loop import Fitted, Stage, Train, trained, TrainingProblem
import numpy as np
import torch

# Half-range assigned to quantities that vary only by rounding.
_LEAST = 1e-12
# Lower clamp of |x|^2 / 4 in the coefficients; harmless because |x|^2 multiplies them.
_LEAST_ANGLE = 1e-8
# Matrix of the linear map from x to its cross-product matrix, row by row.
_CROSS = torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
                       [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
                       [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=torch.float64)


class BodyState(NamedTuple):
    """Positions (N, k - 3), attitudes (N, 3, 3) and momenta (N, k) at one time."""

    x: torch.Tensor
    R: torch.Tensor
    p: torch.Tensor


def _cayley(y: torch.Tensor) -> Any:
    """Return the coefficients of the Cayley map."""
    return Coefficients(*(part.as_subclass(torch.Tensor) for part in cast(Any, cayley)(
        y.as_subclass(NumpyTensor))))


def _exponential(y: torch.Tensor) -> Any:
    """Return the coefficients of the exponential map, as in Coefficients."""
    y = y.clamp_min(_LEAST_ANGLE)
    half = y.sqrt()
    sine, cosine = half.sin() / half, half.cos()
    sines, cosines = (1.0 - sine) / y, (1.0 - cosine) / y
    bend = (cosines - sines) / (4.0 * sine)
    return Coefficients(0.5 * sine, cosine - 1.0, bend, bend, sine * cosine,
                        0.5 * sine.square(), 0.25 * (sines + sine * cosines))


# Coefficients for vectors of squared length 4 y, shape (N, 1).
RETRACTIONS: dict[RetractionName, Callable[[torch.Tensor], Any]] = {
    'cayley': _cayley, 'exponential': _exponential}


def turned(R: torch.Tensor, x: torch.Tensor, tau: Any) -> torch.Tensor:
    """Return R tau(x), shape (N, 3, 3), for the unit quaternion (vector x, 1 + less_one)."""
    cross = (x @ _CROSS).reshape(-1, 3, 3)
    turn, twist = 2.0 * tau.vector * (1.0 + tau.less_one), 2.0 * tau.vector.square()
    return R + R @ (turn[:, :, None] * cross + twist[:, :, None] * (cross @ cross))


def _bend(x: torch.Tensor, m: torch.Tensor, tau: Any, side: float) -> torch.Tensor:
    """Return (dtau^-1_(side x))^* m - m."""
    return (0.5 * side * torch.linalg.cross(x, m)
            + tau.along * (x * m).sum(dim=1, keepdim=True) * x
            - tau.squared * x.square().sum(dim=1, keepdim=True) * m)


class LieSteps:
    """
    Stepper of a body with a fixed step size.

    Parameters
    ----------
    body : LieGroupNetwork
        Network of the body.
    method, retraction : str
        Names as in a scene.
    step_size : float
        h [s].

    """

    def __init__(self, body: LieGroupNetwork, method: LieMethod, retraction: RetractionName,
                 step_size: float):
        self._body, self._h = body, step_size
        self._retraction = RETRACTIONS[retraction]
        self._step = {'lie_leapfrog': self._leapfrog,
                      'lie_variational_euler': self._variational_euler}[method]
        self._matrices: dict[str, torch.Tensor] = {}

    def __call__(self, node: BodyState, u: torch.Tensor) -> BodyState:
        """Return the node after one step with a held input, shape (N, m)."""
        return self._step(node, u)

    def _tau(self, x: torch.Tensor) -> Any:
        return self._retraction(0.25 * x.square().sum(dim=1, keepdim=True))

    def _solve(self, name: str, residual: Callable[[torch.Tensor], torch.Tensor],
               guess: torch.Tensor, unit: torch.Tensor) -> torch.Tensor:
        w, J = newton(residual, guess.detach(), self._matrices.get(name), unit, unit)
        self._matrices[name] = J.detach()
        return w - torch.linalg.solve_ex(J, residual(w)[:, :, None])[0][:, :, 0]

    def _inside(self, held: HeldBody, h: float, right: torch.Tensor) -> torch.Tensor:
        """Solve (dtau^-1_(h xi))^* mu = right - h g^* H_g(mu) for mu."""
        def residual(mu: torch.Tensor) -> torch.Tensor:
            velocity, slope = held.rates(mu)
            x = h * velocity[:, -3:]
            bend = _bend(x, mu[:, -3:], self._tau(x), 1.0)
            return mu + h * slope - right + _only_turn(bend, mu)

        # Recorded by autograd: the recorded step reuses values that the held body caches here.
        guess = right - h * held.rates(right)[1]
        return self._solve('momenta', residual, guess, self._body.momentum_unit)

    def _leapfrog(self, node: BodyState, u: torch.Tensor) -> BodyState:
        h = 0.5 * self._h
        held = HeldBody(self._body, node.x, node.R, u)
        mu = self._inside(held, h, node.p)
        velocity, slope = held.rates(mu)
        x = h * velocity[:, -3:]
        place, R = node.x + h * velocity[:, :-3], turned(node.R, x, self._tau(x))
        p = node.p - h * slope - _only_turn(torch.linalg.cross(x, mu[:, -3:]), mu)
        return self._outside(BodyState(place, R, p), u, h, h * velocity)

    def _outside(self, node: BodyState, u: torch.Tensor, h: float, guess: torch.Tensor
                 ) -> BodyState:
        """Return the node after half a step with the position and attitude implicit."""
        def pose(change: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
            x = change[:, -3:]
            tau, turning = self._tau(x), node.p[:, -3:]
            mu = (tau.own * turning - tau.cross * torch.linalg.cross(x, turning)
                  + tau.line * (x * turning).sum(dim=1, keepdim=True) * x)
            return (node.x + change[:, :-3], turned(node.R, x, tau),
                    torch.cat([node.p[:, :-3], mu], dim=1))

        def residual(change: torch.Tensor) -> torch.Tensor:
            place, R, mu = pose(change)
            return change - h * HeldBody(self._body, place, R, u).velocity(mu)

        change = self._solve('pose', residual, guess, abs(h) * self._body.velocity_unit)
        place, R, mu = pose(change)
        slope = HeldBody(self._body, place, R, u).rates(mu)[1]
        bend = torch.linalg.cross(change[:, -3:], mu[:, -3:])
        return BodyState(place, R, node.p - h * slope - _only_turn(bend, mu))

    def _variational_euler(self, node: BodyState, u: torch.Tensor) -> BodyState:
        h = self._h
        velocity = HeldBody(self._body, node.x, node.R, u).velocity(node.p)
        x = h * velocity[:, -3:]
        tau = self._tau(x)
        place, R = node.x + h * velocity[:, :-3], turned(node.R, x, tau)
        right = node.p + _only_turn(_bend(x, node.p[:, -3:], tau, -1.0), node.p)
        held = HeldBody(self._body, place, R, u)
        return BodyState(place, R, self._inside(held, h, right))


def _only_turn(torque: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
    """Pad vectors of shape (N, 3) with leading zeros to the shape of p."""
    return torch.nn.functional.pad(torque, (p.shape[1] - 3, 0))


def network_of(config: BodyConfig, motions: Sequence[BodyMotions]) -> LieGroupNetwork:
    """Return the network of a configuration with the scales of motions, or raise DataError."""
    k = 3 if config.kind == 'rotation' else 6
    x, R, v, u = (torch.cat([part.flatten(0, 1) for part in parts]).numpy()
                  for parts in zip(*(motion[:4] for motion in motions), strict=True))
    seen = np.hstack([x, R.reshape(-1, 9)])
    half = 0.5 * np.ptp(seen, axis=0)
    before, a = (np.concatenate(parts) for parts in zip(*map(_accelerations, motions),
                                                        strict=True))
    velocity, acceleration = _sizes(v), _sizes(a)
    if not (velocity > 0.0).all() or not (acceleration > 0.0).all():
        raise DataError('the body never moves or never rotates in the data; use data in which it '
                        'does')
    driven = bool(u.any())
    size = np.sqrt(np.mean(u**2, axis=0))
    inertia = np.ones(k)
    if driven and config.family.input_map == 'identity':
        if u.shape[1] != k:
            raise DataError(f'input_map: identity requires {k} inputs, the forces in the frame of '
                            f'the body, but the data have {u.shape[1]}; use input_map: learned')
        inertia = _sizes(u) / acceleration
        inertia = np.where(inertia > 0.0, inertia, 1.0)
    first = None
    if driven and config.family.input_map == 'learned':
        if not size.all():
            raise DataError('input_map: an input is always zero in the data, so its effect cannot '
                            'be learned; remove it from the data')
        others = np.hstack([before, np.ones((len(a), 1))])
        inputs = torch.cat([motion.u[:-1].flatten(0, 1) for motion in motions]).numpy()
        rates = np.linalg.lstsq(np.hstack([inputs, others]), a, rcond=None)[0]
        first = inertia[:, None] * rates[:len(size)].T
    scales = BodyScales(
        0.5 * (seen.max(axis=0) + seen.min(axis=0)), np.where(half > _LEAST, half, 0.0), velocity,
        inertia * velocity, inertia * acceleration, first, size)
    card = config.family.card(config.kind, (1.0 / np.sqrt(inertia)).tolist(), driven)
    return LieGroupNetwork(card, config.hidden, scales, config.seed)


def _sizes(values: np.ndarray) -> np.ndarray:
    """Return the RMS length of position and rotation vectors, repeated for their components."""
    squares = (values.reshape(len(values), -1, 3)**2).mean(axis=(0, 2))
    return np.repeat(np.sqrt(3.0 * squares), 3)


def _accelerations(motion: BodyMotions) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes and velocities, and the mean accelerations until the next sample."""
    states = torch.cat([motion.R[:-1].flatten(2), motion.v[:-1]], dim=2)
    rates = (motion.v[1:] - motion.v[:-1]) / motion.interval
    return states.flatten(0, 1).numpy(), rates.flatten(0, 1).numpy()


def simulated_body(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions
                   ) -> list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Return x, R and v, shape (M, ...) each, at all samples but the first; inputs are held."""
    h = windows.interval / config.substeps
    step = LieSteps(network, config.method, config.retraction, h)
    x, R = windows.x[0], windows.R[0]
    node, found = BodyState(x, R, network.momenta(x, R, windows.v[0])), []
    nothing = windows.u[0, :, :0]
    for u in windows.u[:-1]:
        for _ in range(config.substeps):
            node = step(node, u)
        v = HeldBody(network, node.x, node.R, nothing).of_body(node.p)
        found.append((node.x, node.R, v))
    return found


def window_errors(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions
                  ) -> dict[str, torch.Tensor]:
    """Return mean squared errors of position, attitude, linear and angular velocity."""
    x, R, v = map(torch.stack, zip(*simulated_body(network, config, windows), strict=True))
    true, places = windows.at(slice(1, None)), x.shape[2]
    # |R - R'|^2 / 2 over nine entries is the squared angle up to terms of fourth order.
    errors = {'place': x - true.x, 'attitude': math.sqrt(4.5) * (R - true.R),
              'velocity': (v - true.v)[..., :places], 'turning': (v - true.v)[..., places:]}
    return {name: error.square().mean() for name, error in errors.items() if error.numel()}


def body_loss(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> torch.Tensor:
    """Return the mean squared errors relative to the usual velocities, those of poses per 1 s."""
    errors, unit = window_errors(network, config, windows), network.velocity_unit.square()
    total = [errors['turning'] / unit[-1], errors['attitude'] / unit[-1]]
    if 'place' in errors:
        total += [errors['velocity'] / unit[0], errors['place'] / unit[0]]
    return torch.stack(total).sum()


def joined(windows: Sequence[BodyMotions]) -> BodyMotions:
    """Concatenate windows of the same length and interval."""
    first = windows[0]
    for other in windows:
        if abs(other.interval - first.interval) > 0.01 * first.interval:
            raise DataError(f'the sampling intervals of the motions differ: {first.interval:.4g} '
                            f's and {other.interval:.4g} s; use them separately')
    x, R, v, u = (torch.cat(parts, dim=1) for parts in zip(
        *(other[:4] for other in windows), strict=True))
    return BodyMotions(x, R, v, u, first.interval)


def fit_body(config: BodyConfig, motions: Sequence[BodyMotions], train: Train = trained) -> Fitted:
    """
    Fit a network to windows: Adam on batches, L-BFGS on a subset.

    Parameters
    ----------
    config : BodyConfig
        Family, windows, learning rate and seed.
    motions : sequence of BodyMotions
        Training motions.
    train : callable
        Runs the stages.

    Raises
    ------
    DataError
        All motions are shorter than a window.

    """
    return train(TrainingProblem(
        network_of(config, motions), stages_of(config, motions), config.seed))


def stages_of(config: BodyConfig, motions: Sequence[BodyMotions]) -> list[Stage]:
    """Return the stages that fit a network to windows of motions."""
    return [one for stage in config.windows for one in _stages(config, stage, motions)]


def _stages(config: BodyConfig, stage: BodyStage, motions: Sequence[BodyMotions]
            ) -> Iterator[Stage]:
    whole = joined([motion.windows(stage.intervals) for motion in motions])
    count = whole.R.shape[1]

    def batches(network: LieGroupNetwork, generator: torch.Generator
                ) -> Callable[[], torch.Tensor]:
        return lambda: body_loss(network, config, whole.of(torch.randint(
            count, (config.batch,), generator=generator)))

    def subset(network: LieGroupNetwork, generator: torch.Generator) -> Callable[[], torch.Tensor]:
        rows = torch.randperm(count, generator=generator)
        chosen = whole.of(rows[:stage.lbfgs_windows])
        return lambda: body_loss(network, config, chosen)

    if stage.adam_steps:
        yield Stage(f'adam_{stage.intervals}', batches, stage.adam_steps,
                    config.learning_rate, clip=True, remedy=(
                        'reduce learning_rate, use more substeps, and check the data for '
                        'outliers'))
    if stage.lbfgs_steps:
        yield Stage(f'lbfgs_{stage.intervals}', subset, stage.lbfgs_steps,
                    evaluations=2, remedy=(
                        'steps have no solution there: use more substeps, or adam_steps '
                        'before it, and check the data for outliers'))
