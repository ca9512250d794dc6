# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train a model of a body that turns, and judge it by windows that it has not seen."""

from argparse import Namespace
from collections.abc import Sequence
import json
from pathlib import Path
import time

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.learning.data.body_data import Motions, read_bodies
from hnn_vi_ros.learning.families.lie_group import LieGroupNetwork
from hnn_vi_ros.learning.fit.body_config import BodyConfig, load_body
from hnn_vi_ros.learning.fit.body_training import (
    fit, joined, network_of, published_loss, window_errors)
from hnn_vi_ros.learning.fit.keeping import kept
from hnn_vi_ros.models.checkpoint import Checkpoint, load_checkpoint
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard, Scheme
from hnn_vi_ros.version import __version__
import torch

# What a model is judged by: windows of so many intervals, as published.
INTERVALS = 4
_UNITS = {'place': 'm', 'attitude': 'rad', 'velocity': 'm/s', 'turning': 'rad/s'}


def run(source: Path, arguments: Namespace, out: Path, command: str) -> None:
    """Train as a configuration and the command line say, and print what came of it."""
    config = load_body(source)
    if arguments.seed is not None:
        config = config.model_copy(update={'seed': arguments.seed})
    train, test, description = read_bodies(
        _file(source, config, arguments.data), config.data, config.coordinates[0].kind)
    held_out = _judged(test)
    begun = time.perf_counter()
    network, losses = learn(config, train)
    seconds = time.perf_counter() - begun
    with kept(out, describe(network, config, train, description, losses, out.stem, command)):
        text = _text(network, config, held_out)
    print(f'model: {out}\n{text}\ntrained in {seconds:.1f} s')


def learn(config: BodyConfig, motions: Sequence[Motions]) -> tuple[
        LieGroupNetwork, dict[str, float]]:
    """Return a trained network with its losses; where the scale of energy is open, it is fixed."""
    network = network_of(config, motions)
    losses = fit(network, config, motions)
    if config.family.input_map == 'learned' or not any(motion.u.any() for motion in motions):
        network.multiply(1.0 / _open_scale(network, motions))
    return network, losses


def _open_scale(network: LieGroupNetwork, motions: Sequence[Motions]) -> float:
    """Return what is made 1: the root mean square of columns of B, or the mean of inertias."""
    R = torch.cat([motion.R.flatten(0, 1) for motion in motions])
    x = torch.cat([motion.x.flatten(0, 1) for motion in motions])
    count = motions[0].u.shape[2] if 'input_map' in network.seen else 0
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


def describe(network: LieGroupNetwork, config: BodyConfig, motions: Sequence[Motions],
             description: str, losses: dict[str, float], name: str, command: str) -> Checkpoint:
    """Return a trained network with its card."""
    layers, (own,) = network.layers(), config.coordinates
    with torch.no_grad():
        p = torch.cat([
            network.momenta(*(getattr(motion, part).flatten(0, 1) for part in 'xRv'))
            for motion in motions])
    x = torch.cat([motion.x.flatten(0, 1) for motion in motions])
    description = f'{config.description} {description}'.lstrip()
    if 'input_map' in network.seen:
        description += ('; an input map was learned, which leaves the scale of energy open: the '
                        'mean square of its columns is 1')
    elif not any(motion.u.any() for motion in motions):
        description += ('; no inputs, which leaves the scale of energy open: the mean inertia is '
                        '1')
    # Of an attitude all columns can be anything; the last of the momenta stays zero.
    box = Box(q=[*_bounds(x), *[[-1.01, 1.01]] * 4], p=[*_bounds(p), [-1.0, 1.0]])
    card = ModelCard(
        name=name, family='lie_group', lie_group=network.card,
        networks={key: [part.weights[0].shape[1], *(len(bias) for bias in part.biases)]
                  for key, part in layers.items()},
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
    return torch.stack([low - least, high + least], dim=1).tolist()


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
    config = load_body(arguments.config)
    group = model.card.lie_group
    assert group is not None, 'asked of such models alone'
    if group.kind != config.coordinates[0].kind:
        raise DataError(f'{arguments.config}: is for a {config.coordinates[0].kind}, and '
                        f'{arguments.model} of a {group.kind}')
    _, test, description = read_bodies(Path(arguments.data[0]), config.data, group.kind)
    network, windows = LieGroupNetwork.of(model), _judged(test)
    driven = 'input_map' in network.seen
    if driven and windows.u.shape[2] * group.size != len(model.networks['input_map'].biases[-1]):
        raise DataError(f'{arguments.data[0]}: has {windows.u.shape[2]} inputs, which are not '
                        f'those of {arguments.model}')
    print(f'{arguments.model} on {description}\n{_text(network, config, windows)}')
    if arguments.json is not None:
        with torch.no_grad():
            errors = {name: float(value) for name, value in
                      window_errors(network, config, windows).items()}
        arguments.json.write_text(json.dumps({
            'published_loss': published_loss(network, config, windows),
            'mean_square': errors}, indent=2) + '\n', encoding='utf-8')


def _judged(motions: Sequence[Motions]) -> Motions:
    count = min(INTERVALS, *(len(motion.R) - 1 for motion in motions))
    return joined([motion.windows(count) for motion in motions])


def _text(network: LieGroupNetwork, config: BodyConfig, windows: Motions) -> str:
    with torch.no_grad():
        errors = window_errors(network, config, windows)
    parts = ', '.join(f'{name} {float(value)**0.5:.3g} {_UNITS[name]}'
                      for name, value in errors.items())
    return (f'windows of {len(windows.R) - 1} intervals of {windows.interval:.4g} s, '
            f'{windows.R.shape[1]} of them\nroot mean square errors: {parts}\n'
            f'loss as published: {published_loss(network, config, windows):.3g}')


def _file(source: Path, config: BodyConfig, given: Sequence[str]) -> Path:
    if len(given) > 1 or not (given or config.data.path):
        raise DataError(f'{source}: expected one file, in data.path or with --data FILE; it has '
                        f'{len(given)}')
    if given:
        return Path(given[0])
    beside = source.parent / config.data.path
    return beside if beside.exists() else Path(config.data.path)
