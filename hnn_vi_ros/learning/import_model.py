# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a torch module of others to a model of this package: ``hnn import``.

The module comes from a function of the user, ``module.py:make``, with the weights of a file, or
from the file alone if it contains the layers of a multilayer perceptron. It is exported as a
graph; see learning.export_module. Only tensors are unpickled from files.

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
import shlex
from typing import Any
import zipfile

from hnn_vi_ros.errors import listed, ModelError, ParameterError
from hnn_vi_ros.files import in_plain_words, no_file, one_line, refuse_pointer
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.export_module import export
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, Layers, LieGroupCard, ModelCard, Network, save_checkpoint,
    widths_of)
from hnn_vi_ros.scene import load_code
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import ValidationError
from scipy.linalg import block_diag
import torch

# Maximum size of the file, of its unpacked content, and of all tensors in double precision.
MAX_BYTES = 64 << 20
_TYPES = (torch.float64, torch.float32, torch.float16, torch.bfloat16)
# Prefixes that wrappers of modules add to all names.
_PREFIXES = ('module.', '_orig_mod.', 'module.')
_SAVE = 'save the state_dict of the module'
_BY_CODE = 'give the module itself, as module.py:make with --weights'
_BODY_FILE = 'give the state_dict of tanh networks of linear layers'


def read_state(path: Path) -> tuple[dict[str, torch.Tensor], str]:
    """
    Read the tensors of a state_dict saved by torch.save.

    Parameters
    ----------
    path : Path
        File of at most 64 MiB, also unpacked, as are its tensors in double precision.

    Returns
    -------
    dict of str to torch.Tensor, and str
        The tensors by name, without a prefix such as ``module.``, and the key of a checkpoint
        under which they were, '' for none.

    Raises
    ------
    ModelError
        The file is missing or damaged, contains code, or no tensors by name.

    """
    try:
        if not path.is_file():
            raise ModelError(f'{path}: {no_file(path)}; give a file written by torch.save')
        with path.open('rb') as stream:
            refuse_pointer(stream.read(32), path, ModelError)
        if max(path.stat().st_size, _unpacked_size(path)) > MAX_BYTES:
            raise ModelError(f'{path}: larger than {MAX_BYTES >> 20} MiB, the limit for networks')
        state = torch.load(path, map_location='cpu', weights_only=True)
    except ModelError:
        raise
    except Exception as problem:  # damaged pickles raise exceptions without a common base class
        # Not torch's message, which recommends unpickling untrusted files.
        raise ModelError(f'{path}: not a file of torch.save that contains only tensors; nothing '
                         'in it was executed; ask its author to save the state_dict') from problem
    key = ''
    if isinstance(state, Mapping) and not _is_state(state):
        # A checkpoint: the one entry that is a state_dict, beside that of an optimizer.
        keys = [str(name) for name, part in state.items() if _is_state(part)]
        if len(keys) != 1:
            raise ModelError(f'{path}: holds {listed(sorted(map(str, state))) or "nothing"}, of '
                             f'which {len(keys)} are tensors by name, expected one; {_SAVE}')
        (key,) = keys
        state = state[key]
    if not _is_state(state):
        raise ModelError(f'{path}: holds {type(state).__name__}, not tensors by name; {_SAVE}')
    _check_tensors(path, state)
    found = {name: tensor.detach().resolve_neg() for name, tensor in state.items()}
    for name, tensor in found.items():
        if not bool(torch.isfinite(tensor).all()):
            raise ModelError(f'{path}: {name} holds values that are not finite numbers')
    for prefix in _PREFIXES:
        if all(name.startswith(prefix) for name in found):
            found = {name.removeprefix(prefix): tensor for name, tensor in found.items()}
    return found, key


def _is_state(state: object) -> bool:
    return isinstance(state, Mapping) and bool(state) and all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor)
        for name, tensor in state.items())


def perceptron_of(path: Path, state: Mapping[str, torch.Tensor], activation: str
                  ) -> torch.nn.Module:
    """
    Return the multilayer perceptron of a state_dict, with its layers in the order of the file.

    Raises
    ------
    ModelError
        The tensors are not the weights and biases of consecutive linear layers.

    """
    layers = _layers(path, state, _BY_CODE)
    if len(layers.weights[-1]) != 1:
        raise ModelError(f'{path}: its last layer has {len(layers.weights[-1])} outputs, and H is '
                         f'one number; {_BY_CODE}')
    return Network(layers, activation)


def _layers(path: Path, state: Mapping[str, torch.Tensor], remedy: str) -> Layers:
    """Return the consecutive linear layers of a state_dict, or raise ModelError."""
    weights, biases = list[np.ndarray](), list[np.ndarray]()
    for name, tensor in state.items():
        owner, _, kind = name.rpartition('.')
        if kind == 'bias' and f'{owner}.weight' in state:
            continue
        if kind != 'weight' or tensor.ndim != 2 or (
                weights and tensor.shape[1] != len(weights[-1])):
            raise ModelError(f'{path}: {name[:80]} of shape {(*tensor.shape,)} is not the weight '
                             f'of the next linear layer; {remedy}')
        weights.append(tensor.double().numpy())
        bias = state.get(f'{owner}.bias')
        biases.append(np.zeros(len(tensor)) if bias is None else bias.double().numpy())
        if biases[-1].shape != (len(tensor),):
            raise ModelError(f'{path}: {owner}.bias has shape {biases[-1].shape}, expected '
                             f'{(len(tensor),)}')
    return Layers(tuple(weights), tuple(biases))


