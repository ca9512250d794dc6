# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit the network of a body that turns to windows of its motions, by steps on the group."""

from collections.abc import Sequence
import math

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.body_data import Motions
from hnn_vi_ros.learning.families.lie_group import BodyScales, LieGroupNetwork
from hnn_vi_ros.learning.fit.body_config import BodyConfig
from hnn_vi_ros.learning.fit.lie_steps import LieSteps, Node
from hnn_vi_ros.learning.fit.loop import INTERVAL, LBFGS_SCALE, LEAST_GAIN
import numpy as np
import torch
from tqdm import tqdm

# Pairs that L-BFGS remembers; and half of the range of what only rounding changes.
_PAIRS, _LEAST = 50, 1e-12
# What stands for a loss that is not finite.
_TOO_FAR = 1e30


def network_of(config: BodyConfig, motions: Sequence[Motions]) -> LieGroupNetwork:
    """Return the network of a configuration, with the scales of motions, or raise DataError."""
    k = 3 if config.coordinates[0].kind == 'rotation' else 6
    x, R, v, u = (torch.cat([part.flatten(0, 1) for part in parts]).numpy()
                  for parts in zip(*(motion[:4] for motion in motions), strict=True))
    seen = np.hstack([x, R.reshape(-1, 9)])
    half = 0.5 * np.ptp(seen, axis=0)
    before, a = (np.concatenate(parts) for parts in zip(*map(_accelerations, motions),
                                                        strict=True))
    places = k - 3
    # One scale for the velocities of a place, and one for those of turning.
    parts = [slice(0, places), slice(places, k)] if places else [slice(0, 3)]
    velocity, acceleration = np.ones(k), np.ones(k)
    for part in parts:
        velocity[part] = np.sqrt(np.mean(v[:, part]**2) * 3.0)
        acceleration[part] = np.sqrt(np.mean(a[:, part]**2) * 3.0)
    if not (velocity > 0.0).all() or not (acceleration > 0.0).all():
        raise DataError('the body never moves in the data, or never turns; learn from data in '
                        'which it does')
    driven = bool(u.any())
    size = np.sqrt(np.mean(u**2, axis=0))
    inertia = np.ones(k)
    if driven and config.family.input_map == 'identity':
        if u.shape[1] != k:
            raise DataError(f'input_map: identity takes {k} inputs, forces in the frame of the '
                            f'body; the data have {u.shape[1]}: take input_map: learned')
        for part in parts:
            inertia[part] = math.sqrt(np.mean(u[:, part]**2) * 3.0) / acceleration[part]
        inertia = np.where(inertia > 0.0, inertia, 1.0)
    first = None
    if driven and config.family.input_map == 'learned':
        if not size.all():
            raise DataError('input_map: an input is never used in the data, which say nothing '
                            'of what it does; leave it out of them')
        others = np.hstack([before, np.ones((len(a), 1))])
        rates = np.linalg.lstsq(np.hstack([_inputs(motions), others]), a, rcond=None)[0]
        first = inertia[:, None] * rates[:len(size)].T
    scales = BodyScales(
        0.5 * (seen.max(axis=0) + seen.min(axis=0)), np.where(half > _LEAST, half, 0.0), velocity,
        inertia * velocity, inertia * acceleration, first, size)
    card = config.card((1.0 / np.sqrt(inertia)).tolist(), driven)
    return LieGroupNetwork(card, config.hidden, scales, config.seed)


def _accelerations(motion: Motions) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes and velocities, and the mean accelerations until the next instant."""
    states = torch.cat([motion.R[:-1].flatten(2), motion.v[:-1]], dim=2)
    rates = (motion.v[1:] - motion.v[:-1]) / motion.interval
    return states.flatten(0, 1).numpy(), rates.flatten(0, 1).numpy()


def _inputs(motions: Sequence[Motions]) -> np.ndarray:
    return torch.cat([motion.u[:-1].flatten(0, 1) for motion in motions]).numpy()


def simulated(network: LieGroupNetwork, config: BodyConfig, windows: Motions) -> list[tuple[
        torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Return x, R and v, each (M, ...), at every instant but the first, with the inputs held."""
    h = windows.interval / config.substeps
    step = LieSteps(network, config.method, config.retraction, h)
    x, R = windows.x[0], windows.R[0]
    node, found = Node(x, R, network.momenta(x, R, windows.v[0])), []
    nothing = windows.u[0, :, :0]
    for u in windows.u[:-1]:
        for _ in range(config.substeps):
            node = step(node, u)
        v = network.held(node.x, node.R, nothing).of_body(node.p)
        found.append((node.x, node.R, v))
    return found


def window_errors(network: LieGroupNetwork, config: BodyConfig, windows: Motions
                  ) -> dict[str, torch.Tensor]:
    """Return mean squared errors: of places, attitudes (angles), velocities, turning."""
    parts: dict[str, list[torch.Tensor]] = {
        'place': [], 'attitude': [], 'velocity': [], 'turning': []}
    for k, (x, R, v) in enumerate(simulated(network, config, windows), 1):
        places = x.shape[1]
        # |R - R'|^2 / 2 is the squared angle between them, but for its fourth power.
        parts['attitude'].append((R - windows.R[k]).square().sum(dim=(1, 2)).mean() / 2.0)
        parts['turning'].append((v[:, places:] - windows.v[k][:, places:]).square().mean())
        if places:
            parts['place'].append((x - windows.x[k]).square().mean())
            parts['velocity'].append((v[:, :3] - windows.v[k][:, :3]).square().mean())
    return {name: torch.stack(values).mean() for name, values in parts.items() if values}


