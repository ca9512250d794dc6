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
    """Print where bags and a picture are, and the command that opens each."""
    lines = []
    for bag in bags:
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
    if picture is not None:
        lines.append(f'recording  {picture}')
    if picture is not None and not picture.exists():
        lines.append('  was removed')
    elif picture is not None:
        lines.append(f'  open it  {_command(_rerun(), picture)}')
    if lines:
        sys.stdout.write('\n'.join(lines) + '\n')
        sys.stdout.flush()


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
