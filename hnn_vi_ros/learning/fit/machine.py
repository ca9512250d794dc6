# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Losses and stages that fit the network of a machine to measured motions."""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion, joined
from hnn_vi_ros.learning.families.choices import (
    Discrete, Forward, Inverse, MotionScales, Structure, TrajectoryLoss, WindowMethod, WindowStage)
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork, PlainNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.loop import Begin, Fitted, Stage, trained, TrainingProblem
from hnn_vi_ros.learning.fit.steps import simulated, Solutions
import numpy as np
import torch

# Share of the usual size beyond which the loss grows linearly with an error.
_USUAL_ERROR = 0.25
# Default step size of windows; rounded to a multiple of the sampling interval [s].
_STEP = 0.01
# Factor of Adam's learning rate for windows, relative to accelerations; twice that for the
# small networks on top of a prior.
_RATE = 0.2
# Samples per Adam step on accelerations; time that converts an error of v in a window to an
# equivalent error of q [s].
_FORWARD_BATCH, _TIME_SCALE = 1024, 0.1
# L-BFGS holds out every tenth of _BLOCKS blocks of samples, ends after _PATIENCE evaluations
# that do not improve them, and uses at most _MOST_ROWS samples.
_BLOCKS, _TENTH, _PATIENCE, _MOST_ROWS = 50, 10, 6, 20000
# Number of the longest windows that judge all window stages; number of restarts at lower
# rates of a stage that does not improve them.
_JUDGED, _RETRIES = 256, 2

Network = MechanicalNetwork | PlainNetwork
# Loss of a network at the samples with the given row indices; the generator is for penalties.
Value = Callable[[Any, torch.Tensor, torch.Generator], torch.Tensor]


class Samples(NamedTuple):
    """
    Concatenated samples of all motions as tensors.

    Parameters
    ----------
    measured : torch.Tensor, shape (N, d)
        Measured coordinates.
    q, v, a : torch.Tensor, shape (N, d)
        Smoothed states and accelerations.
    tau, mean_tau : torch.Tensor, shape (N, m)
        Measured motor commands, and their mean over the step that begins at each sample.
    left : torch.Tensor of int, shape (N,)
        Number of later samples in the same motion.
    every : int
        Number of sampling intervals per step.
    step_size : float
        Length of a step [s].

    """

    measured: torch.Tensor
    q: torch.Tensor
    v: torch.Tensor
    a: torch.Tensor
    tau: torch.Tensor
    mean_tau: torch.Tensor
    left: torch.Tensor
    every: int
    step_size: float


def samples_of(motions: Sequence[EvenMotion], step_size: float | None) -> Samples:
    """Return the samples for windows of this step size [s]; raise DataError if it does not fit."""
    step_size = step_size or usual_step(motions)
    every = round(step_size / motions[0].spacing)
    for motion in motions:
        if every < 1 or abs(every * motion.spacing - step_size) > 0.05 * step_size:
            raise DataError(f'{motion.name}: its sampling interval is {motion.spacing:.4g} s; '
                            'step_size must be a multiple of it, such as '
                            f'{max(every, 1) * motion.spacing:.4g}')
    parts = joined(motions, 'q', 'q_smooth', 'v_smooth', 'a_smooth', 'tau')
    means = np.concatenate([mean_forces(motion, every) for motion in motions])
    left = np.concatenate([np.arange(len(motion.t))[::-1] for motion in motions])
    measured, q, v, a, tau, mean, behind = map(torch.tensor, (*parts, means, left))
    return Samples(measured, q, v, a, tau, mean, behind, every, every * motions[0].spacing)


def usual_step(motions: Sequence[EvenMotion]) -> float:
    """Return the default step size of windows [s]."""
    return max(1, round(_STEP / motions[0].spacing)) * motions[0].spacing


def slowness(motions: Sequence[EvenMotion], step_size: float | None = None) -> float:
    """Return the step size relative to the usual one, 1 or more; larger if samples are rare."""
    return max(1.0, round((step_size or usual_step(motions)) / _STEP, 2))


