# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Fit a mechanical network to measured motions: at single samples, or by simulated windows.

Accelerations that are estimated from measured motions are noisy, and an error of them says little
of where a motion goes. So they only find the beginning; then windows of the motions are simulated
from their smoothed first states, with the measured forces, short ones first (multiple shooting).
Accelerations that were measured, or are exact, tell all.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
import math

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import Motion, run_of
from hnn_vi_ros.learning.families.structure import MotionScales
from hnn_vi_ros.learning.fit.loop import INTERVAL, LBFGS_SCALE, LEAST_GAIN
from hnn_vi_ros.learning.fit.machine_config import (
    Discrete, Forward, Inverse, MachineConfig, Stage, Trajectory)
from hnn_vi_ros.learning.fit.machine_losses import (
    acceleration_loss, balanced_step, discrete_loss, force_loss, Network, Samples, samples_of,
    window_loss, Windows)
from hnn_vi_ros.learning.fit.window_steps import Solutions
import numpy as np
import torch
from tqdm import tqdm

# L-BFGS: blocks of samples, of which every tenth is left out; how often it may make them worse
# before it ends; samples at most; and pairs that it remembers.
_BLOCKS, _TENTH, _PATIENCE, _MOST_ROWS, _PAIRS = 50, 10, 5, 20000, 50


def scales_of(motions: Sequence[Motion], learns_map: bool = False) -> MotionScales:
    """
    Return the scales of motions, with a first input map where one is to be learned.

    Raises
    ------
    DataError
        A coordinate never moves, or the commands do not tell what the motors do.

    """
    q, v, a, tau = (np.concatenate([getattr(motion, name) for motion in motions])
                    for name in ('q_smooth', 'v_smooth', 'a_smooth', 'tau'))
    size = [np.sqrt(np.mean(part**2, axis=0)) for part in (v, a, tau)]
    # As measured: what is made of them differs from rest by rounding.
    moves = np.any([np.ptp(motion.q, axis=0) > 0.0 for motion in motions], axis=0)
    if not moves.all() or not (size[0] > 0.0).all() or not (size[1] > 0.0).all():
        rests = ', '.join(str(k + 1) for k in np.flatnonzero(~moves)) or 'of one or more'
        raise DataError(f'coordinate {rests} never moves in the data; record while it does, or '
                        'leave it out of coordinates and data')
    centre, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
    if learns_map:
        input_map, inertia = _first_map(q, v, a, tau)
        return MotionScales(centre, half, size[0], size[1], inertia, size[2], input_map)
    # Without forces the scale of energy is open: that of one unit of inertia is taken.
    driven = size[2] > 0.0
    inertia = np.where(driven, size[2] / size[1], 1.0)
    if driven.any():
        inertia[~driven] = np.exp(np.mean(np.log(inertia[driven])))
    return MotionScales(centre, half, size[0], size[1], inertia, inertia * size[1])


