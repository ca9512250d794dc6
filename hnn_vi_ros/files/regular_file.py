# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Open regular files, reject pointers and special files, and write new files."""

from collections.abc import Iterator
from contextlib import contextmanager
import errno
from io import BufferedReader, BufferedWriter
from itertools import count
import os
from pathlib import Path
from secrets import token_hex
import stat

from hnn_vi_ros.errors import HnnViRosError, ParameterError, SceneError

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


def check_new(option: str, path: Path, other: str = '') -> None:
    """
    Check that a file or folder can be written, and create its parent folder.

    Parameters
    ----------
    option : str
        Option of the command line that names it, such as ``--out``.
    path : Path
        Path of the file or folder to write.
    other : str, optional
        End of the message if it exists, such as another remedy.

    Raises
    ------
    ParameterError
        It exists already, or it cannot be written.

    """
    if os.path.lexists(path):
        raise ParameterError(f'{option} {path}: exists already; name another file{other}')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open('xb').close()
        path.unlink()
    except OSError as problem:
        raise ParameterError(f'{option} {path}: cannot be written ({problem.strerror}); name '
                             'another file') from problem


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """
    Yield a temporary file next to a file, which it replaces if no error occurs.

    The replacement is atomic: a full disk or a power failure leaves the old file intact.
    """
    with temporary_beside(path) as (temporary, _):
        yield temporary
        # Opened again, since the writer may have created it again.
        with open(temporary, 'rb', opener=open_no_link) as written:
            os.fsync(written.fileno())
        temporary.replace(path)


@contextmanager
def temporary_beside(path: Path, mode: int = 0o666) -> Iterator[tuple[Path, BufferedWriter]]:
    """
    Create a temporary file next to another file; yield its path and a stream that writes to it.

    Nobody can foresee its name, and it is created exclusively (O_EXCL): in a folder that others
    can write to as well, it is neither their file nor a link of theirs. It is removed at the end
    unless it was renamed.

    Parameters
    ----------
    path : Path
        The other file.
    mode : int, optional
        Permissions, which the umask restricts further; ``tempfile`` would give 0600 to files for
        others to read.

    """
    temporary = path.with_name(f'.{path.stem}.{token_hex(8)}{path.suffix}')

    def create(name: str, flags: int) -> int:
        try:
            return open_no_link(name, flags, mode)
        except OSError as problem:
            # Users know the other file.
            raise type(problem)(problem.errno, problem.strerror, str(path)) from None
    with open(temporary, 'xb', opener=create) as stream:
        try:
            yield temporary, stream
        finally:
            temporary.unlink(missing_ok=True)


def open_no_link(path: str, flags: int, mode: int = 0o666) -> int:
    """Open a file unless it is a symbolic link; for the argument `opener` of ``open``."""
    return os.open(path, flags | os.O_NOFOLLOW, mode)


def _put_on_disk(stream: BufferedWriter, content: bytes) -> None:
    stream.write(content)
    stream.flush()
    os.fsync(stream.fileno())


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 to a file atomically, replacing it."""
    with temporary_beside(path) as (temporary, stream):
        _put_on_disk(stream, text.encode())
        temporary.replace(path)


def write_new(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a new file atomically; raise FileExistsError if it exists."""
    with temporary_beside(path, mode) as (temporary, stream):
        _put_on_disk(stream, content)
        try:
            os.link(temporary, path)
        except FileExistsError:
            raise
        except OSError:  # the file system has no hard links
            path.open('xb').close()
            temporary.replace(path)


def write_new_scene(path: Path, text: str, force: bool = False) -> None:
    """
    Write the text of a scene; with ``force``, replace an existing file.

    Raises
    ------
    SceneError
        The file exists already, or cannot be written.

    """
    try:
        if force:
            write_text(path, text)
        else:
            write_new(path, text.encode())
    except FileExistsError as problem:
        raise SceneError(f'{path}: exists already; name another file, or add --force') from problem
    except OSError as problem:
        raise SceneError(f'{path}: cannot be written ({problem.strerror}); name another file'
                         ) from problem


def numbered_paths(path: Path, suffix: str = '') -> Iterator[Path]:
    """Yield a path, then variants with -2, -3 and so on before the suffix."""
    yield path
    for number in count(2):
        yield path.with_name(f'{path.name.removesuffix(suffix)}-{number}{suffix}')


def no_file(path: Path, missing: str = 'no such file') -> str:
    """Describe the object at a path that cannot be read as a file."""
    if os.path.isdir(path):
        bag = os.path.exists(path / 'metadata.yaml')
        return 'is a bag, which hnn replay and hnn rerun_bridge read' if bag else 'is a folder'
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
