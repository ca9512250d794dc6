# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a network of the original HNN code or of its forks to a model of this package.

These programs save the state_dict of a torch module, ``differentiable_model.linear1.weight``, ...;
the last layer has no bias, and there are several outputs F:

    hnn              2 outputs, H = F_2 (F_1 is the conservative part, which has no H)
    sum_second_half  2 d outputs, H = F_(d+1) + ... + F_(2 d)

Only tensors are unpickled from the file. Unit, zero and domain of H are the ones that the authors
of the source network state.

The public Lie-group Hamiltonian code saves one state_dict with several tanh networks of layers
linear1, linear2, ..., for the family lie_group:

    so3    M_net, V_net, g_net, and Dw_net with friction; the inputs of all are R row by row
    se3    M_net1 and Dv_net with input x; M_net2 and Dw_net with input R; V_net and g_net: both

Networks of matrices return a lower triangular L, the diagonal first and then the entries below it
by rows, with M^-1 = (L + sqrt(epsilon)) (L + sqrt(epsilon))^T + floor, and D = L L^T. The family's
networks have the same form with entries in another order; two networks with different inputs
become one network with block-diagonal layers.

References
----------
T. Duong, A. Altawaitan, J. Stanley, N. Atanasov, Port-Hamiltonian Neural ODE Networks on Lie
Groups for Robot Dynamics Learning and Control, IEEE Trans. Robot. 40 (2024).