def mean_forces(motion: EvenMotion, every: int) -> np.ndarray:
    """Average the forces over ``every`` intervals after each sample, shape (N, m)."""
    n, tau = len(motion.t), motion.tau
    total = np.vstack([np.zeros((1, tau.shape[1])), np.cumsum(motion.forces, axis=0)])
    starts = np.arange(n)
    ends = np.minimum(starts + every, n - 1)
    means = (total[ends] - total) / np.maximum(ends - starts, 1)[:, None]
    return np.where(ends[:, None] > starts[:, None], means, tau)


def acceleration_loss(network: Network, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """Return the soft loss of acceleration errors relative to their usual size."""
    return _soft(acceleration_errors(network, samples, rows))


def acceleration_errors(network: Network, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """Return acceleration errors relative to their usual size, shape (N, d)."""
    predicted = network.accelerations(samples.q[rows], samples.v[rows], samples.tau[rows])
    return (predicted - samples.a[rows]) / torch.tensor(network.scales.a)


def force_loss(network: MechanicalNetwork, samples: Samples, rows: torch.Tensor) -> torch.Tensor:
    """Return the soft loss of force errors relative to the forces of usual motions."""
    tau = network.joint_forces(samples.tau[rows])
    predicted = network.forces(samples.q[rows], samples.v[rows], samples.a[rows], tau)
    unit = torch.tensor(network.scales.inertia * network.scales.a)
    return _soft((predicted - tau) / unit)


def discrete_loss(network: MechanicalNetwork, samples: Samples, rows: torch.Tensor
                  ) -> torch.Tensor:
    """
    Return the soft loss of the residuals of the forced discrete Euler-Lagrange equations.

    D2 L_d(q0, q1) + D1 L_d(q1, q2) + h (f01 + f12) / 2 = 0 for L_d(q0, q1) = h L((q0 + q1) / 2,
    (q1 - q0) / h) and forces f at the same midpoint (J. Marsden, M. West, Acta Numerica 10,
    2001, part 3.2). The residual is converted to an acceleration because small masses alone would
    make a residual of momentum small.
    """
    h, every = samples.step_size, samples.every
    q0, q1, q2 = (samples.measured[rows + k * every] for k in range(3))
    tau = [network.joint_forces(samples.mean_tau[rows + k * every]) for k in range(2)]
    (p01, rate01), (p12, rate12) = (
        network.momenta(0.5 * (start + end), (end - start) / h, force)
        for start, end, force in zip((q0, q1), (q1, q2), tau, strict=True))
    residual = p01 - p12 + 0.5 * h * (rate01 + rate12 + sum(tau))
    return _soft(network.velocities(q1, residual) / h / torch.tensor(network.scales.a))


def balanced_step(motions: Sequence[EvenMotion]) -> float:
    """
    Return the step size for discrete_loss, a multiple of the sampling interval [s].

    Noise sigma of q causes an error of sqrt(6) sigma / h^2 in a second difference; the midpoint
    rule has an error of h^2 / 12 times the fourth derivative of q. The step makes both equal.
    """
    errors, speeds, accelerations = (np.concatenate(parts) for parts in zip(*(
        (motion.q - motion.q_smooth, motion.v_smooth, motion.a_smooth) for motion in motions),
        strict=True))
    # The median ignores the filter's end effects; for normal noise it is 0.6745 sigma.
    noise = float(np.median(np.abs(errors))) / 0.6745
    speed, acceleration = (float(np.sqrt(np.mean(part**2))) for part in (speeds, accelerations))
    # Assume one harmonic oscillation: estimated fourth derivatives are only noise.
    fourth = acceleration * (acceleration / speed)**2
    spacing = motions[0].spacing
    step = (12.0 * math.sqrt(6.0) * noise / fourth)**0.25
    return max(1, round(step / spacing)) * spacing


class WindowSettings(NamedTuple):
    """
    Settings of simulated windows.

    Parameters
    ----------
    steps : int
        Number of steps per window.
    method : str
        Integrator.

    """

    steps: int
    method: WindowMethod


def window_loss(network: Network, samples: Samples, starts: torch.Tensor, windows: WindowSettings,
                solutions: Solutions | None = None) -> torch.Tensor:
    """Return the soft loss of the errors of windows from these samples; see window_errors."""
    return _soft(window_errors(network, samples, starts, windows, solutions))


def window_errors(network: Network, samples: Samples, starts: torch.Tensor,
                  windows: WindowSettings, solutions: Solutions | None = None) -> torch.Tensor:
    """
    Return the errors of q and v after each step of the windows, shape (2 steps, N, d).

    ``solutions`` caches the solutions of the implicit equations for reuse.
    """
    # A network without masses has no momenta, which variational methods need.
    method = windows.method if network.has_masses else 'rk4'
    at = starts + samples.every * torch.arange(windows.steps + 1)[:, None]
    measured_q, measured_v = samples.q[at], samples.v[at]
    q, v = _simulated(network, method, measured_q, measured_v[0], samples.mean_tau[at[:-1]],
                      samples.step_size, solutions)
    unit = _USUAL_ERROR * torch.tensor(network.scales.v)
    return torch.stack([(q - measured_q[1:]) / (_TIME_SCALE * unit),
                        (v - measured_v[1:]) / unit], dim=1).flatten(0, 1)


def _simulated(network: Any, method: WindowMethod, measured: torch.Tensor, v: torch.Tensor,
               tau: torch.Tensor, h: float, solutions: Solutions | None
               ) -> tuple[torch.Tensor, torch.Tensor]:
    """Simulate from the first measured state with held commands; return q and v per step."""
    if method != 'rk4':
        forces = network.joint_forces(tau.flatten(0, 1)).unflatten(0, tau.shape[:2])
        q, v, _ = simulated(network, method, measured[0], v, forces, h, measured.diff(dim=0) / h,
                            solutions)
        return q, v
    q, found = measured[0], []
    for held in tau:
        q, v = runge_kutta(network.accelerations, q, v, held, h)
        found.append(torch.stack([q, v]))
    q, v = torch.stack(found, dim=1)
    return q, v


def _soft(z: torch.Tensor) -> torch.Tensor:
    return 2.0 * ((1.0 + z.square()).sqrt() - 1.0).mean()


def runge_kutta(accelerations: Callable[..., torch.Tensor], q: torch.Tensor, v: torch.Tensor,
                tau: torch.Tensor, h: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (q, v) after a step h [s] of the classical RK4 method with a held force."""
    a1 = accelerations(q, v, tau)
    v2 = v + 0.5 * h * a1
    a2 = accelerations(q + 0.5 * h * v, v2, tau)
    v3 = v + 0.5 * h * a2
    a3 = accelerations(q + 0.5 * h * v2, v3, tau)
    v4 = v + h * a3
    a4 = accelerations(q + h * v3, v4, tau)
    return q + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def scales_of(motions: Sequence[EvenMotion], learns_map: bool = False) -> MotionScales:
    """
    Return the scales of motions, with an initial input map if it is learned.

    Raises
    ------
    DataError
        A coordinate is constant, or the commands do not determine the effect of each motor.

    """
    q, v, a, tau = joined(motions, 'q_smooth', 'v_smooth', 'a_smooth', 'tau')
    size = [np.sqrt(np.mean(part**2, axis=0)) for part in (v, a, tau)]
    # Use measured coordinates: smoothed ones vary by rounding even at rest.
    moves = np.any([np.ptp(motion.q, axis=0) > 0.0 for motion in motions], axis=0)
    if not moves.all() or not (size[0] > 0.0).all() or not (size[1] > 0.0).all():
        rests = ', '.join(str(k + 1) for k in np.flatnonzero(~moves)) or 'of one or more'
        raise DataError(f'coordinate {rests} never moves in the data; record its motion, or '
                        'remove it from coordinates and data')
    centre, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
    if learns_map:
        input_map, inertia = _first_map(q, v, a, tau)
        return MotionScales(centre, half, size[0], size[1], inertia, size[2], input_map)
    # Without forces the energy scale is free; one unit of inertia is assumed.
    driven = size[2] > 0.0
    inertia = np.where(driven, size[2] / size[1], 1.0)
    if driven.any():
        inertia[~driven] = np.exp(np.mean(np.log(inertia[driven])))
    return MotionScales(centre, half, size[0], size[1], inertia, inertia * size[1])


def _first_map(q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return the input map and joint inertias from a regression of accelerations on u."""
    rank, motors = int(np.linalg.matrix_rank(u)), u.shape[1]
    if not rank:
        raise DataError('input_map: the motors are never commanded in the data, so their effect '
                        'cannot be learned; use input_map: identity')
    if rank < motors:
        raise DataError(f'input_map: the commands of {motors} motors have rank {rank}, so the '
                        'effects of the motors cannot be separated; remove unused motors, or '
                        'record independent commands')
    rates = np.linalg.lstsq(np.hstack([u, _others(q, v)]), a, rcond=None)[0][:motors].T
    # Inertias that give each joint the same RMS force, in the norm of the network.
    inertia = np.sqrt(np.mean(u**2)) / np.sqrt(np.mean(a**2, axis=0))
    input_map = inertia[:, None] * rates
    factor = math.sqrt(motors) / float(np.linalg.norm(input_map))
    return factor * input_map, factor * inertia


def _others(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the regressors of accelerations besides commands: gravity, friction, ..."""
    return np.hstack([np.sin(q), np.cos(q), q, v, np.tanh(v / np.abs(v).mean(axis=0)),
                      np.ones((len(q), 1))])


def windows_of(loss: TrajectoryLoss, stage: WindowStage, samples: Samples
               ) -> tuple[WindowSettings, torch.Tensor]:
    """Return the windows of a stage and their possible first samples, or raise DataError."""
    count = round(stage.duration / samples.step_size)
    starts = torch.nonzero(samples.left >= count * samples.every)[:, 0]
    if count < 1 or not len(starts):
        raise DataError(f'windows: {stage.duration:g} s is shorter than step_size or longer than '
                        'every motion')
    return WindowSettings(count, loss.method), starts


# Distance from the data beyond which networks fade: for continuous joints [rad], and for other
# coordinates as a share of half their range.
_NEAR_ANGLE, _NEAR_SHARE = 0.5, 0.33
# Size of grid cells, one sample each, in units of that distance; maximum number of cells;
# multiple of the data's speeds at which networks fade; number of random states per step.
_CELL, _SEEN, _FASTER, _STATES = 0.5, 2000, 2.0, 64


class Fading:
    """
    Penalty that makes networks added to a prior fade away from the data.

    The penalty is the size of the networks' forces at random states, with a small weight near the
    data and a large one elsewhere. An error of M' grows with v^2; the forces that M' causes at up
    to twice the speeds of the data therefore also get the large weight.

    Parameters
    ----------
    structure : Structure
        Structure of the network.
    motions : sequence of EvenMotion
        Training motions.
    seen_weight, fade_weight : float
        Weights near the data and elsewhere.

    """

    def __init__(self, structure: Structure, motions: Sequence[EvenMotion],
                 seen_weight: float, fade_weight: float):
        self._weights = seen_weight, fade_weight
        q, v = joined(motions, 'q_smooth', 'v_smooth')
        self._turns = torch.tensor([kind == 'continuous' for kind in structure.kinds])
        self._unit = torch.where(self._turns, _NEAR_ANGLE, _NEAR_SHARE * torch.tensor(
            np.where(np.ptp(q, axis=0) > 0.0, 0.5 * np.ptp(q, axis=0), 1.0)))
        # Taking every n-th sample would leave gaps where motions are fast.
        cells = np.round(q / (_CELL * self._unit.numpy()))
        seen = np.unique(cells, axis=0, return_index=True)[1]
        self._seen = torch.tensor(q[seen[::1 + len(seen) // _SEEN]])
        self._fastest = torch.tensor(np.abs(v).max(axis=0))

    def __call__(self, network: MechanicalNetwork, generator: torch.Generator) -> torch.Tensor:
        """Return the penalty of a network at newly drawn states."""
        large = self._weights[1]
        q = network.random_states(_STATES, generator, reach=2.0)
        rows = torch.randint(len(self._seen), (_STATES,), generator=generator)
        share = 2.0 * torch.rand(_STATES, network.d, generator=generator,
                                 dtype=torch.float64) - 1.0
        return (self.weights(q) * network.residual_sizes(q) + large * network.speed_sizes(
            self._seen[rows], _FASTER * self._fastest * share)).mean()

    def weights(self, q: torch.Tensor) -> torch.Tensor:
        """Return the weight of the network size at coordinates (N, d), shape (N,)."""
        usual, large = self._weights
        away = q[:, None] - self._seen
        away = torch.where(self._turns, torch.remainder(away + math.pi, 2.0 * math.pi) - math.pi,
                           away)
        nearest = (away / self._unit).square().sum(dim=2).min(dim=1).values
        return large + (usual - large) * torch.exp(-0.5 * nearest)


# Penalty of a network, at states that the generator draws.
Penalty = Callable[[Any, torch.Generator], torch.Tensor]


def fit_network(network: Network, config: MachineConfig, motions: Sequence[EvenMotion]) -> Fitted:
    """Fit a network to motions; see stages_of."""
    return trained(TrainingProblem(network, stages_of(config, motions), config.seed))


def stages_of(config: MachineConfig, motions: Sequence[EvenMotion], penalty: Penalty | None = None
              ) -> list[Stage]:
    """
    Return the stages that fit a network to motions, at single samples or on simulated windows.

    Accelerations estimated from measured motions are noisy, and their errors say little about
    the error of a simulated motion. They only initialise the network; then windows are simulated
    from smoothed states with the measured forces, short windows first (multiple shooting).
    Accelerations that were measured or are exact suffice on their own.

    Parameters
    ----------
    config : MachineConfig
        Loss, learning rate and seed. A plain network has no masses and supports only the losses on
        accelerations and windows.
    motions : sequence of EvenMotion
        Training motions.
    penalty : callable, optional
        Penalty added to the loss of networks on top of a prior; disables forward L-BFGS.

    Raises
    ------
    DataError
        All motions are shorter than a window.

    """
    loss = config.loss_of(motions)
    return _on_windows(config, loss, motions, penalty) if isinstance(loss, TrajectoryLoss) else \
        _on_samples(config, loss, motions, penalty)


def _batches(value: Value, rows: torch.Tensor, size: int) -> Begin:
    """Return the start of a stage whose loss is that of randomly drawn rows."""
    return lambda network, generator: lambda: value(
        network, rows[torch.randint(len(rows), (size,), generator=generator)], generator)


def _penalised(loss: torch.Tensor, penalty: Penalty | None, network: Any,
               generator: torch.Generator) -> torch.Tensor:
    return loss if penalty is None else loss + penalty(network, generator)


def _on_samples(config: MachineConfig, loss: Forward | Inverse | Discrete,
                motions: Sequence[EvenMotion], penalty: Penalty | None) -> list[Stage]:
    step_size = motions[0].spacing
    if isinstance(loss, Discrete):
        step_size = loss.step_size or balanced_step(motions)
    samples = samples_of(motions, step_size)
    at: Callable[..., torch.Tensor] = {
        'forward': acceleration_loss, 'inverse': force_loss, 'discrete': discrete_loss}[loss.kind]
    ahead = 2 * samples.every if isinstance(loss, Discrete) else 0
    rows = torch.nonzero(samples.left >= ahead)[:, 0]
    if not len(rows):
        raise DataError('no motion has three samples at intervals of step_size; reduce '
                        'step_size')

    def value(network: Any, rows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        # Use the same random states: L-BFGS needs a deterministic function.
        return _penalised(at(network, samples, rows), penalty, network,
                          torch.Generator().manual_seed(config.seed))
    return [Stage(loss.kind, _batches(value, rows, loss.batch), loss.steps,
                  config.learning_rate, clip=True),
            *_polish(loss.kind, value, rows, loss.lbfgs_steps)]


def _on_windows(config: MachineConfig, loss: TrajectoryLoss, motions: Sequence[EvenMotion],
                penalty: Penalty | None) -> list[Stage]:
    samples = samples_of(motions, loss.step_size)
    rows = torch.arange(len(samples.q))

    def value(network: Any, rows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        return _penalised(acceleration_loss(network, samples, rows), penalty, network, generator)
    longest = max(loss.windows, key=lambda stage: stage.duration)
    windows, starts = windows_of(loss, longest, samples)
    chosen = starts[::1 + len(starts) // _JUDGED]

    def judged(network: Any) -> float:
        with torch.no_grad():
            errors = window_loss(network, samples, chosen, windows, Solutions())
            return float(_penalised(errors, penalty, network,
                                    torch.Generator().manual_seed(config.seed)))
    # On samples that Adam fitted too, L-BFGS would seem to overfit at once.
    polishes = penalty is None and loss.forward_lbfgs_steps > 0
    learnt = rows[~_left_out(rows)] if polishes else rows
    found = [Stage('forward', _batches(value, learnt, _FORWARD_BATCH),
                   loss.forward_steps, config.learning_rate, clip=True)]
    if penalty is not None:
        # With a prior, the initial model is already good.
        found[0] = replace(found[0], held_out=judged, patience=loss.forward_steps)
    if polishes:
        found += _polish('forward', value, rows, loss.forward_lbfgs_steps)
    return found + [replace(
        _windows(config, loss, stage, samples, penalty), held_out=judged, patience=stage.steps,
        retries=_RETRIES) for stage in loss.windows]


def _windows(config: MachineConfig, loss: TrajectoryLoss, stage: WindowStage, samples: Samples,
             penalty: Penalty | None) -> Stage:
    windows, starts = windows_of(loss, stage, samples)
    alone: list[int] = []

    def value(network: Any, chosen: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        solutions = Solutions()
        errors = window_loss(network, samples, chosen, windows, solutions)
        alone.append(solutions.alone)
        return _penalised(errors, penalty, network, generator)

    def ended() -> None:
        if any(alone):
            print(f'windows of {stage.duration:g} s: {sum(alone)} of '
                  f'{len(alone) * loss.batch} were solved step by step, which is slower',
                  flush=True)
    share = _RATE if penalty is None else 2.0 * _RATE
    return Stage(f'windows_{stage.duration:g}', _batches(value, starts, loss.batch),
                 stage.steps, stage.learning_rate or share * config.learning_rate,
                 clip=True, ended=ended)


def _polish(name: str, value: Value, rows: torch.Tensor, steps: int) -> list[Stage]:
    """Return an L-BFGS stage that ends when held-out samples no longer improve; [] for none."""
    if not steps or len(rows) < _TENTH:
        return []
    left_out = _left_out(rows)
    learnt = rows[~left_out]
    learnt = learnt[::max(1, len(learnt) // _MOST_ROWS)]

    def held_out(network: Any) -> float:
        with torch.no_grad():
            return float(value(network, rows[left_out], torch.Generator()))
    return [Stage(f'{name}_lbfgs', lambda network, generator: lambda: value(
        network, learnt, generator), steps, held_out=held_out, patience=_PATIENCE)]


def _left_out(rows: torch.Tensor) -> torch.Tensor:
    """Return the mask of held-out samples; whole blocks, because neighbours are correlated."""
    block = torch.arange(len(rows)) * min(_BLOCKS, len(rows)) // len(rows)
    return block % _TENTH == _TENTH - 1