def _unpacked_size(path: Path) -> int:
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        return sum(member.file_size for member in archive.infolist())


def _networks(path: Path, state: Mapping[str, torch.Tensor]) -> dict[str, Layers]:
    """Return the layers of all networks, keyed by the prefix of the layer names, '' for none."""
    found: dict[str, dict[str, torch.Tensor]] = {}
    for name, tensor in state.items():
        found.setdefault('.'.join(name.split('.')[:-2]), {})[name] = tensor
    return {name: _layers(path, network, _BODY_FILE) for name, network in found.items()}


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
        raise ModelError(f'{path}: its tensors require more than {MAX_BYTES >> 20} MiB in double '
                         'precision, the limit for networks')


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
    """Import a module with the options of the command line."""
    options = command_lines.import_model().parse_args(argv)
    names = options.coordinates.split(',')
    code, _, function = options.source.partition('.py:')
    source = Path(f'{code}.py' if function else options.source)
    out = options.out or Path('models') / f'{source.stem}.safetensors'
    if out.suffix != '.safetensors':
        raise ParameterError(f'--out {out}: a model file must end in .safetensors')
    command = shlex.join(['hnn', 'import', *argv])
    if options.layout is not None:
        save_checkpoint(out, _body(options, names, command))
    else:
        _export(options, source, function, names, out)
    print(f'model: {out}')


def _export(options: argparse.Namespace, source: Path, function: str, names: list[str], out: Path
            ) -> None:
    """Write the model of a module."""
    if options.epsilon is not None or options.floor:
        raise ParameterError(f'--epsilon, --floor: only with --layout {" or ".join(BODIES)}')
    box = parse_box(options.box, len(names))
    weights = Path(options.weights) if options.weights else None if function else source
    state, key = ({}, '') if weights is None else read_state(weights)
    if key:
        print(f'{weights}: took the entry {key!r}')
    if function:
        module = _made(source, function, weights, state)
    elif options.weights or options.activation is None:
        raise ParameterError(
            f'{source}: a file does not contain the activation between its layers; give '
            '--activation, or the module as module.py:make with --weights FILE')
    else:
        module = perceptron_of(source, state, options.activation)
    for remark in export(module, out, names, {'q': box.q, 'p': box.p}):
        print(remark)


def _made(source: Path, function: str, weights: Path | None, state: Mapping[str, torch.Tensor]
          ) -> torch.nn.Module:
    """Return the module that a function of the user makes, with these weights."""
    if not source.is_file():
        raise ParameterError(f'{source}: {no_file(source)}; give FILE.py:FUNCTION')
    print(f'running {function}() of {source}, once')
    name = f'{source.stem}:{function}'
    module = load_code(name, str(source), str(source.parent.resolve()))()
    if not isinstance(module, torch.nn.Module):
        raise ModelError(f'{source}: {function}() returned {type(module).__name__}, expected a '
                         'torch.nn.Module')
    if weights is not None:
        try:
            module.load_state_dict(dict(state))
        except RuntimeError as problem:
            raise ModelError(f'{weights}: {one_line(problem)[:500]}') from problem
    return module


def _body(arguments: argparse.Namespace, names: list[str], command: str) -> Checkpoint:
    """Return the model of a rotating body."""
    epsilon, floor, source = arguments.epsilon, arguments.floor, Path(arguments.source)
    if epsilon is None:
        raise ParameterError(f'--epsilon: required for --layout {arguments.layout}, since the '
                             'file does not contain it; examples of that code use 0.1 for so3 and '
                             '0.01 for se3')
    wrong = [
        (arguments.activation not in (None, 'tanh'),
         f'--activation {arguments.activation}: networks of rotating bodies use tanh'),
        (arguments.weights is not None, '--weights: the file itself contains them'),
        (len(names) != 1, f'--coordinates {arguments.coordinates}: {len(names)} names, expected '
                          'one, that of the body')]
    wrong += [(not 0.0 <= value < np.inf, f'{option} {value}: expected a finite number >= 0')
              for option, value in (('--epsilon', epsilon), ('--floor', floor))]
    for problem in (text for found, text in wrong if found):
        raise ParameterError(problem)
    try:
        group, networks = body_networks(
            _networks(source, read_state(source)[0]), arguments.layout, epsilon, floor)
        card = _card(source, names, networks, command, family='lie_group', lie_group=group,
                     box=parse_box(arguments.box, group.size + 1))
    except ValidationError as problem:
        raise ModelError(f'{source}: {in_plain_words(problem)}') from problem
    except ValueError as problem:
        raise ModelError(f'{source}: {problem}') from problem
    return Checkpoint(card, networks)


def _card(source: Path, names: list[str], networks: Mapping[str, Layers], command: str,
          **own: Any) -> ModelCard:
    digest = sha256(source.read_bytes()).hexdigest()
    return ModelCard(
        name=source.stem, seed=0, losses={}, training_command=command,
        coordinates=[CoordinateCard(name=name) for name in names],
        dataset=f'unknown; imported from {source.name} (sha256 {digest[:16]})',
        package_version=__version__, **widths_of(networks), **own)
