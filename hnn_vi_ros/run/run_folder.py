# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Folder of the files of a run, which overwrites nothing, and lines on how to open the files."""

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, UTC
import os
from pathlib import Path
import shlex
import shutil
import sys
from typing import final

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import numbered_paths


def bag_lines(bag: Path) -> list[str]:
    """Return lines with the path of a bag and the commands that open it."""
    bag = _from_here(bag)
    file = bag / f'{bag.name}_0.mcap'
    line = f'bag        {bag}'
    if not file.exists():
        return [line, '  was removed']
    if not (bag / 'metadata.yaml').exists():
        return [line, '  is not complete']
    play = [f'  open it  {_command("ros2", "bag", "play", bag)}'] if shutil.which('ros2') else []
    return [line, *play, f'  open it  {_command(_rerun(), file)}']


def picture_lines(picture: Path) -> list[str]:
    """Return lines with the path of a viewer recording and the command that opens it."""
    picture = _from_here(picture)
    return [f'recording  {picture}', f'  open it  {_command(_rerun(), picture)}'
            if picture.exists() else '  was removed']


def report_files(lines: Sequence[str]) -> None:
    """Print the lines on all files."""
    if lines:
        sys.stdout.write('\n'.join(lines) + '\n')
        sys.stdout.flush()


def _from_here(path: Path) -> Path:
    """Return a path relative to the working directory if it is inside, else unchanged."""
    home = working_folder()
    return path.relative_to(home) if path.is_relative_to(home) else path


def _rerun() -> Path | str:
    """Return the viewer installed with this interpreter, or its name on the PATH."""
    beside = Path(sys.prefix) / 'bin' / 'rerun'
    return _from_here(beside) if beside.exists() else 'rerun'


def _command(*words: object) -> str:
    return shlex.join(str(word) for word in words)


def create_run_folder(scene: str, home: Path) -> Path:
    """
    Create ``runs/<scene>-<UTC time>`` in a folder; append a number if the name is taken.

    Raises
    ------
    RecordingError
        The folder cannot be created.

    """
    folder = runs = home / 'runs'
    try:
        runs.mkdir(exist_ok=True)
        for folder in numbered_paths(runs / f'{scene}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}'):
            # Not checked beforehand, because another process may create the folder in between.
            with suppress(FileExistsError):
                folder.mkdir()
                break
        return folder
    except OSError as problem:
        raise RecordingError(
            f'{folder} cannot be created ({problem.strerror}); set record_path and rerun_path to '
            'a writable folder') from problem


@final
class RunFiles:
    """
    Names of the files of a run: as requested, or in the folder of the run.

    Later files of the same name get a number, so that nothing is overwritten.
    """

    def __init__(self) -> None:
        self._home = working_folder()
        self._folder: Path | None = None
        self._used: set[Path] = set()

    def free(self, asked: str, default: str, scene: str) -> Path:
        """
        Return a free absolute path for a file.

        Parameters
        ----------
        asked : str
            Path given by the user; empty for the default.
        default : str
            Name in the folder of the run, which is created if needed.
        scene : str
            Name of the scene, used in the name of the folder.

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
        path = next(path for path in numbered_paths(first, first.suffix) if path not in self._used
                    and not (path != first and path.exists()))
        self._used.add(path)
        return path


def working_folder() -> Path:
    """Return the working directory, an empty path if it was removed."""
    try:
        return Path.cwd()
    except FileNotFoundError:
        return Path()
