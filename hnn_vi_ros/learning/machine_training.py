# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit a mechanical network to measured motions: by accelerations, then by simulated windows.

Accelerations of measured motions are noisy, and an error of them says little of where a motion
goes. So they only find the beginning; then windows of the motions are simulated from their
smoothed first states, with the measured forces, short ones first (multiple shooting).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.families.mechanical import MotionScales
from hnn_vi_ros.learning.machine_config import MachineConfig
from hnn_vi_ros.learning.motions import Motion, run_of
import numpy as np
import torch
from tqdm import tqdm

# Errors beyond this share of the usual size count by their size, no longer by their square.
_USUAL_ERROR = 0.25
# Step size of windows, unless it is given, and samples come as often [s].
_STEP = 0.01


class Network(Protocol):
    """What is fitted."""

    scales: MotionScales

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """Return what is changed."""

    def accelerations(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return dv/dt, all of shape (N, d)."""


class Samples(NamedTuple):
    """
    All motions, one after another, as tensors.

    Parameters
    ----------
    q, v, a, tau : torch.Tensor, shape (N, d)
        Smoothed states and accelerations; forces as measured.
    mean_tau : torch.Tensor, shape (N, d)
        The forces averaged over the step that begins at each sample.
    left : torch.Tensor of int, shape (N,)
        How many samples follow in the same motion.
    every : int
        Samples in one step.
    step_size : float
        How long it is [s].

    """

    q: torch.Tensor
    v: torch.Tensor
    a: torch.Tensor
    tau: torch.Tensor
    mean_tau: torch.Tensor
    left: torch.Tensor
    every: int
    step_size: float


def samples_of(motions: Sequence[Motion], step_size: float | None) -> Samples:
    """Return the samples of motions, for windows of this step size [s], or DataError."""
    if step_size is None:
        step_size = max(1, round(_STEP / motions[0].spacing)) * motions[0].spacing
    every = round(step_size / motions[0].spacing)
    for motion in motions:
        if every < 1 or abs(every * motion.spacing - step_size) > 0.05 * step_size:
            raise DataError(f'{motion.name}: sampled every {motion.spacing:.4g} s; step_size must '
                            f'be a multiple of that, such as {max(every, 1) * motion.spacing:.4g}')
    parts = [np.concatenate([getattr(motion, name) for motion in motions])
             for name in ('q_smooth', 'v_smooth', 'a_smooth', 'tau')]
    means = np.concatenate([mean_forces(motion, every) for motion in motions])
    left = np.concatenate([np.arange(len(motion.t))[::-1] for motion in motions])
    return Samples(*map(torch.tensor, (*parts, means, left)), every,
                   every * motions[0].spacing)


def mean_forces(motion: Motion, every: int) -> np.ndarray:
    """Return forces, shape (N, d), averaged over ``every`` intervals from each sample on."""
    n, tau = len(motion.t), motion.tau
    total = np.vstack([np.zeros((1, tau.shape[1])), np.cumsum(motion.forces, axis=0)])
    starts = np.arange(n)
    ends = np.minimum(starts + every, n - 1)
    means = (total[ends] - total) / np.maximum(ends - starts, 1)[:, None]
    return np.where(ends[:, None] > starts[:, None], means, tau)


def scales_of(motions: Sequence[Motion]) -> MotionScales:
    """Return the scales of motions, or DataError where a coordinate never moves."""
    q, v, a, tau = (np.concatenate([getattr(motion, name) for motion in motions])
                    for name in ('q_smooth', 'v_smooth', 'a_smooth', 'tau'))
    size = [np.sqrt(np.mean(part**2, axis=0)) for part in (v, a, tau)]
    if not (size[0] > 0.0).all() or not (size[1] > 0.0).all():
        raise DataError('a coordinate never moves in the data; learn from data in which every '
                        'coordinate moves')
    # Without forces the scale of energy is open: that of one unit of inertia is taken.
    driven = size[2] > 0.0
    inertia = np.where(driven, size[2] / size[1], 1.0)
    if driven.any():
        inertia[~driven] = np.exp(np.mean(np.log(inertia[driven])))
    return MotionScales(0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0),
                        size[0], size[1], inertia)


def fit(network: Network, config: MachineConfig, motions: Sequence[Motion]) -> dict[str, float]:
    """
    Fit a network to motions.

    Parameters
    ----------
    network : MechanicalNetwork or PlainNetwork
        Changed in place.
    config : MachineConfig
        How.
    motions : sequence of Motion
        What to learn from.

    Returns
    -------
    dict
        The mean loss of the last tenth of each stage.

    Raises
    ------
    DataError
        The motions are shorter than a window, or the loss is not finite any more.

    """
    samples = samples_of(motions, config.loss.step_size)
    generator = torch.Generator().manual_seed(config.seed)
    loss, losses = config.loss, {}

    def forward() -> torch.Tensor:
        rows = torch.randint(len(samples.q), (loss.forward_batch,), generator=generator)
        return acceleration_loss(network, samples, rows)
    losses['forward'] = _descend(network, forward, loss.forward_steps, config.learning_rate,
                                 'accelerations')
    for stage in loss.windows:
        count = round(stage.duration / samples.step_size)
        starts = torch.nonzero(samples.left >= count * samples.every)[:, 0]
        if count < 1 or not len(starts):
            raise DataError(f'windows: {stage.duration:g} s is less than step_size, or more than '
                            'every motion lasts')

        def windows(starts: torch.Tensor = starts, count: int = count) -> torch.Tensor:
            chosen = starts[torch.randint(len(starts), (loss.batch,), generator=generator)]
            return window_loss(network, samples, chosen, count, loss.time_scale)
        losses[f'windows_{stage.duration:g}'] = _descend(
            network, windows, stage.steps, 0.2 * config.learning_rate,
            f'windows of {stage.duration:g} s')
    return losses


def _descend(network: Network, loss: Callable[[], torch.Tensor], steps: int,
             rate: float, name: str) -> float:
    """Take steps of Adam with a rate that ends at zero; return the last tenth's mean loss."""
    adam = torch.optim.Adam(network.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    values = []
    for step in tqdm(range(steps), desc=name, unit='step', disable=None):
        adam.zero_grad()
        value = loss()
        value.backward()
        values.append(float(value.detach()))
        if not np.isfinite(values[-1]):
            raise DataError(f'the loss of {name} is {values[-1]} after {step} steps; lower '
                            'learning_rate, and look for outliers in the data')
        # One window that is thrown far must not undo what the others have taught.
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        adam.step()
        schedule.step()
    return float(np.mean(values[-max(1, steps // 10):]))


def acceleration_loss(network: Network, samples: Samples, rows: torch.Tensor
                      ) -> torch.Tensor:
    """Return the soft size of the errors of the accelerations, in units of their usual size."""
    predicted = network.accelerations(samples.q[rows], samples.v[rows], samples.tau[rows])
    return _soft((predicted - samples.a[rows]) / torch.tensor(network.scales.a))


def window_loss(network: Network, samples: Samples, starts: torch.Tensor, count: int,
                time_scale: float) -> torch.Tensor:
    """Return the soft size of the errors of windows of ``count`` steps from these samples."""
    unit = _USUAL_ERROR * torch.tensor(network.scales.v)
    q, v, errors = samples.q[starts], samples.v[starts], []
    for k in range(count):
        at = starts + k * samples.every
        q, v = runge_kutta(network.accelerations, q, v, samples.mean_tau[at],
                           samples.step_size)
        at = at + samples.every
        errors += [(q - samples.q[at]) / (time_scale * unit), (v - samples.v[at]) / unit]
    return _soft(torch.stack(errors))


def _soft(z: torch.Tensor) -> torch.Tensor:
    return 2.0 * ((1.0 + z.square()).sqrt() - 1.0).mean()


def runge_kutta(accelerations: Callable[..., torch.Tensor], q: torch.Tensor, v: torch.Tensor,
                tau: torch.Tensor, h: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (q, v) after a step h [s] of the classical method of order 4, at a held force."""
    a1 = accelerations(q, v, tau)
    v2 = v + 0.5 * h * a1
    a2 = accelerations(q + 0.5 * h * v, v2, tau)
    v3 = v + 0.5 * h * a2
    a3 = accelerations(q + 0.5 * h * v2, v3, tau)
    v4 = v + h * a3
    a4 = accelerations(q + h * v3, v4, tau)
    return q + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def split_motions(motions: Sequence[Motion], test_runs: Sequence[str]
                  ) -> tuple[list[Motion], list[Motion]]:
    """Return what to learn from, and what to judge by: runs, or the last fifth of each."""
    if test_runs:
        return ([motion for motion in motions if run_of(motion) not in test_runs],
                [motion for motion in motions if run_of(motion) in test_runs])
    ends = [4 * len(motion.t) // 5 for motion in motions]
    return ([_part(motion, slice(None, end)) for motion, end in zip(motions, ends, strict=True)],
            [_part(motion, slice(end, None)) for motion, end in zip(motions, ends, strict=True)])


def _part(motion: Motion, rows: slice) -> Motion:
    return replace(motion, **{name: values[rows] for name, values in vars(motion).items()
                              if isinstance(values, np.ndarray)})
