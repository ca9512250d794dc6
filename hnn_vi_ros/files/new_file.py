# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check of a file that a command is to write, before the command spends time on its content."""

import os
from pathlib import Path

from hnn_vi_ros.errors import ParameterError


def check_new(option: str, path: Path) -> None:
    """
    Check that a file or folder can be written, and make the folder that it is to stand in.

    Parameters
    ----------
    option : str
        The option of the command line that names it, such as ``--out``.
    path : Path
        What is to be written.

    Raises
    ------
    ParameterError
        It exists already, or it cannot be written.

    """
    if os.path.lexists(path):
        raise ParameterError(f'{option} {path}: exists already; name another file')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        path.unlink()
    except OSError as problem:
        raise ParameterError(f'{option} {path}: cannot be written ({problem.strerror}); name '
                             'another file') from problem
