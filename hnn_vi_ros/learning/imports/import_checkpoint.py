# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Turn a network of the original HNN code or of its forks into a model of ours.

They save the state_dict of a torch module, ``differentiable_model.linear1.weight``, ..., the last
layer without bias, of several outputs F:

    hnn              2 outputs, H = F_2 (F_1 is the conservative part, which has no H)
    sum_second_half  2 d outputs, H = F_(d+1) + ... + F_(2 d)

and the public Lie-group Hamiltonian code several networks of a body, see import_body. Nothing of
the file but its tensors is unpickled. H is that of the source network: its unit, its
zero and its box are what its authors say they are.
"""

import argparse
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
import shlex

from hnn_vi_ros.errors import ModelError, ParameterError
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.fit.config import FieldConfig, find_config, load_config
from hnn_vi_ros.learning.imports.import_body import BODIES, body_networks
from hnn_vi_ros.learning.imports.state_dict import read_layers, read_networks
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers, save_checkpoint
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard
from hnn_vi_ros.networks.activations import ACTIVATIONS
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError

_OTHER_STATE = ('a network of another state, such as (q, dq/dt), (cos q, sin q, p) or (q, p, t), '
                'is no H(q, p) and cannot be imported')


def energy_layers(layers: Layers, layout: str, order: str = 'qp') -> Layers:
    """
    Return the network of H(q, p) alone.

    Parameters
    ----------
    layers : Layers
        Of the source network.
    layout : str
        Which of its outputs are H: ``'hnn'`` or ``'sum_second_half'``.
    order : str
        Of its inputs: ``'qp'`` or ``'pq'``.

    Raises
    ------
    ValueError
        The network has another number of inputs or outputs than the layout.

    """
    weights, biases = list(layers.weights), list(layers.biases)
    inputs, outputs = weights[0].shape[1], len(weights[-1])
    expected = 2 if layout == 'hnn' else inputs
    if inputs % 2:
        raise ValueError(f'{inputs} inputs, an odd number, so that its state is not (q, p), of a '
                         f'momentum for each coordinate; {_OTHER_STATE}')
    if len(weights) < 2 or outputs != expected:
        raise ValueError(f'{len(weights)} layers, {inputs} inputs, {outputs} outputs; the layout '
                         f'{layout} has at least 2 layers and '
                         f'{"2" if layout == "hnn" else "as many"} outputs')
    weights[-1] = weights[-1][outputs // 2:].sum(axis=0, keepdims=True)
    biases[-1] = biases[-1][outputs // 2:].sum(axis=0, keepdims=True)
    if order == 'pq':
        weights[0] = np.roll(weights[0], inputs // 2, axis=1)
    return Layers(tuple(weights), tuple(biases))


def parse_box(text: str, d: int) -> Box:
    """
    Return the box that ``--box`` describes.

    Parameters
    ----------
    text : str
        ``LOW:HIGH`` for each coordinate and then for each momentum, separated by commas, or one
        for all.
    d : int
        Number of coordinates.

    Raises
    ------
    ParameterError
        It is none.

    """
    try:
        bounds = [[float(bound) for bound in part.split(':')] for part in text.split(',')]
        bounds = bounds * (2 * d) if len(bounds) == 1 else bounds
        if len(bounds) != 2 * d:
            raise ValueError(f'{len(bounds)} intervals')
        return Box(q=bounds[:d], p=bounds[d:])
    except ValueError as problem:
        detail = (problem.errors()[0]['msg'] if isinstance(problem, ValidationError)
                  else str(problem))
        raise ParameterError(
            f'--box {text}: {detail}; expected LOW:HIGH for each of {d} coordinates and {d} '
            'momenta, as in --box=-1:1,-2:2, or one for all') from problem


def main(argv: Sequence[str]) -> None:
    """Import a network as the command line says."""
    arguments = command_lines.import_checkpoint().parse_args(argv)
    names = arguments.coordinates.split(',')
    out = arguments.out or Path('models') / f'{arguments.file.stem}.safetensors'
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'import_checkpoint', *argv])
    if arguments.layout in BODIES:
        save_checkpoint(out, _body(arguments, names, command))
        print(f'model: {out}')
        return
    if arguments.epsilon is not None or arguments.floor:
        raise ParameterError(f'--epsilon, --floor: of the layouts {", ".join(BODIES)} alone; '
                             f'leave them with --layout {arguments.layout}')
    layers = read_layers(arguments.file)
    try:
        layers = energy_layers(layers, arguments.layout, arguments.order)
    except ValueError as problem:
        raise ModelError(f'{arguments.file}: {problem}') from problem
    if layers.weights[0].shape[1] != 2 * len(names):
        raise ParameterError(
            f'--coordinates {arguments.coordinates}: {len(names)} names, but the network of '
            f'{arguments.file} takes {layers.weights[0].shape[1]} inputs: '
            f'{layers.weights[0].shape[1] // 2} coordinates and as many momenta, if its state is '
            f'(q, p); {_OTHER_STATE}')
    card = _card(arguments, names, layers, command)
    save_checkpoint(out, Checkpoint(card, {'energy': layers}))
    print(f'model: {out}')
    if not ACTIVATIONS[arguments.activation].smooth:
        print(f'warning: the gradient of a {arguments.activation} network jumps; no method keeps '
              'its order there')


def _body(arguments: argparse.Namespace, names: list[str], command: str) -> Checkpoint:
    """Return the model of a body that turns."""
    epsilon, floor, source = arguments.epsilon, arguments.floor, arguments.file
    if epsilon is None:
        raise ParameterError(f'--epsilon: give it with --layout {arguments.layout}; the file does '
                             "not say; that code's examples take 0.1 for so3 and 0.01 for se3")
    wrong = [
        (arguments.box is None, '--box-of: not of bodies that turn; give --box'),
        (arguments.order != 'qp', '--order pq: not of bodies that turn; leave it'),
        (arguments.activation != 'tanh',
         f'--activation {arguments.activation}: networks of bodies that turn have tanh'),
        (len(names) != 1, f'--coordinates {arguments.coordinates}: {len(names)} names, expected '
                          'one, of the body')]
    wrong += [(not 0.0 <= value < np.inf, f'{option} {value}: expected a finite number >= 0')
              for option, value in (('--epsilon', epsilon), ('--floor', floor))]
    for problem in (text for found, text in wrong if found):
        raise ParameterError(problem)
    try:
        group, networks = body_networks(read_networks(source), arguments.layout, epsilon, floor)
        d = group.size + 1
        card = ModelCard(
            name=source.stem, family='lie_group', lie_group=group, seed=0, losses={},
            box=parse_box(arguments.box, d), coordinates=[CoordinateCard(name=names[0])],
            networks={name: [layers.weights[0].shape[1], *map(len, layers.weights)]
                      for name, layers in networks.items()},
            dataset=_origin(source), training_command=command, package_version=__version__)
    except ValidationError as problem:
        raise ModelError(f'{source}: {problem.errors()[0]["msg"]}') from problem
    except ValueError as problem:
        raise ModelError(f'{source}: {problem}') from problem
    return Checkpoint(card, networks)


def _origin(source: Path) -> str:
    return (f'unknown; imported from {source.name} '
            f'(sha256 {sha256(source.read_bytes()).hexdigest()[:16]})')


def _card(arguments: argparse.Namespace, names: list[str], layers: Layers, command: str
          ) -> ModelCard:
    d, source = len(names), arguments.file
    if arguments.box is not None:
        box = parse_box(arguments.box, d)
    else:
        config = find_config(arguments.box_of)
        loaded = load_config(config)
        if not isinstance(loaded, FieldConfig):
            raise ParameterError(f'--box-of {arguments.box_of}: its data hold no momenta; give '
                                 '--box')
        box = make_dataset(loaded.data, loaded.seed, config).box
    try:
        return ModelCard(
            name=source.stem, activation=arguments.activation, box=box, seed=0, losses={},
            widths=[layers.weights[0].shape[1], *map(len, layers.weights)],
            coordinates=[CoordinateCard(name=name) for name in names],
            dataset=_origin(source), training_command=command, package_version=__version__)
    except ValidationError as problem:
        first = problem.errors()[0]
        if first['loc'][:1] == ('widths',):
            raise ModelError(f'{source}: a layer of width {first["input"]}: {first["msg"]}'
                             ) from problem
        raise ParameterError(
            f'--coordinates {",".join(names)}: {first["msg"]}') from problem
