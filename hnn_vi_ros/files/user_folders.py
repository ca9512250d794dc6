# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of the user: the cache folder, even without a home, as in some containers."""

import os
from pathlib import Path
import stat
import tempfile


def expand_user(path: str | Path) -> Path:
    """Return a path with ``~`` as the home; unchanged if the user, or ``~NAME``, has none."""
    return Path(os.path.expanduser(path))


def usual_folder(variable: str = 'XDG_CACHE_HOME', name: str = '.cache') -> Path | None:
    """Return the folder that a variable names, or that in the home; None if it is read-only."""
    folder = Path(os.environ.get(variable) or expand_user('~') / name)
    return folder if folder.is_absolute() and can_be_written(folder) else None


def cache_folder() -> Path:
    """Return where caches of the user are: the usual folder, else a private one."""
    return usual_folder() or private_folder()


def private_folder() -> Path:
    """
    Return a folder of this user alone among temporary files, the same each time.

    What others can write is not taken: cached code is run. There it is another one each time.
    """
    folder = Path(tempfile.gettempdir(), f'hnn_vi_ros-cache-{os.getuid()}')
    folder.mkdir(mode=0o700, exist_ok=True)
    there = folder.lstat()
    if (stat.S_ISDIR(there.st_mode) and there.st_uid == os.getuid()
            and not there.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return folder
    return Path(tempfile.mkdtemp(prefix='hnn_vi_ros-cache-'))


def can_be_written(folder: Path) -> bool:
    """Return whether files can be made in a folder, which need not exist yet."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return os.access(folder, os.W_OK)
