# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the layers of a network from the state_dict that somebody's torch.save wrote."""

from collections.abc import Mapping, Sequence
from pathlib import Path
import re
import stat
import zipfile

from hnn_vi_ros.errors import listed, ModelError
from hnn_vi_ros.files.limits import check_pickles
from hnn_vi_ros.files.regular_file import refuse_pointer
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch

# The limit of the file, of its unpacked content, and of all its tensors in double precision.
MAX_BYTES = 64 << 20
_TYPES = (torch.float64, torch.float32, torch.float16, torch.bfloat16)
_NAME = re.compile(r'(.*\.)?linear([1-9]\d?)\.(weight|bias)')
_SHAPES = ('expected the state_dict of a network whose layers are named linear1, linear2, ... '
           'with weights and biases')


def read_layers(path: Path) -> Layers:
    """
    Read the layers of one network from a state_dict that torch.save wrote; see read_networks.

    Raises
    ------
    ModelError
        As read_networks, and where the file holds several networks.

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
    Read the layers of all networks from a state_dict that torch.save wrote.

    Parameters
    ----------
    path : Path
        A file of at most 64 MiB, compressed or not, as are its tensors in double precision.

    Returns
    -------
    dict of str to Layers
        By what stands before the names of their layers, '' for nothing; in float64; where the
        source has no bias, of zeros.

    Raises
    ------
    ModelError
        The file is missing or damaged, holds anything but tensors, which would have to be run to
        be read, or its tensors are not the layers of networks.

    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            what = 'a folder' if stat.S_ISDIR(status.st_mode) else 'not a regular file'
            raise ModelError(f'{path}: is {what}; give a file that torch.save wrote')
        with path.open('rb') as stream:
            refuse_pointer(stream.read(32), path, ModelError)
        if max(status.st_size, _unpacked_size(path)) > MAX_BYTES:
            raise ModelError(f'{path}: larger than {MAX_BYTES >> 20} MiB, which no network needs')
        check_pickles(path)
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
    return _networks(path, state)


def _unpacked_size(path: Path) -> int:
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        return sum(member.file_size for member in archive.infolist())


def _networks(path: Path, state: object) -> dict[str, Layers]:
    found: dict[str, dict[tuple[int, str], np.ndarray]] = {}
    items = _items(path, state)
    _check_tensors(path, items)
    for name, tensor in items:
        match = _NAME.fullmatch(name)
        if match is None:
            raise ModelError(f'{path}: holds {name[:80]!r}; {_SHAPES}')
        network = found.setdefault((match[1] or '').removesuffix('.'), {})
        network[int(match[2]), match[3]] = _array(path, name, tensor)
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


def _items(path: Path, state: object) -> list[tuple[str, torch.Tensor]]:
    if not isinstance(state, Mapping) or not state or not all(
            isinstance(name, str) and isinstance(tensor, torch.Tensor)
            for name, tensor in state.items()):
        raise ModelError(f'{path}: holds {type(state).__name__}, not tensors by name; {_SHAPES}')
    return list(state.items())


def _check_tensors(path: Path, items: Sequence[tuple[str, torch.Tensor]]) -> None:
    """Refuse other than plain tensors of real numbers, and too many, before any is copied."""
    total = 0
    for name, tensor in items:
        kinds = {'a meta tensor, without values': tensor.is_meta,
                 'a nested tensor': tensor.is_nested,
                 'a sparse tensor': tensor.layout != torch.strided,
                 'quantised': tensor.is_quantized,
                 'complex': tensor.is_complex(),
                 f'of type {tensor.dtype}': tensor.dtype not in _TYPES}
        if kind := next((kind for kind, found in kinds.items() if found), None):
            raise ModelError(f'{path}: {name[:80]} is {kind}; expected a plain tensor of real '
                             'numbers, float64, float32, float16 or bfloat16')
        # A tensor may claim to be larger than the memory behind it.
        total += 8 * tensor.numel()
    if total > MAX_BYTES:
        raise ModelError(f'{path}: its tensors take more than {MAX_BYTES >> 20} MiB in double '
                         'precision, which no network needs')


def _array(path: Path, name: str, tensor: torch.Tensor) -> np.ndarray:
    array = tensor.detach().resolve_neg().double().numpy().copy()
    if not np.isfinite(array).all():
        raise ModelError(f'{path}: {name} holds values that are not finite numbers')
    return array