def published_loss(network: LieGroupNetwork, config: BodyConfig, windows: Motions) -> float:
    """
    Return the loss by which models of this kind were published, in SI units.

    It is the sum of the mean squared errors of place, velocity, angular velocity and angle, over
    all instants of windows but the first. Of the pendulum, it was the mean over the angular
    velocity and its one input, whose error is zero: three quarters of that of the velocity.
    """
    with torch.no_grad():
        errors = {name: float(value)
                  for name, value in window_errors(network, config, windows).items()}
    if 'place' not in errors:
        count = windows.u.shape[2]
        errors['turning'] *= 3.0 / (3.0 + count)
    return sum(errors.values())


def _loss(network: LieGroupNetwork, config: BodyConfig, windows: Motions) -> torch.Tensor:
    """Return the mean squared errors in units of the usual velocities."""
    errors, unit = window_errors(network, config, windows), network.velocity_unit.square()
    turning, total = unit[-1], []
    total.append(errors['turning'] / turning)
    total.append(errors['attitude'] / (config.time_scale**2 * turning))
    if 'place' in errors:
        total.append(errors['velocity'] / unit[0])
        total.append(errors['place'] / (config.time_scale**2 * unit[0]))
    return torch.stack(total).sum()


def fit(network: LieGroupNetwork, config: BodyConfig, motions: Sequence[Motions]
        ) -> dict[str, float]:
    """
    Fit a network to windows of motions: by Adam on batches, by L-BFGS on a part.

    Returns
    -------
    dict
        The last loss of each part of each stage.

    Raises
    ------
    DataError
        The motions are shorter than a window, or the loss is not finite any more.

    """
    losses, generator = {}, torch.Generator().manual_seed(config.seed)
    for stage in config.windows:
        whole = joined([motion.windows(stage.intervals) for motion in motions])
        if stage.adam_steps:
            losses[f'adam_{stage.intervals}'] = _adam(
                network, config, whole, stage.adam_steps, generator)
        if stage.lbfgs_steps:
            rows = torch.randperm(whole.R.shape[1], generator=generator)[:stage.lbfgs_windows]
            losses[f'lbfgs_{stage.intervals}'] = _lbfgs(
                network, config, _taken(whole, rows), stage.lbfgs_steps)
    return losses


def joined(windows: Sequence[Motions]) -> Motions:
    """Return windows of one length and interval as one."""
    first = windows[0]
    for other in windows:
        if abs(other.interval - first.interval) > 0.01 * first.interval:
            raise DataError(f'motions are sampled every {first.interval:.4g} s and every '
                            f'{other.interval:.4g} s; take them one by one')
    return Motions(*(torch.cat(parts, dim=1) for parts in zip(
        *(other[:4] for other in windows), strict=True)), first.interval)


def _taken(windows: Motions, rows: torch.Tensor) -> Motions:
    return Motions(*(part[:, rows] for part in windows[:4]), windows.interval)


def _parameters(network: LieGroupNetwork) -> list[torch.nn.Parameter]:
    return [parameter for parameter in network.parameters() if parameter.requires_grad]


def _adam(network: LieGroupNetwork, config: BodyConfig, windows: Motions, steps: int,
          generator: torch.Generator) -> float:
    parameters = _parameters(network)
    adam = torch.optim.Adam(parameters, lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    values = []
    for step in tqdm(range(steps), desc='Adam', unit='step', disable=None):
        rows = torch.randint(windows.R.shape[1], (config.batch,), generator=generator)
        adam.zero_grad()
        value = _loss(network, config, _taken(windows, rows))
        value.backward()
        values.append(float(value.detach()))
        if not math.isfinite(values[-1]):
            raise DataError(f'the loss is {values[-1]} after {step} steps; lower learning_rate, '
                            'take more substeps, and look for outliers in the data')
        torch.nn.utils.clip_grad_norm_(parameters, 1.0)
        adam.step()
        schedule.step()
    return float(np.mean(values[-max(1, steps // 10):]))


def _lbfgs(network: LieGroupNetwork, config: BodyConfig, windows: Motions, steps: int) -> float:
    parameters = _parameters(network)
    lbfgs = torch.optim.LBFGS(
        parameters, max_iter=INTERVAL, max_eval=2 * INTERVAL, history_size=_PAIRS,
        tolerance_grad=0.0, tolerance_change=0.0, line_search_fn='strong_wolfe')

    def closure() -> torch.Tensor:
        lbfgs.zero_grad()
        value = LBFGS_SCALE * _loss(network, config, windows)
        if not value.isfinite():
            # A step that no solution follows is one too far, which the line search shortens: by a
            # value alone, for what is not a number would be all that is left of the parameters.
            for parameter in parameters:
                parameter.grad = torch.zeros_like(parameter)
            return torch.full_like(value, _TOO_FAR)
        value.backward()
        return value

    before = after = float(closure().detach()) / LBFGS_SCALE
    if before == _TOO_FAR / LBFGS_SCALE:
        raise DataError('L-BFGS begins where the loss is not finite: no step has a solution '
                        'there; take more substeps, or adam_steps before, and look for outliers '
                        'in the data')
    with tqdm(total=steps, desc='L-BFGS', unit='step', disable=None) as progress:
        for _ in range(0, steps, INTERVAL):
            lbfgs.step(closure)
            progress.update(INTERVAL)
            after = float(closure().detach()) / LBFGS_SCALE
            if not before - after >= LEAST_GAIN * after:
                break
            before = after
    return after
