# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Trained networks on disk: one safetensors file, its metadata the model card.

The file contains the float64 tensors ``linear1.weight`` (outputs, inputs), ``linear1.bias``, ...
of the single network of a model, in the order of the layers, with the card's activation between
them. In a model with several networks, the names begin with the network's name, as in
``potential.linear1.weight``; in an ensemble of N such models, they begin with the member, from
``member1.`` to ``memberN.``. The metadata entry ``model_card`` is a ModelCard as JSON. No content
of the file is ever executed.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
import hashlib
from io import BufferedReader
from itertools import pairwise
import json
import os
from pathlib import Path
from typing import Any, BinaryIO, TYPE_CHECKING

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import (
    in_plain_words, limited, make_folder, one_line, parse_json, refuse_pointer,
    safetensors_header, write_bytes)
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import ModelCard
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np
from pydantic import ValidationError
import safetensors
import safetensors.numpy

if TYPE_CHECKING:
    from hnn_vi_ros.models.graphs.graph import Builder

MAX_BYTES = 256 << 20

_DTYPES = {'F64': '<f8', 'F32': '<f4'}
_REMEDY = 'copy the file again, or train the model again'
# First bytes of files of torch.save or pickle: a zip archive, or a pickle of protocol 2 to 5.
_PICKLES = (b'PK\x03\x04', b'\x80\x02', b'\x80\x03', b'\x80\x04', b'\x80\x05')


@dataclass(frozen=True)
class Checkpoint:
    """
    A trained model.

    Parameters
    ----------
    card : ModelCard
        Description of the model.
    networks : mapping of str to Layers
        Networks by the names in the card's layout.
    sha256 : str
        SHA-256 of the file that it was loaded from; '' if it was not loaded.
    members : tuple of Checkpoint
        Members of an ensemble, which has no networks of its own; empty for a single model.
    graph : tuple of (Builder, int), optional
        H as a graph, with its output, for families without networks.

    """

    card: ModelCard
    networks: Mapping[str, Layers]
    sha256: str = ''
    members: 'tuple[Checkpoint, ...]' = ()
    graph: 'tuple[Builder, int] | None' = None

    @property
    def tensors(self) -> dict[str, np.ndarray]:
        """Return the weights and biases of all networks, keyed by name in the file."""
        return {name: part for network, layers in self.networks.items()
                for names, parts in zip(
                    _names(self.card, network), zip(*layers, strict=True), strict=True)
                for name, part in zip(names, parts, strict=True)}

    def with_tensors(self, tensors: Mapping[str, np.ndarray]) -> 'Checkpoint':
        """Return the model with some tensors replaced by name."""
        return replace(self, networks=_layers(self.card, self.tensors | dict(tensors)))

    def member(self, number: int | None) -> 'Checkpoint':
        """
        Return a member of an ensemble, from 1 to N; for None the whole, unchanged.

        Raises
        ------
        ModelError
            The member does not exist.

        """
        count = len(self.members)
        if number is None:
            return self
        if not count:
            raise ModelError(f'member = {number}: the file contains one model, not an ensemble; '
                             'remove member')
        if not 1 <= number <= count:
            raise ModelError(f'member = {number}: expected 1 to {count}')
        return self.members[number - 1]


def load_checkpoint(path: str | Path, ensembles: bool = False) -> Checkpoint:
    """
    Load and validate a model file.

    Parameters
    ----------
    path : str or Path
        A safetensors file of at most 256 MiB.
    ensembles : bool, optional
        True to accept an ensemble as well as a single model.

    Returns
    -------
    Checkpoint
        The model, with weights converted to float64.

    Raises
    ------
    ModelError
        The file is missing, damaged, or not a model of this package.

    """
    with opened(Path(path)) as stream:
        # This check precedes the reading of tensors.
        metadata = _metadata(path, stream)
        card = _card(path, metadata)
        stream.seek(0)
        raw = stream.read()
    with _plain(path, raw):
        tensors = dict(safetensors.deserialize(raw))
    digest = hashlib.sha256(raw).hexdigest()
    if card.ensemble is not None and not ensembles:
        raise ModelError(f'{path}: an ensemble of {len(card.ensemble.members)} models is '
                         'supported as the Hamiltonian of a scene, and for friction and forces of '
                         'the family mechanical; give a single model here')
    members = () if card.ensemble is None else tuple(
        Checkpoint(member, _networks(path, member, tensors, f'member{k}.'), digest)
        for k, member in enumerate(card.ensemble.members, start=1))
    networks = {} if members else _networks(path, card, tensors)
    if not FAMILIES[card.family].networks:
        return Checkpoint(card, {}, digest, graph=_graph(path, card, metadata, tensors))
    if tensors:
        raise ModelError(f'{path}: unknown tensor {min(tensors)}; {_REMEDY}')
    return Checkpoint(card, networks, digest, members)


