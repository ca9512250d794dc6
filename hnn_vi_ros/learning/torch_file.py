# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Load files of torch.save or safetensors within limits that are checked before memory is allocated.

``weights_only`` still calls types that make any number of bytes from a few, such as bytearray.
"""

import errno
from io import BytesIO
from pathlib import Path
import pickletools
import re
from typing import Any, BinaryIO
import warnings
import zipfile

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import in_bytes, read_limited, refuse_pointer
import safetensors.torch
import torch

# Types and functions that a state_dict of any tensors, or of an optimiser, needs.
_PLAIN = re.compile(
    r'collections OrderedDict|torch (?!\w*Tensor)\w+|torch\._utils _rebuild_\w+|torch\._tensor '
    r'_rebuild_from_type_v2|torch\.serialization _get_layout|torch\.nn\.parameter Parameter')
# Programs of torch by a member of their archives, and the call that loads them.
_PROGRAMS = {'constants.pkl': 'torch.jit.load(FILE)',
             'archive_format': 'torch.export.load(FILE).module()'}
# Number of uses of a tuple that was already used: hashing nested ones takes 2^n; and of integers
# that may have the hash of others.
_MOST_SHARED, _MOST_ODD = 20, 1000
# Pickles at the start of a file before torch 1.6: number, version, system, object, keys.
_PICKLES = 5


class _Number:
    """Placeholder for a number of numpy among the tensors; its value is not read."""

    def __init__(self, *parts: object):
        pass

    def __setstate__(self, state: object) -> None:
        """Ignore the state."""


# Names that pickles use for numbers of numpy; none of them is called.
_NUMBERS = [(_Number, name) for name in (
    'numpy._core.multiarray.scalar', 'numpy.core.multiarray.scalar', 'numpy.dtype',
    '_codecs.encode', *(f'numpy.dtypes.{name}DType' for name in (
        'Float64', 'Float32', 'Int64', 'Int32', 'Bool')))]


def load_tensors(path: Path, most: int) -> Any:
    """
    Load the tensors, numbers and containers of a file of torch.save or safetensors.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Maximum size of the file, and of its unpacked content [bytes].

    Raises
    ------
    OSError
        See ``read_limited``; or the unpacked content is larger.
    ModelError
        The file is a pointer of Git LFS, or a program of torch.
    ValueError
        The file contains other types.
    Exception
        Any exception of torch or safetensors for a damaged file.

    """
    content = read_limited(path, most)
    refuse_pointer(content, path, ModelError)
    if content[8:9] == b'{':
        state = safetensors.torch.load(content)
        # The file has an order of its own: layers come by their numbers.
        return {name: state[name] for name in sorted(state, key=lambda name: [
            (int(part) if part.isdecimal() else -1, part) for part in name.split('.')])}
    stream = BytesIO(content)
    if zipfile.is_zipfile(stream):
        stream = _checked_archive(stream, most, path)
    else:
        stream.seek(0)
        for _ in range(_PICKLES):
            _check_pickle(stream)
    stream.seek(0)
    with warnings.catch_warnings(), torch.serialization.safe_globals(_NUMBERS):
        warnings.simplefilter('ignore')
        return torch.load(stream, map_location='cpu', weights_only=True)


def _checked_archive(stream: BinaryIO, most: int, path: Path) -> BytesIO:
    """Return a copy of an archive, of what was checked: torch finds members in its own way."""
    copy = BytesIO()
    with zipfile.ZipFile(stream) as archive, zipfile.ZipFile(copy, 'w') as checked:
        members = archive.infolist()
        if sum(member.file_size for member in members) > most:
            raise OSError(errno.EFBIG, f'unpacks to more than {in_bytes(most)}')
        for name, call in _PROGRAMS.items():
            if any(member.filename.rpartition('/')[2] == name for member in members):
                raise ModelError(f'{path}: a program of torch, not a state_dict: write a make.py '
                                 f'with def make(): return {call}, and give make.py:make')
        for member in members:
            content = archive.read(member)
            if member.filename.lower().endswith('.pkl'):
                _check_pickle(BytesIO(content))
            checked.writestr(member.filename, content)
    return copy


def _check_pickle(stream: BinaryIO) -> None:
    """Read a pickle without running it; raise ValueError for other types than plain ones."""
    tuples, encoders, shared, before, texts, odd = set[object](), set[object](), 0, '', False, 0
    for opcode, value, _ in pickletools.genops(stream):
        if opcode.name == 'GLOBAL' and not _PLAIN.fullmatch(str(value)) and not any(
                str(value).replace(' ', '.') == name for _, name in _NUMBERS):
            raise ValueError(f'contains {str(value)[:80]!r}')
        # Multiples of 2^61 - 1 have one hash, as -1 and -2: a table of such keys takes n^2.
        odd += isinstance(value, int) and not 0 <= value < 1 << 60
        if odd > _MOST_ODD:
            raise ValueError('contains too many negative or huge integers')
        # Bytes of numpy are encoded text; encoded repeatedly, such as in hex, they double.
        if texts and not ('PUT' in opcode.name or 'UNICODE' in opcode.name):
            raise ValueError('contains text that is encoded again')
        if 'PUT' in opcode.name:
            (tuples if before.startswith('TUPLE') else encoders if texts else set()).add(value)
        else:
            texts = value == '_codecs encode' if opcode.name == 'GLOBAL' else (
                'GET' in opcode.name and value in encoders)
        shared += 'GET' in opcode.name and value in tuples
        if shared > _MOST_SHARED:
            raise ValueError('contains nested tuples')
        before = opcode.name
