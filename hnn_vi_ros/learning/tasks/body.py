# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of bodies that turn, and judge them by windows that they have not seen."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
import json
from pathlib import Path

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.learning.data.arrays import BodyMotions, read_bodies
from hnn_vi_ros.learning.data.sources import one_file
from hnn_vi_ros.learning.families.lie_group import LieGroupNetwork
from hnn_vi_ros.learning.fit.body import (
    BodyProblem, joined, network_of, published_loss, window_errors)
from hnn_vi_ros.learning.fit.config import BodyConfig, find_config, load_config
from hnn_vi_ros.learning.fit.loop import Problem
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.learning.tasks.base import Task
from hnn_vi_ros.models.checkpoint import Checkpoint, load_checkpoint, widths_of
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard, Scheme
from hnn_vi_ros.version import __version__
import numpy as np
import torch

# A model is judged by windows of so many intervals, as published.
INTERVALS = 4
_UNITS = {'place': 'm', 'attitude': 'rad', 'velocity': 'm/s', 'turning': 'rad/s'}


class BodyTask(Task):
    """
    A model of a body that turns, trained on windows of its motions; see Task.

    Parameters
    ----------
    source : Path
        The file of the configuration.
    config : BodyConfig
        How to train.
    given : sequence of str
        A file that replaces that of the configuration.
    ensemble : bool
        Not for this family.

    """

    picture = 'windows'

    def __init__(self, source: Path, config: BodyConfig, given: Sequence[str], ensemble: bool):
        self._config = config
        self._train, test, self._description = read_bodies(
            one_file(source, config.data.path, given), config.data, config.kind)
        self._windows = _judged(test)

    def arrays(self) -> Iterator[np.ndarray]:
        """Yield the arrays of the motions to learn from; see Task."""
        return (part.numpy() for motion in self._train for part in motion[:4])

    def problem(self, config: BodyConfig, device: str) -> BodyProblem:
        """Return a fresh network with its stages; see Task."""
        return BodyProblem(network_of(config, self._train), config, self._train)

    def describe(self, problem: Problem, config: BodyConfig, name: str, command: str
                 ) -> Checkpoint:
        """Return a trained network with its card; see Task."""
        network = problem.module
        if _opens_scale(config, self._train):
            network.multiply(1.0 / _open_scale(network, self._train))
        return describe(network, config, self._train, self._description, problem.losses, name,
                        command)

    def combined(self, members: list[Checkpoint], name: str) -> Checkpoint:
        """Refuse: momenta of members have no mean; see Task."""
        raise AssertionError('an ensemble is refused before')

    def judged(self, checkpoint: Checkpoint, problem: Problem) -> Judged:
        """Return the model, and the errors of windows as text; see Task."""
        text = _text(problem.module, self._config, self._windows)
        return Judged(checkpoint, text, text)


def _opens_scale(config: BodyConfig, motions: Sequence[BodyMotions]) -> bool:
    """Return whether the motions leave the scale of energy open."""
    return config.family.input_map == 'learned' or not any(
        motion.u.any() for motion in motions)


def _open_scale(network: LieGroupNetwork, motions: Sequence[BodyMotions]) -> float:
    """Return the number to normalise: the RMS of the columns of B, or the mean inertia."""
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
        inverse = network.held(x, R, R.new_zeros((len(R), 0))).inverse
        inertia = torch.linalg.inv(inverse)[:, -3:, -3:]
        return float(inertia.diagonal(dim1=1, dim2=2).mean())


def describe(network: LieGroupNetwork, config: BodyConfig, motions: Sequence[BodyMotions],
             description: str, losses: dict[str, float], name: str, command: str) -> Checkpoint:
    """Return a trained network with its card."""
    layers, (own,) = network.layers(), config.coordinates
    with torch.no_grad():
        p = torch.cat([
            network.momenta(*(getattr(motion, part).flatten(0, 1) for part in 'xRv'))
            for motion in motions])
    x = torch.cat([motion.x.flatten(0, 1) for motion in motions])
    description = f'{config.description} {description}'.lstrip()
    if 'input_map' in network.features:
        description += ('; an input map was learned, which leaves the scale of energy open: the '
                        'mean square of its columns is 1')
    elif not any(motion.u.any() for motion in motions):
        description += ('; no inputs, which leaves the scale of energy open: the mean inertia is '
                        '1')
    # Every entry of an attitude can take any value; the last of the momenta stays zero.
    box = Box(q=[*_bounds(x), *[[-1.01, 1.01]] * 4], p=[*_bounds(p), [-1.0, 1.0]])
    card = ModelCard(
        name=name, family='lie_group', lie_group=network.card, **widths_of(layers),
        scheme=Scheme(integrator=config.method,
                      step_size=motions[0].interval / config.substeps),
        coordinates=[CoordinateCard(name=own.name, q_unit=own.q_unit, p_unit=own.p_unit)],
        box=box, dataset=description, seed=config.seed, losses=losses,
        training_command=command, package_version=__version__)
    return Checkpoint(card, layers)


def _bounds(values: torch.Tensor) -> list[list[float]]:
    low, high = values.min(dim=0).values, values.max(dim=0).values
    # What never moves still has an interval around it.
    least = 1e-6 * (1.0 + torch.maximum(low.abs(), high.abs()))
    found: list[list[float]] = torch.stack([low - least, high + least], dim=1).tolist()
    return found


def evaluate(arguments: Namespace) -> None:
    """Print the errors of a model's windows of its test data, and the loss as published."""
    model = load_checkpoint(arguments.model)
    if arguments.config is None:
        raise ParameterError(f'{arguments.model}: a model of the family lie_group is evaluated on '
                             'windows of the data of a training configuration; give it with '
                             '--config')
    if arguments.out is not None or arguments.baselines is not None:
        raise ParameterError('--out and --baselines: models of the family lie_group have none '
                             'yet; leave them out')
    source, group = find_config(arguments.config), model.card.lie_group
    config = load_config(source)
    assert group is not None, 'asked of such models alone'
    kind = config.kind if isinstance(config, BodyConfig) else config.family.kind
    if not isinstance(config, BodyConfig) or group.kind != kind:
        raise DataError(f'{source}: is for a {kind}, and {arguments.model} of a {group.kind}')
    file = one_file(source, config.data.path, arguments.data)
    _, test, description = read_bodies(file, config.data, group.kind)
    network, windows = LieGroupNetwork.of(model), _judged(test)
    driven = 'input_map' in network.features
    if driven and windows.u.shape[2] * group.size != len(model.networks['input_map'].biases[-1]):
        raise DataError(f'{file}: has {windows.u.shape[2]} inputs, which are not those of '
                        f'{arguments.model}')
    print(f'{arguments.model} on {description}\n{_text(network, config, windows)}')
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({
            'published_loss': published_loss(network, config, windows),
            'mean_square': _errors(network, config, windows)}, indent=2) + '\n',
            encoding='utf-8')


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
    return (f'windows of {len(windows.R) - 1} intervals of {windows.interval:.4g} s, '
            f'{windows.R.shape[1]} of them\nroot mean square errors: {parts}\n'
            f'loss as published: {published_loss(network, config, windows):.3g}')
