# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Write files: whole or not at all, and never through a link.

All files are written with ``written``, except recordings that grow while a run lasts.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import errno
import fcntl
from glob import escape
from io import BufferedWriter
import os
from pathlib import Path
from secrets import token_hex
import stat
import time
from typing import Any

from hnn_vi_ros.errors import ParameterError, SceneError
from hnn_vi_ros.files.regular_file import no_file, open_no_link

# Age up to which temporary files are not removed [s].
_YOUNG = 60.0


def make_folder(path: Path, new: bool = False) -> None:
    """Create a folder and its parents; raise FileExistsError if it must be new and exists."""
    try:
        path.mkdir(parents=True, exist_ok=not new)
    except RecursionError as problem:
        raise OSError(errno.ENAMETOOLONG, 'too many folders', str(path)) from problem


@contextmanager
def written(path: Path, new: bool = False, mode: int = 0o666, synced: bool = True
            ) -> Iterator[BufferedWriter]:
    """
    Yield a stream to a temporary file, which gets its name at the end if no error occurs.

    The change is atomic: after an error, a kill, a power failure, or on a full disk, the earlier
    file is still there. A link with this name is replaced, not followed. An error names the file.

    Parameters
    ----------
    path : Path
        File to write; one of this user that is replaced keeps its permissions.
    new : bool, optional
        True to raise FileExistsError if the file exists at the end.
    mode : int, optional
        Permissions of a new file, which the umask restricts further.
    synced : bool, optional
        False for files that are checked when they are read, and may be lost.

    """
    with _temporary(path, mode) as stream:
        yield stream
        stream.flush()
        # Opened again, since the writer may have created it again.
        with open(stream.name, 'rb+', opener=open_no_link) as content:
            if synced:
                os.fsync(content.fileno())
            if new:
                try:
                    os.link(stream.name, path)
                    return
                except FileExistsError:
                    raise
                except OSError:  # the file system has no hard links
                    path.open('xb').close()
            if path.exists() and not path.is_file():
                raise OSError(errno.EINVAL, no_file(path))
            if not new and os.path.lexists(path):
                there = path.lstat()
                if stat.S_ISREG(there.st_mode) and there.st_uid == os.getuid():
                    os.fchmod(content.fileno(), stat.S_IMODE(there.st_mode))
            os.replace(stream.name, path)


@contextmanager
def _temporary(path: Path, mode: int = 0o666) -> Iterator[BufferedWriter]:
    """
    Yield a stream to a temporary file next to another file; remove it at the end.

    Nobody can foresee its name, and it is created exclusively (O_EXCL): in a folder that others
    can write to as well, it is neither their file nor a link of theirs. It is locked while its
    process lives; the next writer of the file removes one that a kill has left.
    """
    # Short, since the name of the file may be the longest possible.
    start = f'.{path.stem[:40]}.'
    for left in path.parent.glob(f'{escape(start)}{"[0-9a-f]" * 16}{escape(path.suffix)}'):
        _remove_abandoned(left)
    temporary = path.with_name(f'{start}{token_hex(8)}{path.suffix}')
    try:
        with open(temporary, 'xb', opener=lambda name, flags: open_no_link(
                name, flags, mode)) as stream:
            try:
                with suppress(OSError):  # file systems without locks
                    fcntl.flock(stream, fcntl.LOCK_EX)
                yield stream
            finally:
                temporary.unlink(missing_ok=True)
    except OSError as problem:
        # Users know the other file.
        if problem.filename in (None, str(temporary)):
            problem.filename = str(path)
        raise


def _remove_abandoned(path: Path) -> None:
    """Remove a temporary file of this user that no process writes to."""
    with suppress(OSError), open(path, 'rb', opener=open_no_link) as stream:
        state = os.fstat(stream.fileno())
        # A younger one may not be locked yet.
        if (stat.S_ISREG(state.st_mode) and state.st_uid == os.getuid()
                and time.time() - state.st_mtime > _YOUNG):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


def write_bytes(path: Path, content: bytes, new: bool = False, mode: int = 0o666) -> None:
    """Write a file; see ``written``."""
    with written(path, new, mode) as stream:
        stream.write(content)


def write_text(path: Path, text: str, new: bool = False) -> None:
    """Write a text in UTF-8; see ``written``."""
    write_bytes(path, text.encode(), new)


def save_figure(target: Path | BufferedWriter, figure: Any, dpi: float | str = 'figure') -> None:
    """Write a figure of matplotlib in the format of the suffix, to a file or its stream."""
    if isinstance(target, Path):
        with written(target) as stream:
            save_figure(stream, figure, dpi)
    else:
        figure.savefig(target, dpi=dpi, format=Path(target.name).suffix[1:] or None)


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
        make_folder(path.parent)
        with _temporary(path):
            pass
    except OSError as problem:
        raise ParameterError(f'{option} {path}: cannot be written ({problem.strerror}); name '
                             'another file') from problem


def write_new_scene(path: Path, text: str, force: bool = False) -> None:
    """
    Write the text of a scene; with ``force``, replace an existing file.

    Raises
    ------
    SceneError
        The file exists already, or cannot be written.

    """
    try:
        write_text(path, text, new=not force)
    except FileExistsError as problem:
        raise SceneError(f'{path}: exists already; name another file, or add --force') from problem
    except OSError as problem:
        raise SceneError(f'{path}: cannot be written ({problem.strerror}); name another file'
                         ) from problem
