# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of rotating bodies on windows of motions, and judge them on other windows."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import replace
import json
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import write_text
from hnn_vi_ros.learning.data.arrays import BodyMotions, read_bodies
from hnn_vi_ros.learning.data.sources import one_file
from hnn_vi_ros.learning.families.lie_group import HeldBody, LieGroupNetwork
from hnn_vi_ros.learning.fit.body import fit_body, joined, window_errors
from hnn_vi_ros.learning.fit.config import BodyConfig, find_config, load_config
from hnn_vi_ros.learning.fit.loop import Fitted, Train, trained
from hnn_vi_ros.learning.fit.model_files import described
from hnn_vi_ros.learning.judging.report import Judged
from hnn_vi_ros.learning.tasks import OPEN_BY_MAP, TrainingTask
from hnn_vi_ros.models import Box, Checkpoint, group_of, load_checkpoint, Scheme
import numpy as np
import torch

# Number of intervals per test window, as in the publications.
INTERVALS = 4
_UNITS = {'place': 'm', 'attitude': 'rad', 'velocity': 'm/s', 'turning': 'rad/s'}


class BodyData(NamedTuple):
    """
    Motions of a rotating body.

    Parameters
    ----------
    config : BodyConfig
        Configuration of the training.
    train : sequence of BodyMotions
        Training motions.
    windows : BodyMotions
        Windows of the test motions.
    description : str
        Description of the data.

    """

    config: BodyConfig
    train: Sequence[BodyMotions]
    windows: BodyMotions
    description: str

    @property
    def arrays(self) -> Iterator[np.ndarray]:
        """Return the arrays of the training motions, which identify an interrupted run."""
        return (part.numpy() for motion in self.train for part in motion[:4])

    @property
    def box(self) -> None:
        """Return None: there are no ensembles of bodies."""


def read(source: Path, config: BodyConfig, given: Sequence[str], ensemble: bool) -> BodyData:
    """Read the motions of a configuration, or of a given file in their place."""
    train, test, description = read_bodies(
        one_file(source, config.data.path, given), config.data, config.kind)
    return BodyData(config, train, _judged(test), description)


def fit(data: BodyData, config: BodyConfig, device: str, train: Train = trained) -> Fitted:
    """Fit a network, with its energy scale fixed."""
    fitted = fit_body(config, data.train, train)
    if not _scale_note(fitted.module, data.train):
        return fitted
    size = _size_to_normalise(fitted.module, data.train)
    return replace(fitted, module=fitted.module.scaled(1.0 / size))


def describe(data: BodyData, fitted: Fitted, config: BodyConfig, name: str, command: str
             ) -> Checkpoint:
    """Return a trained network with its card."""
    network = fitted.module
    with torch.no_grad():
        p = torch.cat([
            network.momenta(*(getattr(motion, part).flatten(0, 1) for part in 'xRv'))
            for motion in data.train])
    x = torch.cat([motion.x.flatten(0, 1) for motion in data.train])
    # Entries of attitudes are unrestricted; the last momentum component stays zero.
    box = Box(q=[*_bounds(x), *[[-1.01, 1.01]] * 4], p=[*_bounds(p), [-1.0, 1.0]])
    scheme = Scheme(integrator=config.method, step_size=data.train[0].interval / config.substeps)
    return described(
        config, network.layers(), name, command, family='lie_group', lie_group=network.card,
        scheme=scheme, box=box, dataset=f'{config.description} {data.description}'.lstrip()
        + _scale_note(network, data.train), losses=fitted.losses)


def judge(data: BodyData, checkpoint: Checkpoint, fitted: Fitted) -> Judged:
    """Return the model with window errors as text."""
    text = _text(fitted.module, data.config, data.windows)
    return Judged(checkpoint, text, text)


BODY = TrainingTask('windows', read, lambda data: data, fit, describe, judge)


def _size_to_normalise(network: LieGroupNetwork, motions: Sequence[BodyMotions]) -> float:
    """Return the quantity to normalise: the RMS column of B, or the mean inertia."""
    R = torch.cat([motion.R.flatten(0, 1) for motion in motions])
    x = torch.cat([motion.x.flatten(0, 1) for motion in motions])
    with torch.no_grad():
        if 'input_map' in network.features:
            forces = [network.inputs(x, R, unit.expand(len(R), -1)) for unit in
                      torch.eye(motions[0].u.shape[2], dtype=R.dtype)]
            squares = torch.stack([force.square().sum(dim=1).mean()
                                   for force in forces if force is not None])
            return float(squares.mean().sqrt())
        inverse = HeldBody(network, x, R, R.new_zeros((len(R), 0))).inverse
        inertia = torch.linalg.inv(inverse)[:, -3:, -3:]
        return float(inertia.diagonal(dim1=1, dim2=2).mean())


def _scale_note(network: LieGroupNetwork, motions: Sequence[BodyMotions]) -> str:
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
    return torch.stack([low - least, high + least], dim=1).tolist()


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
