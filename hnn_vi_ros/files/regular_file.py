# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Open regular files, and reject pointers and special files."""

from collections.abc import Iterator
from contextlib import contextmanager
import errno
from io import BufferedReader
from itertools import count
import os
from pathlib import Path
import stat

from hnn_vi_ros.errors import HnnViRosError

_LFS_POINTER = b'version https://git-lfs'


def refuse_pointer(raw: bytes, where: object, error: type[HnnViRosError]) -> None:
    """
    Raise an error if a file is only a pointer.

    Parameters
    ----------
    raw : bytes
        Content of the file, or its first 32 bytes.
    where : object
        Name of the file.
    error : type of HnnViRosError
        Exception to raise, with one line.

    """
    if raw.startswith(_LFS_POINTER):
        raise error(f'{where}: a Git LFS pointer instead of the file; fetch the file with: git '
                    'lfs pull')


def open_no_link(path: str, flags: int, mode: int = 0o666) -> int:
    """Open a file unless it is a link, and never wait for a FIFO; an `opener` of ``open``."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, mode)


def numbered_paths(path: Path, suffix: str = '') -> Iterator[Path]:
    """Yield a path, then variants with -2, -3 and so on before the suffix."""
    yield path
    for number in count(2):
        yield path.with_name(f'{path.name.removesuffix(suffix)}-{number}{suffix}')


def no_file(path: Path, missing: str = 'no such file') -> str:
    """Describe the object at a path that cannot be read as a file."""
    if os.path.isdir(path):
        bag = os.path.exists(path / 'metadata.yaml')
        return 'is a bag, which hnn replay reads' if bag else 'is a folder'
    return 'is not a regular file' if os.path.exists(path) else missing


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading; raise OSError for a FIFO, which may block, or a device."""
    try:
        if stat.S_ISREG(os.stat(path).st_mode):
            handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            # The path may have been replaced in between.
            if stat.S_ISREG(os.fstat(handle).st_mode):
                return os.fdopen(handle, 'rb')
            os.close(handle)
    except ValueError as problem:  # the name is not valid for a file
        raise OSError(errno.EINVAL, str(problem)) from problem
    raise OSError(errno.EINVAL, no_file(path))


@contextmanager
def limited(path: Path, most: int) -> Iterator[BufferedReader]:
    """
    Open a regular file for reading.

    Raises
    ------
    OSError
        It is not a regular file, cannot be read, or is larger than `most` bytes.

    """
    with open_regular(path) as stream:
        if os.fstat(stream.fileno()).st_size > most:
            raise OSError(errno.EFBIG, f'larger than {in_bytes(most)}')
        yield stream


def read_limited(path: Path, most: int) -> bytes:
    """Return the content of a regular file; see ``limited``."""
    with limited(path, most) as stream:
        # Files of the kernel (/proc) may be larger than their reported size.
        content = stream.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f'larger than {in_bytes(most)}')
    return content


def in_bytes(count: int) -> str:
    """Return a size with its unit."""
    unit, shift = next(((unit, shift) for unit, shift in (('GiB', 30), ('MiB', 20), ('KiB', 10))
                        if count >> shift), ('bytes', 0))
    return f'{count / (1 << shift):.4g} {unit}'