def _metadata(path: str | Path, stream: BinaryIO) -> dict[str, Any]:
    """Return the metadata of a file from its header."""
    begin = stream.read(32)
    refuse_pointer(begin, path, ModelError)
    stream.seek(0)
    with _plain(path, begin):
        header = parse_json(safetensors_header(stream))
    metadata = header.get('__metadata__') if isinstance(header, dict) else None
    return metadata if isinstance(metadata, dict) else {}


@contextmanager
def _plain(path: str | Path, begin: bytes) -> Iterator[None]:
    """Convert errors inside to a ModelError: the file, which has these first bytes, is invalid."""
    try:
        yield
    except (safetensors.SafetensorError, ValueError) as problem:
        if begin.startswith(_PICKLES):
            raise ModelError(f'{path}: a pickle or torch.save file, which could run code when '
                             'loaded; give a .safetensors file; convert a torch module with: '
                             'hnn import --help') from problem
        raise ModelError(f'{path}: not a safetensors file ({one_line(problem)}); {_REMEDY}'
                         ) from problem


def _networks(path: str | Path, card: ModelCard, tensors: dict[str, Any], prefix: str = ''
              ) -> dict[str, Layers]:
    """Return the networks of one model from the tensors of a file."""
    return _layers(card, {
        name: _tensor(path, prefix + name, shape, tensors.pop(prefix + name, None))
        for name, shape in _shapes(card).items()})


