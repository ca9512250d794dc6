# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit the network of a body that turns to windows of its motions, by steps on the group."""

from collections.abc import Iterator, Sequence
import math

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.arrays import BodyMotions
from hnn_vi_ros.learning.families.choices import BodyStage
from hnn_vi_ros.learning.families.lie_group import BodyScales, LieGroupNetwork
from hnn_vi_ros.learning.fit.config import BodyConfig
from hnn_vi_ros.learning.fit.lie_steps import LieSteps, Node
from hnn_vi_ros.learning.fit.loop import Problem, Stage
import numpy as np
import torch

# Half of the range of what only rounding changes.
_LEAST = 1e-12


def network_of(config: BodyConfig, motions: Sequence[BodyMotions]) -> LieGroupNetwork:
    """Return the network of a configuration, with the scales of motions, or raise DataError."""
    k = 3 if config.kind == 'rotation' else 6
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
    card = config.family.card(config.kind, (1.0 / np.sqrt(inertia)).tolist(), driven)
    return LieGroupNetwork(card, config.hidden, scales, config.seed)


def _accelerations(motion: BodyMotions) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes and velocities, and the mean accelerations until the next instant."""
    states = torch.cat([motion.R[:-1].flatten(2), motion.v[:-1]], dim=2)
    rates = (motion.v[1:] - motion.v[:-1]) / motion.interval
    return states.flatten(0, 1).numpy(), rates.flatten(0, 1).numpy()


def _inputs(motions: Sequence[BodyMotions]) -> np.ndarray:
    return torch.cat([motion.u[:-1].flatten(0, 1) for motion in motions]).numpy()


def simulated(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> list[tuple[
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


def window_errors(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions
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


def published_loss(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> float:
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


def body_loss(network: LieGroupNetwork, config: BodyConfig, windows: BodyMotions) -> torch.Tensor:
    """Return the mean squared errors in units of the usual velocities."""
    errors, unit = window_errors(network, config, windows), network.velocity_unit.square()
    turning, total = unit[-1], []
    total.append(errors['turning'] / turning)
    total.append(errors['attitude'] / (config.time_scale**2 * turning))
    if 'place' in errors:
        total.append(errors['velocity'] / unit[0])
        total.append(errors['place'] / (config.time_scale**2 * unit[0]))
    return torch.stack(total).sum()


def joined(windows: Sequence[BodyMotions]) -> BodyMotions:
    """Return windows of one length and interval as one."""
    first = windows[0]
    for other in windows:
        if abs(other.interval - first.interval) > 0.01 * first.interval:
            raise DataError(f'motions are sampled every {first.interval:.4g} s and every '
                            f'{other.interval:.4g} s; take them one by one')
    x, R, v, u = (torch.cat(parts, dim=1) for parts in zip(
        *(other[:4] for other in windows), strict=True))
    return BodyMotions(x, R, v, u, first.interval)


class BodyProblem(Problem):
    """
    A network, and the stages that fit it to windows of motions: Adam on batches, L-BFGS on a part.

    Parameters
    ----------
    network : LieGroupNetwork
        Changed by a fit.
    config : BodyConfig
        Windows, learning rate and seed.
    motions : sequence of BodyMotions
        What to learn from.

    Raises
    ------
    DataError
        The motions are shorter than a window.

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
                            'lower learning_rate, take more substeps, and look for outliers in '
                            'the data'))
        if stage.lbfgs_steps:
            yield Stage(f'lbfgs_{stage.intervals}',
                        lambda: body_loss(self.module, self._config, chosen), stage.lbfgs_steps,
                        evaluations=2, begin=choose, remedy=(
                            'no step has a solution there: take more substeps, or adam_steps '
                            'before, and look for outliers in the data'))
