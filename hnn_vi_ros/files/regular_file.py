# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Open files, and nothing that only looks like one."""

import errno
import os
from pathlib import Path
import stat
from typing import BinaryIO

from hnn_vi_ros.errors import RecordingError


def no_file(path: Path, missing: str = 'no such file') -> str:
    """Return what there is in the place of a file that cannot be read as one."""
    if os.path.isdir(path):
        return 'is a folder'
    return 'is no regular file' if os.path.exists(path) else missing


def regular(path: Path) -> Path:
    """Return a path to read, or raise OSError: a FIFO would be waited for, a device never end."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise OSError(errno.EINVAL, no_file(path))
    return path


def open_file(path: Path, name: Path) -> BinaryIO:
    """
    Return a stream of a regular file; a FIFO without a writer does not hold it up.

    Parameters
    ----------
    path : Path
        The file.
    name : Path
        How the user calls it.

    Raises
    ------
    RecordingError
        It is a folder, a device, a FIFO or a socket.
    OSError
        It cannot be opened.

    """
    # First: to open a device may be to do something.
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise RecordingError(f'{name}: is no regular file; give the folder of a bag, or its file')
    stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), 'rb')
    return stream
