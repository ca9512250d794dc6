# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of rotating bodies on windows of motions, and judge them on other windows."""

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
import json
import math
from pathlib import Path
from typing import Any, cast, NamedTuple

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import write_text
from hnn_vi_ros.integrators import cayley, Coefficients
from hnn_vi_ros.learning.data.arrays import BodyMotions, read_bodies
from hnn_vi_ros.learning.data.sources import one_file
from hnn_vi_ros.learning.families.base import newton
from hnn_vi_ros.learning.families.lie_group import (
    BodyScales, BodyStage, HeldBody, LieGroupNetwork, LieMethod, RetractionName)
from hnn_vi_ros.learning.families.priors import NumpyTensor
from hnn_vi_ros.learning.fit.config import BodyConfig, find_config, load_config
from hnn_vi_ros.learning.fit.loop import Stage, TrainingProblem
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.learning.tasks import described, OPEN_BY_MAP, TrainingTask
from hnn_vi_ros.models import Box, Checkpoint, group_of, load_checkpoint, Scheme
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
    return Coefficients(*(part.tensor for part in cast(Any, cayley)(NumpyTensor(y))))


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


def published_loss(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> float:
    """
    Return the published loss of models of this kind, in SI units.

    The loss is the sum of the mean squared errors of position, velocity, angular velocity and
    angle over all samples of windows but the first. For the pendulum, the published mean also
    includes the error of its one input, which is zero: 3/4 of the angular velocity's error.
    """
    errors = _errors(network, config, windows)
    if 'place' not in errors:
        count = windows.u.shape[2]
        errors['turning'] *= 3.0 / (3.0 + count)
    return sum(errors.values())


def body_loss(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> torch.Tensor:
    """Return the mean squared errors relative to the usual velocities."""
    errors, unit = window_errors(network, config, windows), network.velocity_unit.square()
    total = [errors['turning'] / unit[-1], errors['attitude'] / (config.time_scale**2 * unit[-1])]
    if 'place' in errors:
        total += [errors['velocity'] / unit[0], errors['place'] / (config.time_scale**2 * unit[0])]
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


class BodyProblem(TrainingProblem):
    """
    A network and the stages that fit it to windows: Adam on batches, L-BFGS on a subset.

    Parameters
    ----------
    network : LieGroupNetwork
        Trained in place.
    config : BodyConfig
        Windows, learning rate and seed.
    motions : sequence of BodyMotions
        Training motions.

    Raises
    ------
    DataError
        All motions are shorter than a window.

    """

    def __init__(self, network: LieGroupNetwork, config: BodyConfig,
                 motions: Sequence[BodyMotions]):
        super().__init__(network, (), torch.Generator().manual_seed(config.seed))
        self._config, self._motions = config, motions
        self.stages = [one for stage in config.windows for one in self._stages(stage)]

    def _stages(self, stage: BodyStage) -> Iterator[Stage]:
        whole = joined([motion.windows(stage.intervals) for motion in self._motions])
        count, chosen = whole.R.shape[1], whole

        def batch() -> torch.Tensor:
            rows = torch.randint(count, (self._config.batch,), generator=self.generator)
            return body_loss(self.module, self._config, whole.of(rows))

        def choose() -> None:
            nonlocal chosen
            rows = torch.randperm(count, generator=self.generator)
            chosen = whole.of(rows[:stage.lbfgs_windows])

        if stage.adam_steps:
            yield Stage(f'adam_{stage.intervals}', batch, stage.adam_steps,
                        self._config.learning_rate, clip=True, remedy=(
                            'reduce learning_rate, use more substeps, and check the data for '
                            'outliers'))
        if stage.lbfgs_steps:
            yield Stage(f'lbfgs_{stage.intervals}',
                        lambda: body_loss(self.module, self._config, chosen), stage.lbfgs_steps,
                        evaluations=2, begin=choose, remedy=(
                            'steps have no solution there: use more substeps, or adam_steps '
                            'before it, and check the data for outliers'))


# Number of intervals per test window, as in the publications.
INTERVALS = 4
_UNITS = {'place': 'm', 'attitude': 'rad', 'velocity': 'm/s', 'turning': 'rad/s'}


class BodyTask(TrainingTask):
    """
    Training of a rotating body on windows of its motions; see Task.

    Parameters
    ----------
    source : Path
        Path of the configuration.
    config : BodyConfig
        Configuration of the training.
    given : sequence of str
        File that overrides the configured one.
    ensemble : bool
        Not supported for this family.

    """

    picture = 'windows'

    def __init__(self, source: Path, config: BodyConfig, given: Sequence[str], ensemble: bool):
        self._config = config
        self._train, test, self._description = read_bodies(
            one_file(source, config.data.path, given), config.data, config.kind)
        self._windows = _judged(test)

    def arrays(self) -> Iterator[np.ndarray]:
        """Yield the arrays of the training motions; see Task."""
        return (part.numpy() for motion in self._train for part in motion[:4])

    def problem(self, config: BodyConfig, device: str) -> BodyProblem:
        """Return a new network with its stages; see Task."""
        return BodyProblem(network_of(config, self._train), config, self._train)

    def describe(self, problem: TrainingProblem, config: BodyConfig, name: str, command: str
                 ) -> Checkpoint:
        """Return a trained network with its card; see Task."""
        network = problem.module
        scale = _scale(network, self._train)
        if scale:
            network.multiply(1.0 / _open_scale(network, self._train))
        with torch.no_grad():
            p = torch.cat([
                network.momenta(*(getattr(motion, part).flatten(0, 1) for part in 'xRv'))
                for motion in self._train])
        x = torch.cat([motion.x.flatten(0, 1) for motion in self._train])
        # Entries of attitudes are unrestricted; the last momentum component stays zero.
        box = Box(q=[*_bounds(x), *[[-1.01, 1.01]] * 4], p=[*_bounds(p), [-1.0, 1.0]])
        scheme = Scheme(integrator=config.method,
                        step_size=self._train[0].interval / config.substeps)
        return described(
            config, network.layers(), name, command, family='lie_group', lie_group=network.card,
            scheme=scheme, box=box, dataset=f'{config.description} {self._description}'.lstrip()
            + scale, losses=problem.losses)

    def judged(self, checkpoint: Checkpoint, problem: TrainingProblem) -> Judged:
        """Return the model with window errors as text; see Task."""
        text = _text(problem.module, self._config, self._windows)
        return Judged(checkpoint, text, text)


def _open_scale(network: LieGroupNetwork, motions: Sequence[BodyMotions]) -> float:
    """Return the quantity to normalise: the RMS column of B, or the mean inertia."""
    R = torch.cat([motion.R.flatten(0, 1) for motion in motions])
    x = torch.cat([motion.x.flatten(0, 1) for motion in motions])
    count = motions[0].u.shape[2] if 'input_map' in network.features else 0
    with torch.no_grad():
        if count:
            forces = [network.inputs(x, R, unit.expand(len(R), -1)) for unit in
                      torch.eye(count, dtype=R.dtype)]
            squares = torch.stack([force.square().sum(dim=1).mean()
                                   for force in forces if force is not None])
            return float(squares.mean().sqrt())
        inverse = HeldBody(network, x, R, R.new_zeros((len(R), 0))).inverse
        inertia = torch.linalg.inv(inverse)[:, -3:, -3:]
        return float(inertia.diagonal(dim1=1, dim2=2).mean())


def _scale(network: LieGroupNetwork, motions: Sequence[BodyMotions]) -> str:
    """Return a note on the energy scale for the model card, '' if inputs fix the scale."""
    if 'input_map' in network.features:
        return OPEN_BY_MAP
    if any(motion.u.any() for motion in motions):
        return ''
    return '; the energy scale is arbitrary, since there are no inputs: the mean inertia is 1'


def _bounds(values: torch.Tensor) -> list[list[float]]:
    low, high = values.min(dim=0).values, values.max(dim=0).values
    # A constant still gets an interval of positive length.
    least = 1e-6 * (1.0 + torch.maximum(low.abs(), high.abs()))
    found: list[list[float]] = torch.stack([low - least, high + least], dim=1).tolist()
    return found


def evaluate(arguments: Namespace) -> None:
    """Print a model's window errors on its test data and the published loss."""
    model = load_checkpoint(arguments.model)
    if arguments.config is None:
        raise ParameterError(f'{arguments.model}: a model of the family lie_group is evaluated on '
                             'the data windows of a training configuration; name it with --config')
    if arguments.out is not None or arguments.baselines is not None or arguments.whole:
        raise ParameterError('--out, --baselines and --whole: not available for the family '
                             'lie_group; remove them')
    source, group = find_config(arguments.config), group_of(model)
    config = load_config(source)
    kind = config.kind if isinstance(config, BodyConfig) else config.family.kind
    if not isinstance(config, BodyConfig) or group.kind != kind:
        raise DataError(f'{source}: describes a {kind}, but {arguments.model} a {group.kind}')
    file = one_file(source, config.data.path, arguments.data)
    _, test, description = read_bodies(file, config.data, group.kind)
    network, windows = LieGroupNetwork.of(model), _judged(test)
    driven = 'input_map' in network.features
    if driven and windows.u.shape[2] * group.size != len(model.networks['input_map'].biases[-1]):
        raise DataError(f'{file}: its {windows.u.shape[2]} inputs do not match those of '
                        f'{arguments.model}')
    print(f'{arguments.model} on {description}\n{_text(network, config, windows)}')
    if arguments.json is not None:
        write_text(arguments.json, json.dumps({
            'published_loss': published_loss(network, config, windows),
            'mean_square': _errors(network, config, windows)}, indent=2) + '\n')


def _judged(motions: Sequence[BodyMotions]) -> BodyMotions:
    count = min(INTERVALS, *(len(motion.R) - 1 for motion in motions))
    return joined([motion.windows(count) for motion in motions])


def _errors(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions
            ) -> dict[str, float]:
    with torch.no_grad():
        return {name: float(value)
                for name, value in window_errors(network, config, windows).items()}


def _text(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> str:
    parts = ', '.join(f'{name} {value**0.5:.3g} {_UNITS[name]}'
                      for name, value in _errors(network, config, windows).items())
    return (f'{windows.R.shape[1]} windows of {len(windows.R) - 1} intervals of '
            f'{windows.interval:.4g} s\nRMS errors: {parts}\nloss as published: '
            f'{published_loss(network, config, windows):.3g}')