"""

import argparse
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
import re
import shlex
from typing import Any
import zipfile

from hnn_vi_ros.errors import listed, ModelError, ParameterError
from hnn_vi_ros.files import check_pickles, in_plain_words, no_file, refuse_pointer
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.fit.config import FieldConfig, find_config, load_config
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, Layers, LieGroupCard, ModelCard, save_checkpoint, SMOOTH,
    widths_of)
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError
from scipy.linalg import block_diag
import torch

# Maximum size of the file, of its unpacked content, and of all tensors in double precision.
MAX_BYTES = 64 << 20
_TYPES = (torch.float64, torch.float32, torch.float16, torch.bfloat16)
_NAME = re.compile(r'(.*\.)?linear([1-9]\d?)\.(weight|bias)')
_SHAPES = ('expected the state_dict of a network whose layers are named linear1, linear2, ... '
           'with weights and biases')


def read_layers(path: Path) -> Layers:
    """
    Read the layers of one network from a state_dict saved by torch.save; see read_networks.

    Raises
    ------
    ModelError
        As for read_networks, or the file contains several networks.

    """
    networks = read_networks(path)
    if len(networks) != 1:
        names = listed(f'{name}.linear1' if name else 'linear1' for name in sorted(networks))
        raise ModelError(f'{path}: holds {len(networks)} networks ({names}), expected one; '
                         f'{_SHAPES}')
    (layers,) = networks.values()
    return layers


def read_networks(path: Path) -> dict[str, Layers]:
    """
    Read the layers of all networks from a state_dict saved by torch.save.

    Parameters
    ----------
    path : Path
        File of at most 64 MiB, also unpacked, as are its tensors in double precision.

    Returns
    -------
    dict of str to Layers
        Layers in float64, keyed by the prefix of the layer names, '' for none; missing biases are
        zero.

    Raises
    ------
    ModelError
        The file is missing or damaged, contains anything but tensors, which would require code to
        be run, or the tensors are not layers of networks.

    """
    try:
        if not path.is_file():
            raise ModelError(f'{path}: {no_file(path)}; give a file that torch.save wrote')
        with path.open('rb') as stream:
            refuse_pointer(stream.read(32), path, ModelError)
        if max(path.stat().st_size, _unpacked_size(path)) > MAX_BYTES:
            raise ModelError(f'{path}: larger than {MAX_BYTES >> 20} MiB, which no network needs')
        check_pickles(path)
        state = torch.load(path, map_location='cpu', weights_only=True)
    except ModelError:
        raise
    except Exception as problem:  # damaged pickles raise exceptions without a common base class
        first = str(problem).strip().split('\n')[0]
        raise ModelError(f'{path}: not a file of tensors alone that torch.save wrote '
                         f'({type(problem).__name__}: {first[:200]}); nothing in it was run; have '
                         'its author save the state_dict') from problem
    return _networks(path, state)


def _unpacked_size(path: Path) -> int:
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        return sum(member.file_size for member in archive.infolist())


def _networks(path: Path, state: object) -> dict[str, Layers]:
    found: dict[str, dict[tuple[int, str], np.ndarray]] = {}
    if not isinstance(state, Mapping) or not state or not all(
            isinstance(name, str) and isinstance(tensor, torch.Tensor)
            for name, tensor in state.items()):
        raise ModelError(f'{path}: holds {type(state).__name__}, not tensors by name; {_SHAPES}')
    _check_tensors(path, state)
    for name, tensor in state.items():
        match = _NAME.fullmatch(name)
        if match is None:
            raise ModelError(f'{path}: holds {name[:80]!r}; {_SHAPES}')
        array = tensor.detach().resolve_neg().double().numpy().copy()
        if not np.isfinite(array).all():
            raise ModelError(f'{path}: {name} holds values that are not finite numbers')
        network = found.setdefault((match[1] or '').removesuffix('.'), {})
        network[int(match[2]), match[3]] = array
    return {name: _layers(path, f'{name}.' if name else '', network)
            for name, network in found.items()}


def _layers(path: Path, prefix: str, found: dict[tuple[int, str], np.ndarray]) -> Layers:
    depth = max(layer for layer, _ in found)
    weights, biases = list[np.ndarray](), list[np.ndarray]()
    for layer in range(1, depth + 1):
        name, weight = f'{prefix}linear{layer}', found.get((layer, 'weight'))
        if weight is None or weight.ndim != 2 or not weight.size or (
                weights and weight.shape[1] != weights[-1].shape[0]):
            raise ModelError(f'{path}: {name}.weight is missing or does not fit the layer '
                             f'before; {_SHAPES}')
        bias = found.get((layer, 'bias'), np.zeros(len(weight)))
        if bias.shape != weight.shape[:1]:
            raise ModelError(f'{path}: {name}.bias has shape {bias.shape}, expected '
                             f'{weight.shape[:1]}')
        weights.append(weight)
        biases.append(bias)
    return Layers(tuple(weights), tuple(biases))


def _check_tensors(path: Path, tensors: Mapping[str, torch.Tensor]) -> None:
    """Check, before copying, that there are only plain real tensors, and not too many."""
    total = 0
    for name, tensor in tensors.items():
        kinds = {'a meta tensor, without values': tensor.is_meta,
                 'a nested tensor': tensor.is_nested,
                 'a sparse tensor': tensor.layout != torch.strided,
                 'quantised': tensor.is_quantized,
                 'complex': tensor.is_complex(),
                 f'of type {tensor.dtype}': tensor.dtype not in _TYPES}
        if kind := next((kind for kind, found in kinds.items() if found), None):
            raise ModelError(f'{path}: {name[:80]} is {kind}; expected a plain tensor of real '
                             'numbers, float64, float32, float16 or bfloat16')
        # A tensor may claim a shape larger than its storage.
        total += 8 * tensor.numel()
    if total > MAX_BYTES:
        raise ModelError(f'{path}: its tensors take more than {MAX_BYTES >> 20} MiB in double '
                         'precision, which no network needs')


BODIES = ('so3', 'se3')
# Index of each output of this package, L by rows, in the outputs of the source.
_ORDER = [0, 3, 1, 4, 5, 2]
_ON_DIAGONAL = [0, 2, 5]
# Inputs of the source networks for each network here; matrices have one per 3 x 3 block.
_SOURCES = {
    'so3': {'mass': {'M_net': 9}, 'potential': {'V_net': 9}, 'dissipation': {'Dw_net': 9},
            'input_map': {'g_net': 9}},
    'se3': {'mass': {'M_net1': 3, 'M_net2': 9}, 'potential': {'V_net': 12},
            'dissipation': {'Dv_net': 3, 'Dw_net': 9}, 'input_map': {'g_net': 12}}}
# Outputs of each source network; 0 means one column of B per input.
_OUTPUTS = {'mass': 6, 'potential': 1, 'dissipation': 6, 'input_map': 0}


def body_networks(found: Mapping[str, Layers], layout: str, epsilon: float, floor: float
                  ) -> tuple[LieGroupCard, dict[str, Layers]]:
    """
    Return the card and the networks of a body.

    Parameters
    ----------
    found : mapping of str to Layers
        Networks of a file, keyed by the prefix of their layer names.
    layout : str
        Name of the layout, one of BODIES.
    epsilon : float
        Number whose square root is added to the diagonal of the root of M^-1 [1].
    floor : float
        Number added to the diagonal of M^-1 [1].

    Raises
    ------
    ValueError
        Networks are missing or unexpected, or one has the wrong number of inputs or outputs.

    """
    names = {name.removesuffix('.mlp'): layers for name, layers in found.items()}
    sources = _SOURCES[layout]
    needed = {name for network in ('mass', 'potential', 'input_map') for name in sources[network]}
    friction = needed < names.keys()
    if names.keys() != needed | (sources['dissipation'].keys() if friction else set()):
        raise ValueError(f'networks {listed(sorted(names)) or "none"}; the layout {layout} has '
                         f'{", ".join(sorted(needed))}, and for friction '
                         f'{", ".join(sources["dissipation"])}')
    seen: list[Any] = ['attitude'] if layout == 'so3' else ['position', 'attitude']
    size = 3 * len(seen)
    card = LieGroupCard(
        kind='rotation' if layout == 'so3' else 'pose', mass_scale=[1.0] * size, floor=floor,
        diagonal='any', mass_depends_on=seen, potential_depends_on=seen,
        dissipation_depends_on=seen if friction else None, input_map_depends_on=seen)
    networks = {}
    for network, own in sources.items():
        if network == 'dissipation' and not friction:
            continue
        for name, inputs in own.items():
            _check(name, names[name], inputs, _OUTPUTS[network], size)
        layers = [names[name] for name in own]
        if network in ('mass', 'dissipation'):
            layers = [_root(one, epsilon if network == 'mass' else 0.0) for one in layers]
        networks[network] = _blocks(layers)
    return card, networks


def _check(name: str, layers: Layers, inputs: int, outputs: int, size: int) -> None:
    first, last = layers.weights[0].shape[1], len(layers.weights[-1])
    if first != inputs or (last != outputs if outputs else last % size):
        raise ValueError(f'{name} has {first} inputs and {last} outputs, expected {inputs} and '
                         f'{outputs or f"a multiple of {size}"}')


def _root(layers: Layers, epsilon: float) -> Layers:
    """Reorder the outputs of a network from diagonal-first to L by rows, and add sqrt(epsilon)."""
    weights, biases = list(layers.weights), list(layers.biases)
    weights[-1], biases[-1] = weights[-1][_ORDER], biases[-1][_ORDER]
    biases[-1][_ON_DIAGONAL] += np.sqrt(epsilon)
    return Layers(tuple(weights), tuple(biases))


def _blocks(networks: Sequence[Layers]) -> Layers:
    """Join networks with the same number of layers into one with block-diagonal weights."""
    if len({len(layers.weights) for layers in networks}) > 1:
        raise ValueError('the networks of the two blocks have different numbers of layers')
    return Layers(
        tuple(block_diag(*weights) for weights in zip(
            *(layers.weights for layers in networks), strict=True)),
        tuple(np.concatenate(biases) for biases in zip(
            *(layers.biases for layers in networks), strict=True)))


_OTHER_STATE = ('a network of another state, such as (q, dq/dt), (cos q, sin q, p) or (q, p, t), '
                'is no H(q, p) and cannot be imported')


def energy_layers(layers: Layers, layout: str, order: str = 'qp') -> Layers:
    """
    Return the network of H(q, p) only.

    Parameters
    ----------
    layers : Layers
        Layers of the source network.
    layout : str
        Layout that selects the outputs of H: ``'hnn'`` or ``'sum_second_half'``.
    order : str
        Order of the inputs: ``'qp'`` or ``'pq'``.

    Raises
    ------
    ValueError
        The number of inputs or outputs does not fit the layout.

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
    Parse the box given by ``--box``.

    Parameters
    ----------
    text : str
        ``LOW:HIGH`` for each coordinate and then for each momentum, separated by commas, or one
        interval for all.
    d : int
        Number of coordinates.

    Raises
    ------
    ParameterError
        The text is not such a list.

    """
    try:
        bounds = [[float(bound) for bound in part.split(':')] for part in text.split(',')]
        bounds = bounds * (2 * d) if len(bounds) == 1 else bounds
        if len(bounds) != 2 * d:
            raise ValueError(f'{len(bounds)} intervals')
        return Box(q=bounds[:d], p=bounds[d:])
    except ValueError as problem:
        detail = in_plain_words(problem) if isinstance(problem, ValidationError) else problem
        raise ParameterError(
            f'--box {text}: {detail}; expected LOW:HIGH for each of {d} coordinates and {d} '
            'momenta, as in --box=-1:1,-2:2, or one for all') from problem


def main(argv: Sequence[str]) -> None:
    """Import a network with the options of the command line."""
    arguments = command_lines.import_checkpoint().parse_args(argv)
    names = arguments.coordinates.split(',')
    out = arguments.out or Path('models') / f'{arguments.file.stem}.safetensors'
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'import_checkpoint', *argv])
    make = _body if arguments.layout in BODIES else _energy
    save_checkpoint(out, make(arguments, names, command))
    print(f'model: {out}')
    if not SMOOTH[arguments.activation]:
        print(f'warning: the gradient of a {arguments.activation} network jumps; no method keeps '
              'its order there')


def _energy(arguments: argparse.Namespace, names: list[str], command: str) -> Checkpoint:
    """Return the model of a network of H."""
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
    return Checkpoint(_energy_card(arguments, names, layers, command), {'energy': layers})


def _body(arguments: argparse.Namespace, names: list[str], command: str) -> Checkpoint:
    """Return the model of a rotating body."""
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
        card = _card(arguments, names, networks, command, family='lie_group', lie_group=group,
                     box=parse_box(arguments.box, group.size + 1))
    except ValidationError as problem:
        raise ModelError(f'{source}: {in_plain_words(problem)}') from problem
    except ValueError as problem:
        raise ModelError(f'{source}: {problem}') from problem
    return Checkpoint(card, networks)


def _energy_card(arguments: argparse.Namespace, names: list[str], layers: Layers, command: str
                 ) -> ModelCard:
    if arguments.box is not None:
        box = parse_box(arguments.box, len(names))
    else:
        config = find_config(arguments.box_of)
        loaded = load_config(config)
        if not isinstance(loaded, FieldConfig):
            raise ParameterError(f'--box-of {arguments.box_of}: its data hold no momenta; give '
                                 '--box')
        box = make_dataset(loaded.data, loaded.seed, config).box
    try:
        return _card(arguments, names, {'energy': layers}, command,
                     activation=arguments.activation, box=box)
    except ValidationError as problem:
        first = problem.errors()[0]
        if first['loc'][:1] == ('widths',):
            raise ModelError(f'{arguments.file}: a layer of width {first["input"]}: '
                             f'{in_plain_words(problem)}') from problem
        raise ParameterError(
            f'--coordinates {",".join(names)}: {in_plain_words(problem)}') from problem


def _card(arguments: argparse.Namespace, names: list[str], networks: Mapping[str, Layers],
          command: str, **own: Any) -> ModelCard:
    source = arguments.file
    digest = sha256(source.read_bytes()).hexdigest()
    return ModelCard(
        name=source.stem, seed=0, losses={}, training_command=command,
        coordinates=[CoordinateCard(name=name) for name in names],
        dataset=f'unknown; imported from {source.name} (sha256 {digest[:16]})',
        package_version=__version__, **widths_of(networks), **own)
