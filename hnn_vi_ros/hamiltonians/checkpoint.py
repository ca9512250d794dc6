# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Trained networks on disk: one safetensors file, its metadata the model card.

The file holds the float64 tensors ``linear1.weight`` (outputs, inputs), ``linear1.bias``, ... in
the order of the layers, with tanh between them; the input is (q, p), the one output is H. The
metadata entry ``model_card`` is a ModelCard as JSON. Nothing in it is ever executed.
"""

from dataclasses import dataclass
from hashlib import sha256
import json
import os
from pathlib import Path
import stat
from typing import Annotated, Literal

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.yaml_file import StrictModel
import numpy as np
from pydantic import Field, model_validator, ValidationError
import safetensors
import safetensors.numpy

MAX_BYTES = 256 << 20

_DTYPES = {'F64': '<f8', 'F32': '<f4'}
_ANEW = 'copy the file again, or train the model anew'
# How a file begins that torch.save or pickle wrote: a zip archive, or a protocol 2 to 5 pickle.
_PICKLES = (b'PK\x03\x04', b'\x80\x02', b'\x80\x03', b'\x80\x04', b'\x80\x05')

Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


class CoordinateCard(StrictModel):
    """One generalised coordinate of a model and its conjugate momentum."""

    name: str = Field(pattern=r'^[^\W\d]\w*$', max_length=64, description=(
        'a letter or underscore, then letters, digits, underscores'))
    q_unit: str = Field('1', max_length=32, description='unit of the coordinate')
    p_unit: str = Field('1', max_length=32, description='unit of the momentum')


class Box(StrictModel):
    """A box in phase space: for each coordinate the bounds [low, high] of q and of p."""

    q: list[Interval] = Field(min_length=1)
    p: list[Interval] = Field(min_length=1)

    @model_validator(mode='after')
    def _check(self) -> 'Box':
        if len(self.q) != len(self.p):
            raise ValueError(f'{len(self.q)} intervals of q but {len(self.p)} of p')
        for low, high in (*self.q, *self.p):
            if not 0.0 < high - low < np.inf:
                raise ValueError(
                    f'[{low:g}, {high:g}] is not an interval of positive, finite size')
        return self


class ModelCard(StrictModel):
    """What a model is, what it was learned from, and how well."""

    format_version: Literal[1] = 1
    name: str = Field(min_length=1, max_length=255)
    family: Literal['hnn'] = 'hnn'
    activation: Literal['tanh'] = 'tanh'
    widths: list[Annotated[int, Field(ge=1, le=100_000)]] = Field(
        min_length=3, max_length=100, description='of all layers, input and output included')
    coordinates: list[CoordinateCard] = Field(min_length=1)
    box: Box = Field(description='bounds of the data that the model was trained on')
    dataset: str
    seed: int
    losses: dict[str, float]
    training_command: str
    package_version: str
    confine: bool = Field(False, description=(
        'whether H holds states near the box, unless a scene says otherwise'))

    @model_validator(mode='after')
    def _check(self) -> 'ModelCard':
        d = len(self.coordinates)
        if len({coordinate.name for coordinate in self.coordinates}) != d:
            raise ValueError('two coordinates have the same name')
        if len(self.box.q) != d:
            raise ValueError(f'the box has {len(self.box.q)} coordinates, expected {d}')
        if (self.widths[0], self.widths[-1]) != (2 * d, 1):
            raise ValueError(f'widths {self.widths} must begin with {2 * d}, for (q, p) of '
                             f'{d} coordinates, and end with 1, for H')
        return self


@dataclass(frozen=True)
class Checkpoint:
    """
    A trained network.

    Parameters
    ----------
    card : ModelCard
        What it is.
    weights : tuple of np.ndarray, each (outputs, inputs)
        One float64 matrix a layer.
    biases : tuple of np.ndarray, each (outputs,)
        One float64 vector a layer.
    sha256 : str
        Of the file that it was loaded from; empty for one that was not.

    """

    card: ModelCard
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    sha256: str = ''


def load_checkpoint(path: str | Path) -> Checkpoint:
    """
    Load and validate a model file.

    Parameters
    ----------
    path : str or Path
        A safetensors file of at most 256 MiB.

    Returns
    -------
    Checkpoint
        Weights in float64, whatever the file holds.

    Raises
    ------
    ModelError
        The file is missing, damaged, or not a model of ours; one line says which.

    """
    raw = _read(Path(path))
    try:
        tensors = dict(safetensors.deserialize(raw))
        metadata = json.loads(raw[8:8 + int.from_bytes(raw[:8], 'little')]).get('__metadata__')
    except (safetensors.SafetensorError, ValueError, RecursionError) as problem:
        if raw.startswith(_PICKLES):
            raise ModelError(f'{path}: a pickle or torch.save file, which could run code when '
                             'loaded; a model is a .safetensors file, see: ros2 run hnn_vi_ros '
                             'train --help') from problem
        raise ModelError(f'{path}: not a safetensors file ({_one_line(problem)}); {_ANEW}'
                         ) from problem
    card = _card(path, metadata or {})
    weights, biases = [], []
    for name, shape in _expected_shapes(card).items():
        (weights if name.endswith('weight') else biases).append(
            _tensor(path, name, shape, tensors.pop(name, None)))
    if tensors:
        raise ModelError(f'{path}: unknown tensor {min(tensors)}; {_ANEW}')
    return Checkpoint(card, tuple(weights), tuple(biases), sha256(raw).hexdigest())


def save_checkpoint(path: str | Path, checkpoint: Checkpoint) -> None:
    """
    Write a model file, whole or not at all; never over one that exists.

    Parameters
    ----------
    path : str or Path
        Where to; missing folders are made.
    checkpoint : Checkpoint
        Its tensors must be finite and fit its card.

    Raises
    ------
    ModelError
        The file exists, cannot be written, or the checkpoint contradicts itself.

    """
    path = Path(path)
    parts = [part for pair in zip(checkpoint.weights, checkpoint.biases, strict=True)
             for part in pair]
    tensors = {}
    for (name, shape), part in zip(_expected_shapes(checkpoint.card).items(), parts, strict=True):
        if part.shape != shape or not np.isfinite(part).all():
            raise ModelError(f'{path}: {name} has shape {part.shape}, expected {shape}, '
                             'all values finite')
        tensors[name] = np.ascontiguousarray(part, dtype='<f8')
    raw = safetensors.numpy.save(tensors, {'model_card': checkpoint.card.model_dump_json()})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_new(path, raw)
    except FileExistsError as problem:
        raise ModelError(f'{path}: exists already and is not overwritten; name another file'
                         ) from problem
    except OSError as problem:
        raise ModelError(f'{path}: cannot be written: {problem.strerror}') from problem


def _write_new(path: Path, raw: bytes) -> None:
    path.open('xb').close()  # claims the name: of two that write it, one fails here
    temporary = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        temporary.write_bytes(raw)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        path.unlink(missing_ok=True)
        raise


def _read(path: Path) -> bytes:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ModelError(f'{path}: not a regular file; give the path of a .safetensors file')
        if status.st_size > MAX_BYTES:
            raise ModelError(f'{path}: larger than {MAX_BYTES >> 20} MiB, which no model needs')
        return path.read_bytes()
    except FileNotFoundError as problem:
        raise ModelError(f'{path}: no such model file; train one with: '
                         'ros2 run hnn_vi_ros train --config NAME') from problem
    except (OSError, ValueError) as problem:
        raise ModelError(f'{path}: cannot be read: {_one_line(problem)}') from problem


def _card(path: str | Path, metadata: dict[str, str]) -> ModelCard:
    if 'model_card' not in metadata:
        raise ModelError(f'{path}: has no model_card in its metadata, so it is not a model of '
                         'hnn_vi_ros; train one with: ros2 run hnn_vi_ros train --config NAME')
    try:
        return ModelCard.model_validate_json(metadata['model_card'])
    except ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        key = '.'.join(str(part) for part in ('model_card', *first['loc']))
        message = first['msg'].removeprefix('Value error, ')
        raise ModelError(f'{path}: {key}: {_one_line(message)}; {_ANEW}, or use the version of '
                         'hnn_vi_ros that wrote it') from problem


def _expected_shapes(card: ModelCard) -> dict[str, tuple[int, ...]]:
    shapes: dict[str, tuple[int, ...]] = {}
    for layer, (inputs, outputs) in enumerate(zip(card.widths, card.widths[1:]), start=1):
        shapes[f'linear{layer}.weight'] = (outputs, inputs)
        shapes[f'linear{layer}.bias'] = (outputs,)
    return shapes


def _tensor(path: str | Path, name: str, shape: tuple[int, ...], found: dict | None
            ) -> np.ndarray:
    if found is None:
        raise ModelError(f'{path}: {name} is missing; {_ANEW}')
    if found['dtype'] not in _DTYPES:
        raise ModelError(f'{path}: {name} has type {found["dtype"]}, expected F64 or F32; {_ANEW}')
    if tuple(found['shape']) != shape:
        raise ModelError(f'{path}: {name} has shape {tuple(found["shape"])}, expected {shape} '
                         f'by the widths of its card; {_ANEW}')
    # A copy, since a view of the file's bytes can neither be written to nor be relied on to align.
    values = np.frombuffer(found['data'], _DTYPES[found['dtype']]).astype(np.float64)
    if not np.isfinite(values).all():
        raise ModelError(f'{path}: {name} holds values that are not finite; {_ANEW}')
    return values.reshape(shape)


def _one_line(problem: object) -> str:
    return ' '.join(str(problem).split())