def _graph(path: str | Path, card: ModelCard, metadata: dict[str, Any],
           tensors: Mapping[str, dict[str, Any]]) -> 'tuple[Builder, int]':
    """Return the graph of a file and its output."""
    # Imported lazily: reading a scene needs no scipy.
    from hnn_vi_ros.models.graphs.graph import read_graph
    try:
        data = parse_json(str(metadata.get('graph')).encode())
        values = {name: _values(path, name, found, graph=True) for name, found in tensors.items()}
    except ValueError as problem:
        raise ModelError(f'{path}: graph: {one_line(problem)}; {_REMEDY}') from problem
    try:
        return read_graph(data, values, 2 * len(card.coordinates) + len(card.box.t or ()))
    except ModelError as problem:
        raise ModelError(f'{path}: {problem}; {_REMEDY}') from problem


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a model file, as in load_checkpoint; ModelError if unreadable."""
    with opened(path) as stream:
        return hashlib.file_digest(stream, 'sha256').hexdigest()


def save_checkpoint(path: str | Path, checkpoint: Checkpoint) -> None:
    """
    Write a model file atomically; an existing file is never overwritten.

    Parameters
    ----------
    path : str or Path
        Path of the file; missing folders are created.
    checkpoint : Checkpoint
        The model; its tensors must be finite and match its card.

    Raises
    ------
    ModelError
        The file exists or cannot be written, or the checkpoint is inconsistent.

    """
    path = Path(path)
    raw = _serialized(path, checkpoint)
    try:
        make_folder(path.parent)
        write_bytes(path, raw, new=True)
    except OSError as problem:
        # A file at the path of the folder also raises FileExistsError.
        if isinstance(problem, FileExistsError) and os.path.lexists(path):
            raise ModelError(f'{path}: already exists and is not overwritten; name another file'
                             ) from problem
        raise ModelError(f'{path}: cannot be written: {problem.strerror}') from problem


def complete_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """
    Write a model over the file that this process created, atomically.

    Raises
    ------
    ModelError
        See ``save_checkpoint``; the file is unchanged.

    """
    raw = _serialized(path, checkpoint)
    try:
        write_bytes(path, raw)
    except OSError as problem:
        raise ModelError(f'{path}: cannot be written: {problem.strerror}') from problem


def _serialized(path: Path, checkpoint: Checkpoint) -> bytes:
    models = {f'member{k}.': member for k, member in enumerate(checkpoint.members, start=1)}
    tensors: dict[str, np.ndarray] = {}
    for prefix, model in (models or {'': checkpoint}).items():
        tensors |= _tensors(path, model, prefix)
    metadata = {'model_card': checkpoint.card.model_dump_json(exclude_none=True)}
    if checkpoint.graph is not None:
        from hnn_vi_ros.models.graphs.graph import graph_data
        graph, tensors = graph_data(*checkpoint.graph)
        metadata['graph'] = json.dumps(graph, separators=(',', ':'))
    return safetensors.numpy.save(tensors, metadata)


def _tensors(path: Path, checkpoint: Checkpoint, prefix: str) -> dict[str, np.ndarray]:
    """Return the tensors of one model, checked against its card."""
    tensors, parts = {}, checkpoint.tensors
    for name, shape in _shapes(checkpoint.card).items():
        part = parts[name]
        if part.shape != shape or not np.isfinite(part).all():
            raise ModelError(f'{path}: {prefix}{name} has shape {part.shape}, expected {shape}, '
                             'all values finite')
        tensors[prefix + name] = np.ascontiguousarray(part, dtype='<f8')
    return tensors


@contextmanager
def opened(path: Path) -> Iterator[BufferedReader]:
    try:
        with limited(path, MAX_BYTES) as stream:
            yield stream
    except FileNotFoundError as problem:
        raise ModelError(f'{path}: no such model file; train one with: '
                         'hnn train --config NAME') from problem
    except (OSError, ValueError) as problem:
        what = getattr(problem, 'strerror', None) or one_line(problem)
        raise ModelError(f'{path}: cannot be read: {what}; give the path of a .safetensors file'
                         ) from problem


def _card(path: str | Path, metadata: dict[str, Any]) -> ModelCard:
    if not isinstance(metadata.get('model_card'), str):
        raise ModelError(f'{path}: not a model of hnn_vi_ros, because its metadata have no '
                         'model_card; train one with: hnn train --config NAME')
    try:
        return ModelCard.model_validate_json(metadata['model_card'])
    except ValidationError as problem:
        raise ModelError(f'{path}: model_card: {in_plain_words(problem)}; {_REMEDY}, or use the '
                         'version of hnn_vi_ros that wrote it') from problem


def _names(card: ModelCard, network: str) -> list[tuple[str, str]]:
    """Return the names of weight and bias of each layer of a network."""
    prefix = '' if card.networks is None else f'{network}.'
    return [(f'{prefix}linear{k}.weight', f'{prefix}linear{k}.bias')
            for k in range(1, len(card.layout[network]))]


def _shapes(card: ModelCard) -> dict[str, tuple[int, ...]]:
    """Return the shapes of all weights and biases by name."""
    return {name: shape for network, widths in card.layout.items()
            for names, (a, b) in zip(_names(card, network), pairwise(widths), strict=True)
            for name, shape in zip(names, ((b, a), (b,)), strict=True)}


def _layers(card: ModelCard, tensors: Mapping[str, np.ndarray]) -> dict[str, Layers]:
    """Return the networks with these weights and biases."""
    return {network: Layers(*zip(*(
        (tensors[weight], tensors[bias]) for weight, bias in _names(card, network)), strict=True))
        for network in card.layout}


def _tensor(path: str | Path, name: str, shape: tuple[int, ...], found: dict[str, Any] | None
            ) -> np.ndarray:
    if found is None:
        raise ModelError(f'{path}: {name} is missing; {_REMEDY}')
    if tuple(found['shape']) != shape:
        raise ModelError(f'{path}: {name} has shape {tuple(found["shape"])}, expected {shape} '
                         f'for the widths of its card; {_REMEDY}')
    return _values(path, name, found)


def _values(path: str | Path, name: str, found: dict[str, Any], graph: bool = False) -> np.ndarray:
    """Return a tensor of a file as float64; of a graph also indices, as int64, and any value."""
    if graph and found['dtype'] == 'I64':
        return np.frombuffer(found['data'], '<i8').astype(np.int64).reshape(found['shape'])
    if found['dtype'] not in _DTYPES:
        raise ModelError(f'{path}: {name} has type {found["dtype"]}, expected F64 or F32; '
                         f'{_REMEDY}')
    # A copy, because a view of the file's bytes is read-only and may not be aligned.
    values = np.frombuffer(found['data'], _DTYPES[found['dtype']]).astype(np.float64)
    if not (graph or np.isfinite(values).all()):
        raise ModelError(f'{path}: {name} contains values that are not finite; {_REMEDY}')
    return values.reshape(found['shape'])
