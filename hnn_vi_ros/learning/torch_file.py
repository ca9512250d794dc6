# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Load files of torch.save within limits that are checked before torch allocates memory.

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
import torch

# Types and functions that a state_dict of any tensors, or of an optimiser, needs.
_PLAIN = re.compile(
    r'collections OrderedDict|torch (?!\w*Tensor)\w+|torch\._utils _rebuild_\w+|torch\._tensor '
    r'_rebuild_from_type_v2|torch\.serialization _get_layout|torch\.nn\.parameter Parameter')
# Number of uses of a tuple that was already used: hashing nested ones takes 2^n.
_MOST_SHARED = 20
# Pickles at the start of a file before torch 1.6: number, version, system, object, keys.
_PICKLES = 5


def load_tensors(path: Path, most: int) -> Any:
    """
    Load the tensors, numbers and containers of a file of torch.save to the processor.

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
        The file is a pointer of Git LFS.
    ValueError
        The file contains other types.
    Exception
        Any exception of torch for a damaged file.

    """
    content = read_limited(path, most)
    refuse_pointer(content, path, ModelError)
    stream = BytesIO(content)
    if zipfile.is_zipfile(stream):
        stream = _checked_archive(stream, most)
    else:
        stream.seek(0)
        for _ in range(_PICKLES):
            _check_pickle(stream)
    stream.seek(0)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        return torch.load(stream, map_location='cpu', weights_only=True)


def _checked_archive(stream: BinaryIO, most: int) -> BytesIO:
    """Return a copy of an archive, of what was checked: torch finds members in its own way."""
    copy = BytesIO()
    with zipfile.ZipFile(stream) as archive, zipfile.ZipFile(copy, 'w') as checked:
        members = archive.infolist()
        if sum(member.file_size for member in members) > most:
            raise OSError(errno.EFBIG, f'unpacks to more than {in_bytes(most)}')
        for member in members:
            content = archive.read(member)
            if member.filename.lower().endswith('.pkl'):
                _check_pickle(BytesIO(content))
            checked.writestr(member.filename, content)
    return copy


def _check_pickle(stream: BinaryIO) -> None:
    """Read a pickle without running it; raise ValueError for other types than plain ones."""
    tuples, shared, before = set[object](), 0, ''
    for opcode, value, _ in pickletools.genops(stream):
        if opcode.name == 'GLOBAL' and not _PLAIN.fullmatch(str(value)):
            raise ValueError(f'contains {str(value)[:80]!r}')
        if 'PUT' in opcode.name and before.startswith('TUPLE'):
            tuples.add(value)
        shared += 'GET' in opcode.name and value in tuples
        if shared > _MOST_SHARED:
            raise ValueError('contains nested tuples')
        before = opcode.name