def _first_map(q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return an input map and inertias of joints, from accelerations that are linear in u."""
    rank, motors = int(np.linalg.matrix_rank(u)), u.shape[1]
    if not rank:
        raise DataError('input_map: the motors are never commanded in the data, which fixes no '
                        'scale and tells nothing of them; take input_map: identity')
    if rank < motors:
        raise DataError(f'input_map: of the commands of {motors} motors only {rank} are '
                        'independent, which does not tell what each of them does; leave out '
                        'motors that are not used, or record while each moves by itself')
    # What else there is: gravity, springs and friction.
    others = np.hstack([np.sin(q), np.cos(q), q, v, np.tanh(v / np.abs(v).mean(axis=0)),
                        np.ones((len(q), 1))])
    rates = np.linalg.lstsq(np.hstack([u, others]), a, rcond=None)[0][:motors].T
    # Of the same force on each joint for what it usually does, in the norm of the network.
    inertia = np.sqrt(np.mean(u**2)) / np.sqrt(np.mean(a**2, axis=0))
    input_map = inertia[:, None] * rates
    factor = math.sqrt(motors) / float(np.linalg.norm(input_map))
    return factor * input_map, factor * inertia


def fit(network: Network, config: MachineConfig, motions: Sequence[Motion],
        penalty: Callable[[torch.Generator], torch.Tensor] | None = None) -> dict[str, float]:
    """
    Fit a network to motions.

    Parameters
    ----------
    network : MechanicalNetwork or PlainNetwork
        Changed in place. A plain network, which has no masses, takes no loss but accelerations
        and windows.
    config : MachineConfig
        How.
    motions : sequence of Motion
        What to learn from.
    penalty : callable, optional
        Added to the loss, of a network that begins near its end, and so of windows with them.

    Returns
    -------
    dict
        The mean loss of the last tenth of each stage.

    Raises
    ------
    DataError
        The motions are shorter than a window, or the loss is not finite any more.

    """
    loss = config.loss_of(all(motion.accelerations for motion in motions))
    generator = torch.Generator().manual_seed(config.seed)
    if isinstance(loss, Trajectory):
        return _fit_windows(network, config, loss, samples_of(motions, loss.step_size), generator,
                            penalty)
    step_size = motions[0].spacing
    if isinstance(loss, Discrete):
        step_size = loss.step_size or balanced_step(motions)
    samples = samples_of(motions, step_size)
    at: Callable[..., torch.Tensor] = {
        'forward': acceleration_loss, 'inverse': force_loss, 'discrete': discrete_loss}[loss.kind]
    ahead = 2 * samples.every if isinstance(loss, Discrete) else 0
    rows = torch.nonzero(samples.left >= ahead)[:, 0]
    if not len(rows):
        raise DataError('no motion has three samples at distances of step_size; lower it')
    value = partial(at, network, samples)
    if penalty is None:
        return _regress(network, config, loss, value, rows, generator)

    def penalised(rows: torch.Tensor) -> torch.Tensor:
        # The same states again: L-BFGS needs a function.
        return value(rows) + penalty(torch.Generator().manual_seed(config.seed))
    return _regress(network, config, loss, penalised, rows, generator)


def _regress(network: Network, config: MachineConfig, loss: Forward | Inverse | Discrete,
             value: Callable[[torch.Tensor], torch.Tensor], rows: torch.Tensor,
             generator: torch.Generator) -> dict[str, float]:
    """Fit at single samples: Adam, then L-BFGS as long as it helps on samples left out."""
    def batch() -> torch.Tensor:
        return value(rows[torch.randint(len(rows), (loss.batch,), generator=generator)])
    losses = {loss.kind: _descend(network, batch, loss.steps, config.learning_rate, loss.kind)}
    return losses | _polish(network, value, rows, loss.lbfgs_steps, loss.kind)


def _polish(network: Network, value: Callable[[torch.Tensor], torch.Tensor], rows: torch.Tensor,
            steps: int, name: str) -> dict[str, float]:
    """Take steps of L-BFGS as long as they help on samples left out; return the loss by name."""
    losses: dict[str, float] = {}
    if not steps or len(rows) < _TENTH:
        return losses
    left_out = _left_out(rows)
    learnt = rows[~left_out]
    learnt = learnt[::max(1, len(learnt) // _MOST_ROWS)]
    parameters = [*network.parameters()]
    lbfgs = torch.optim.LBFGS(
        parameters, max_iter=INTERVAL, max_eval=10 * INTERVAL, history_size=_PAIRS,
        tolerance_grad=0.0, tolerance_change=0.0, line_search_fn='strong_wolfe')

    def scaled() -> torch.Tensor:
        lbfgs.zero_grad()
        scaled_loss = LBFGS_SCALE * value(learnt)
        scaled_loss.backward()
        return scaled_loss
    least, best, waited, before, taken = math.inf, [], 0, math.inf, 0
    with tqdm(total=steps, desc=f'{name}, L-BFGS', unit='step', disable=None) as progress:
        while True:
            with torch.no_grad():
                after, outside = float(value(learnt)), float(value(rows[left_out]))
            if outside < least:
                least, best = outside, [parameter.detach().clone() for parameter in parameters]
                waited, losses[f'{name}_lbfgs'] = 0, after
            else:
                waited += 1
            gained = before - after >= LEAST_GAIN * after
            if waited > _PATIENCE or taken >= steps or not gained:
                break
            before = after
            lbfgs.step(scaled)
            taken += INTERVAL
            progress.update(INTERVAL)
    with torch.no_grad():
        for parameter, values in zip(parameters, best, strict=True):
            parameter.copy_(values)
    return losses


def _left_out(rows: torch.Tensor) -> torch.Tensor:
    """Return which of some rows L-BFGS is judged by: blocks, as neighbours tell the same."""
    block = torch.arange(len(rows)) * min(_BLOCKS, len(rows)) // len(rows)
    return block % _TENTH == _TENTH - 1


def windows_of(loss: Trajectory, stage: Stage, samples: Samples) -> tuple[Windows, torch.Tensor]:
    """Return the windows of a stage, and the samples that they can begin at, or DataError."""
    count = round(stage.duration / samples.step_size)
    starts = torch.nonzero(samples.left >= count * samples.every)[:, 0]
    if count < 1 or not len(starts):
        raise DataError(f'windows: {stage.duration:g} s is less than step_size, or more than '
                        'every motion lasts')
    return Windows(count, loss.method, loss.time_scale), starts


def _fit_windows(network: Network, config: MachineConfig, loss: Trajectory, samples: Samples,
                 generator: torch.Generator,
                 penalty: Callable[[torch.Generator], torch.Tensor] | None) -> dict[str, float]:
    losses, rows = {}, torch.arange(len(samples.q))
    # What Adam had fitted would say at once that L-BFGS makes it worse.
    learnt = rows[~_left_out(rows)] if loss.forward_lbfgs_steps else rows

    def forward() -> torch.Tensor:
        chosen = learnt[torch.randint(len(learnt), (loss.forward_batch,), generator=generator)]
        return acceleration_loss(network, samples, chosen)
    if penalty is None:
        losses['forward'] = _descend(network, forward, loss.forward_steps, config.learning_rate,
                                     'accelerations')
        losses |= _polish(network, partial(acceleration_loss, network, samples), rows,
                          loss.forward_lbfgs_steps, 'forward')
    for stage in loss.windows:
        windows, starts = windows_of(loss, stage, samples)
        alone: list[int] = []

        def errors_of_windows(windows: Windows = windows, starts: torch.Tensor = starts,
                              alone: list[int] = alone) -> torch.Tensor:
            chosen, solutions = starts[torch.randint(
                len(starts), (loss.batch,), generator=generator)], Solutions()
            errors = window_loss(network, samples, chosen, windows, solutions)
            alone.append(solutions.alone)
            return errors if penalty is None else errors + penalty(generator)
        losses[f'windows_{stage.duration:g}'] = _descend(
            network, errors_of_windows, stage.steps,
            stage.learning_rate or 0.2 * config.learning_rate,
            f'windows of {stage.duration:g} s')
        if any(alone):
            print(f'windows of {stage.duration:g} s: {sum(alone)} of {len(alone) * loss.batch} '
                  'were solved step by step, which takes longer', flush=True)
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


def split_motions(motions: Sequence[Motion], test_runs: Sequence[str]
                  ) -> tuple[list[Motion], list[Motion]]:
    """Return what to learn from, and what to judge by: runs, or the last fifth of each."""
    if test_runs:
        return ([motion for motion in motions if run_of(motion) not in test_runs],
                [motion for motion in motions if run_of(motion) in test_runs])
    ends = [4 * len(motion.t) // 5 for motion in motions]
    return ([part_of(motion, slice(None, end)) for motion, end in zip(motions, ends, strict=True)],
            [part_of(motion, slice(end, None)) for motion, end in zip(motions, ends, strict=True)])


def part_of(motion: Motion, rows: slice) -> Motion:
    """Return some samples of a motion."""
    return replace(motion, **{name: values[rows] for name, values in vars(motion).items()
                              if isinstance(values, np.ndarray)})
