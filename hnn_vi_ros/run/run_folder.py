# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Folder of a run's files; nothing that exists is ever overwritten."""

from contextlib import suppress
from datetime import datetime, UTC
from itertools import count
import os
from pathlib import Path
from typing import final

from hnn_vi_ros.errors import RecordingError


def create_run_folder(scene: str, home: Path) -> Path:
    """
    Create ``runs/<scene>-<UTC time>`` in a folder, with a number if it is taken.

    Raises
    ------
    RecordingError
        The folder cannot be created.

    """
    stem = f'{scene}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}'
    runs = folder = home / 'runs'
    try:
        folder.mkdir(exist_ok=True)
        for number in count(1):
            folder = runs / (stem if number == 1 else f'{stem}-{number}')
            # Not looked for before: another process may make it in between.
            with suppress(FileExistsError):
                folder.mkdir()
                return folder
    except OSError as problem:
        raise RecordingError(
            f'{folder} cannot be created ({problem.strerror}); set record_path and '
            'rerun_path to a place that can be written') from problem


@final
class RunFiles:
    """
    Names of a run's files: those that are asked for, or in a folder of the run's own.

    Later ones of a name get a number: nothing is ever overwritten.
    """

    def __init__(self):
        self._home = _working_folder()
        self._folder: Path | None = None
        self._used: set[Path] = set()

    def free(self, asked: str, default: str, scene: str) -> Path:
        """
        Return an absolute path for a file.

        Parameters
        ----------
        asked : str
            The user's name for it; empty for a default.
        default : str
            Its name in the run's folder, which is made then.
        scene : str
            Name of the scene, for the folder.

        Raises
        ------
        RecordingError
            The folder cannot be created.

        """
        if asked:
            first = self._home / os.path.expanduser(asked)
        else:
            self._folder = self._folder or create_run_folder(scene, self._home)
            first = self._folder / default
        path, number = first, 1
        while path in self._used or (number > 1 and path.exists()):
            number += 1
            path = first.with_name(f'{first.stem}-{number}{first.suffix}')
        self._used.add(path)
        return path


def _working_folder() -> Path:
    """Return the absolute path that others are relative to; an empty one if it was removed."""
    try:
        return Path.cwd()
    except FileNotFoundError:
        return Path()
