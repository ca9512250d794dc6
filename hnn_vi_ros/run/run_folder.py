# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Where a run puts its files; nothing that exists is ever overwritten."""

from contextlib import suppress
from datetime import datetime, timezone
from itertools import count
from pathlib import Path

from hnn_vi_ros.errors import RecordingError


def create_run_folder(scene: str, home: Path) -> Path:
    """
    Create ``runs/<scene>-<UTC time>`` in a folder, with a number if it is taken.

    Raises
    ------
    RecordingError
        The folder cannot be created.

    """
    stem = f'{scene}-{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}'
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
