# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Say at the end of a run where its files are, and how each is opened."""

from collections.abc import Sequence
import os
from pathlib import Path
import shlex
import shutil
import sys


def bag_lines(bag: Path) -> list[str]:
    """Return lines that say where a bag is, and the commands that open it."""
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
    """Return lines that say where a recording of the viewer is, and the command that opens it."""
    picture = _from_here(picture)
    return [f'recording  {picture}', f'  open it  {_command(_rerun(), picture)}'
            if picture.exists() else '  was removed']


def report_files(lines: Sequence[str]) -> None:
    """Print what is to be said of all files."""
    if lines:
        sys.stdout.write('\n'.join(lines) + '\n')
        sys.stdout.flush()


def _from_here(path: Path) -> Path:
    """Return a path relative to the working directory, if it lies there."""
    try:
        return path.relative_to(Path.cwd())
    except (ValueError, FileNotFoundError):
        # It lies elsewhere, or the working directory was removed.
        return path


def _rerun() -> Path | str:
    """Return the viewer that is installed with this interpreter, or its name on the PATH."""
    beside = Path(sys.prefix) / 'bin' / 'rerun'
    if not beside.exists():
        return 'rerun'
    try:
        here = os.path.relpath(beside)
    except FileNotFoundError:
        # The working directory was removed.
        return beside
    return beside if here.startswith('..') else here


def _command(*words: object) -> str:
    return shlex.join(str(word) for word in words)
