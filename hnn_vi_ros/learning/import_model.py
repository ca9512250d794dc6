# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a torch module of others to a model of this package: ``hnn import``.

The module comes from a function of the user, ``module.py:make``, with the weights of a file, or
from the file alone if it contains the layers of a multilayer perceptron. It is exported as a
graph; see learning.export_module. Only tensors are unpickled from files.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hnn_vi_ros.errors import listed, ModelError, ParameterError
from hnn_vi_ros.files import in_plain_words, no_file, one_line
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.export_module import export, weights_remark
from hnn_vi_ros.learning.torch_file import load_tensors
from hnn_vi_ros.models import Box, Layers, Network
from hnn_vi_ros.scene import load_code
import numpy as np
from pydantic import ValidationError
import torch

# Maximum size of the file, of its unpacked content, and of all tensors in double precision.
MAX_BYTES = 64 << 20
_TYPES = (torch.float64, torch.float32, torch.float16, torch.bfloat16)
# Prefixes that wrappers of modules add to all names.
_PREFIXES = ('module.', '_orig_mod.', 'module.')
_SAVE = 'save the state_dict of the module'
_BY_CODE = 'give the module itself, as module.py:make with --weights'


def read_state(path: Path, entry: str | None = None) -> tuple[dict[str, torch.Tensor], str]:
    """
    Read the tensors of a state_dict saved by torch.save or safetensors.

    Parameters
    ----------
    path : Path
        File of at most 64 MiB, also unpacked, as are its tensors in double precision.
    entry : str, optional
        Key of the state_dict in a checkpoint that holds several.

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
        state = load_tensors(path, MAX_BYTES)
    except ModelError:
        raise
    except OSError as problem:
        raise ModelError(f'{path}: {problem.strerror or problem}; give a file written by '
                         'torch.save') from problem
    except Exception as problem:  # damaged pickles raise exceptions without a common base class
        # Not torch's message, which recommends unpickling untrusted files.
        raise ModelError(f'{path}: not a file of torch.save or safetensors that contains only '
                         'tensors; nothing in it was executed; ask its author to save the '
                         'state_dict') from problem
    key = ''
    if isinstance(state, Mapping) and not _is_state(state):
        # A checkpoint: the one entry that is a state_dict, apart from the optimizer's.
        keys = [str(name) for name, part in state.items() if _is_state(part)]
        if entry is not None or len(keys) > 1:
            if entry not in keys:
                raise ModelError(f'{path}: choose one of its state_dicts with --entry: '
                                 f'{listed(keys) or "there are none"}')
            keys = [entry]
        if len(keys) != 1:
            raise ModelError(f'{path}: holds {listed(sorted(map(str, state))) or "nothing"}, of '
                             f'which none are tensors by name, expected one; {_SAVE}')
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
    Return the multilayer perceptron of the state_dict of a torch.nn.Sequential.

    Raises
    ------
    ModelError
        The tensors are not the weights and biases of linear layers with one module between two.

    """
    owners = list(dict.fromkeys(name.rpartition('.')[0] for name in state))
    if len({owner.rpartition('.')[0] for owner in owners}) > 1 or [
            owner.rpartition('.')[2] for owner in owners] != [
                str(2 * k) for k in range(len(owners))]:
        raise ModelError(f'{path}: its layers are {listed(owners)}, not 0, 2, 4, ... of a '
                         'torch.nn.Sequential with activations between, so what its forward '
                         f'computes is unknown; {_BY_CODE}')
    weights, biases = list[np.ndarray](), list[np.ndarray]()
    for name, tensor in state.items():
        owner, _, kind = name.rpartition('.')
        if kind == 'bias' and f'{owner}.weight' in state:
            continue
        if kind != 'weight' or tensor.ndim != 2 or (
                weights and tensor.shape[1] != len(weights[-1])):
            raise ModelError(f'{path}: {name[:80]} of shape {(*tensor.shape,)} is not the weight '
                             f'of the next linear layer; {_BY_CODE}')
        weights.append(tensor.double().numpy())
        bias = state.get(f'{owner}.bias')
        biases.append(np.zeros(len(tensor)) if bias is None else bias.double().numpy())
        if biases[-1].shape != (len(tensor),):
            raise ModelError(f'{path}: {owner}.bias has shape {biases[-1].shape}, expected '
                             f'{(len(tensor),)}')
    if len(weights[-1]) != 1:
        raise ModelError(f'{path}: its last layer has {len(weights[-1])} outputs, and H is one '
                         f'number; {_BY_CODE}')
    return Network(Layers(tuple(weights), tuple(biases)), activation)


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
    box = parse_box(options.box, len(names))
    weights = Path(options.weights) if options.weights else None if function else source
    state, key = ({}, '') if weights is None else read_state(weights, options.entry)
    if key:
        print(f'{weights}: took the entry {key!r}')
    if function:
        print(f'running {function}() of {source}, once')
        module = made(source, function, weights, state)
    elif options.weights or options.activation is None:
        raise ParameterError(
            f'{source}: a file does not contain the activation between its layers; give '
            '--activation, or the module as module.py:make with --weights FILE')
    else:
        module = perceptron_of(source, state, options.activation)
        print(f'{source}: taken as ' + f', {options.activation}, '.join(
            f'Linear{(*reversed(part.shape),)}' for part in state.values() if part.ndim == 2))
    remarks = export(module, out, names, {'q': box.q, 'p': box.p})
    # The type in the file: layers of another type have taken these weights.
    for remark in dict.fromkeys([*weights_remark([*state.values()]), *remarks]):
        print(remark)
    print(f'model: {out}\n'
          f'next: hnn run SCENE.yaml, a scene with hamiltonian: {{kind: hnn, model: {out}}}')


def function_of(source: Path, function: str) -> Callable[..., Any]:
    """Return a function of a file of the user; raise HnnViRosError if there is none."""
    if not source.is_file():
        raise ParameterError(f'{source}: {no_file(source)}; give FILE.py:FUNCTION')
    name = f'{source.stem}:{function}'
    found = load_code(name, str(source), str(source.parent.resolve()))
    if not callable(found):
        raise ModelError(f'{source}: {function} is a {type(found).__name__}, expected a function')
    return found


def made(source: Path, function: str, weights: Path | None = None,
         state: Mapping[str, torch.Tensor] = MappingProxyType({})) -> torch.nn.Module:
    """Return the module that a function of the user makes, with these weights."""
    create = function_of(source, function)
    try:
        module = create()
    except Exception as problem:  # noqa: B902  the user's code may raise any
        raise ModelError(f'{source}: {function}(): {type(problem).__name__}: '
                         f'{one_line(problem)[:500]}') from problem
    if not isinstance(module, torch.nn.Module):
        raise ModelError(f'{source}: {function}() returned {type(module).__name__}, expected a '
                         'torch.nn.Module')
    if weights is not None:
        try:
            module.load_state_dict(next(_without_prefix(state, module), dict(state)))
        except RuntimeError as problem:
            raise ModelError(f'{weights}: {one_line(problem)[:500]}') from problem
    return module


def _without_prefix(state: Mapping[str, torch.Tensor], module: torch.nn.Module
                    ) -> Iterator[dict[str, torch.Tensor]]:
    """Yield the weights of a module, whose names another one, such as Lightning's, prefixed."""
    wanted = module.state_dict().keys()
    for prefix in dict.fromkeys(name[:k + 1] for name in state for k, sign in enumerate(name)
                                if sign == '.'):
        own = {name.removeprefix(prefix): tensor for name, tensor in state.items()
               if name.startswith(prefix)}
        if own.keys() == wanted != state.keys():
            yield own
