# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Turn a network of the original HNN code or of its forks into a model of ours.

They save the state_dict of a torch module, ``differentiable_model.linear1.weight``, ..., the last
layer without bias, of several outputs F:

    hnn              2 outputs, H = F_2 (F_1 is the conservative part, which has no H)
    sum_second_half  2 d outputs, H = F_(d+1) + ... + F_(2 d)

Nothing of the file but its tensors is unpickled. H is that of the source network: its unit, its
zero and its box are what its authors say they are.
"""

import argparse
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
import re
import shlex
import stat
import zipfile

from hnn_vi_ros.errors import ModelError, ParameterError
from hnn_vi_ros.hamiltonians.activations import ACTIVATIONS
from hnn_vi_ros.hamiltonians.checkpoint import Checkpoint, Layers, MAX_BYTES, save_checkpoint
from hnn_vi_ros.hamiltonians.model_card import Box, CoordinateCard, ModelCard
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.config import find_config, load_config
from hnn_vi_ros.learning.sources import make_dataset
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError
import torch

_NAME = re.compile(r'(.*\.)?linear([1-9]\d?)\.(weight|bias)')
_SHAPES = ('expected the state_dict of a network whose layers are named linear1, linear2, ... '
           'with weights and biases')


def read_layers(path: Path) -> Layers:
    """
    Read the layers of a network from a state_dict that torch.save wrote.

    Parameters
    ----------
    path : Path
        A file of at most 256 MiB, compressed or not.

    Returns
    -------
    Layers
        In float64; where the source has no bias, of zeros.

    Raises
    ------
    ModelError
        The file is missing or damaged, holds anything but tensors, which would have to be run to
        be read, or its tensors are not the layers of one network.

    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ModelError(f'{path}: not a regular file; give a file that torch.save wrote')
        if max(status.st_size, _unpacked_size(path)) > MAX_BYTES:
            raise ModelError(f'{path}: larger than {MAX_BYTES >> 20} MiB, which no model needs')
        state = torch.load(path, map_location='cpu', weights_only=True)
    except FileNotFoundError as problem:
        raise ModelError(f'{path}: no such file; give the file that torch.save wrote') from problem
    except ModelError:
        raise
    except Exception as problem:  # what damaged pickles raise has no common class
        first = str(problem).strip().split('\n')[0]
        raise ModelError(f'{path}: not a file of tensors alone that torch.save wrote '
                         f'({type(problem).__name__}: {first[:200]}); nothing in it was run; have '
                         'its author save the state_dict') from problem
    return _layers(path, state)


def _unpacked_size(path: Path) -> int:
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        return sum(member.file_size for member in archive.infolist())


def _layers(path: Path, state: object) -> Layers:
    found: dict[tuple[int, str], np.ndarray] = {}
    prefixes = set()
    for name, tensor in _items(path, state):
        match = _NAME.fullmatch(name)
        if match is None:
            raise ModelError(f'{path}: holds {name[:80]!r}; {_SHAPES}')
        prefixes.add(match[1] or '')
        found[int(match[2]), match[3]] = _array(path, name, tensor)
    if len(prefixes) != 1:
        raise ModelError(f'{path}: holds {len(prefixes)} networks '
                         f'({", ".join(sorted(prefixes)) or "none"}), expected one; {_SHAPES}')
    depth = max(layer for layer, _ in found)
    weights, biases = [], []
    for layer in range(1, depth + 1):
        weight = found.get((layer, 'weight'))
        if weight is None or weight.ndim != 2 or (
                weights and weight.shape[1] != weights[-1].shape[0]):
            raise ModelError(f'{path}: linear{layer}.weight is missing or does not fit the layer '
                             f'before; {_SHAPES}')
        bias = found.get((layer, 'bias'), np.zeros(len(weight)))
        if bias.shape != weight.shape[:1]:
            raise ModelError(f'{path}: linear{layer}.bias has shape {bias.shape}, expected '
                             f'{weight.shape[:1]}')
        weights.append(weight)
        biases.append(bias)
    return Layers(tuple(weights), tuple(biases))


def _items(path: Path, state: object) -> list[tuple[str, torch.Tensor]]:
    if not isinstance(state, Mapping) or not state or not all(
            isinstance(name, str) and isinstance(tensor, torch.Tensor)
            for name, tensor in state.items()):
        raise ModelError(f'{path}: holds {type(state).__name__}, not tensors by name; {_SHAPES}')
    return list(state.items())


def _array(path: Path, name: str, tensor: torch.Tensor) -> np.ndarray:
    # A tensor may claim to be larger than the memory behind it.
    if tensor.layout != torch.strided or tensor.numel() * 8 > MAX_BYTES:
        raise ModelError(f'{path}: {name} is no plain tensor of at most {MAX_BYTES >> 20} MiB')
    if not tensor.dtype.is_floating_point or not bool(torch.isfinite(tensor).all()):
        raise ModelError(f'{path}: {name} holds values that are not finite numbers')
    return tensor.detach().double().numpy().copy()


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
    if len(weights) < 2 or inputs % 2 or outputs != expected:
        raise ValueError(f'{len(weights)} layers, {inputs} inputs, {outputs} outputs; the layout '
                         f'{layout} has at least 2 layers, an even number of inputs and '
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
    layers = read_layers(arguments.file)
    try:
        layers = energy_layers(layers, arguments.layout, arguments.order)
    except ValueError as problem:
        raise ModelError(f'{arguments.file}: {problem}') from problem
    if layers.weights[0].shape[1] != 2 * len(names):
        raise ParameterError(
            f'--coordinates {arguments.coordinates}: {len(names)} names, but the network of '
            f'{arguments.file} has {layers.weights[0].shape[1] // 2} coordinates')
    card = _card(arguments, names, layers, shlex.join(
        ['ros2', 'run', 'hnn_vi_ros', 'import_checkpoint', *argv]))
    save_checkpoint(out, Checkpoint(card, {'energy': layers}))
    print(f'model: {out}')
    if not ACTIVATIONS[arguments.activation].smooth:
        print(f'warning: the gradient of a {arguments.activation} network jumps; no method keeps '
              'its order there')


def _card(arguments: argparse.Namespace, names: list[str], layers: Layers, command: str
          ) -> ModelCard:
    d, source = len(names), arguments.file
    if arguments.box is not None:
        box = parse_box(arguments.box, d)
    else:
        config = find_config(arguments.box_of)
        loaded = load_config(config)
        box = make_dataset(loaded.data, loaded.seed, config).box
    try:
        return ModelCard(
            name=source.stem, activation=arguments.activation, box=box, seed=0, losses={},
            widths=[layers.weights[0].shape[1], *map(len, layers.weights)],
            coordinates=[CoordinateCard(name=name) for name in names],
            dataset=f'unknown; imported from {source.name} '
                    f'(sha256 {sha256(source.read_bytes()).hexdigest()[:16]})',
            training_command=command, package_version=__version__)
    except ValidationError as problem:
        first = problem.errors()[0]
        raise ParameterError(
            f'--coordinates {",".join(names)}: {first["msg"]}') from problem
