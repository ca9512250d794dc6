# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Say at the end of a run where its files are, and how each is opened."""

from collections.abc import Sequence
import os
from pathlib import Path
import shlex
import shutil
import sys


def tell_files(bags: Sequence[Path], picture: Path | None) -> None:
    """
    Print where bags and a picture are, and the command that opens each.

    Parameters
    ----------
    bags : sequence of Path
        Their folders.
    picture : Path or None
        The recording of the viewer, if there is one.

    """
    lines = []
    for bag in map(_from_here, bags):
        file = bag / f'{bag.name}_0.mcap'
        lines.append(f'bag        {bag}')
        if not file.exists():
            lines.append('  was removed')
            continue
        if not (bag / 'metadata.yaml').exists():
            lines.append('  is not complete')
            continue
        if shutil.which('ros2'):
            lines.append(f'  open it  {_command("ros2", "bag", "play", bag)}')
        lines.append(f'  open it  {_command(_rerun(), file)}')
    picture = picture and _from_here(picture)
    if picture is not None:
        lines.append(f'recording  {picture}')
    if picture is not None and not picture.exists():
        lines.append('  was removed')
    elif picture is not None:
        lines.append(f'  open it  {_command(_rerun(), picture)}')
    if lines:
        sys.stdout.write('\n'.join(lines) + '\n')
        sys.stdout.flush()


def _from_here(path: Path) -> Path:
    """Return a path as it is called in the working directory, if it lies there."""
    try:
        return path.relative_to(Path.cwd())
    except (ValueError, FileNotFoundError):
        # It lies elsewhere, or the working directory was removed.
        return path


def _rerun() -> Path | str:
    """Return the viewer that is installed beside this interpreter, or its name on the PATH."""
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
