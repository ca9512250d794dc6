# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files that commands write: checked before anything is simulated, so that no time is lost."""

from collections.abc import Callable, Mapping
import os
from pathlib import Path

from hnn_vi_ros.errors import ParameterError

# Suffixes by option; options that are not listed take any.
_PICTURES = ('.png', '.svg', '.pdf')
SUFFIXES = {'--plot': _PICTURES, '--portrait': _PICTURES, '--animate': ('.gif',),
            '--rerun': ('.rrd',)}


def check_outputs(paths: Mapping[str, Path | None]) -> None:
    """
    Check that files can be written.

    Parameters
    ----------
    paths : mapping
        By option; None where one is not asked for.

    Raises
    ------
    ParameterError
        A file has another suffix, exists already, or its folder does not exist.

    """
    for option, path in paths.items():
        if path is None:
            continue
        valid = SUFFIXES.get(option, (path.suffix,))
        if path.suffix not in valid:
            raise ParameterError(f'{option} {path}: no file of this kind can be written; valid: '
                                 f'{", ".join(valid)}')
        if os.path.lexists(path):
            raise ParameterError(f'{option} {path}: exists already; name another file')
        if not path.parent.is_dir():
            raise ParameterError(f'{option} {path}: no folder {str(path.parent)!r}; make it first')


def write_outputs(paths: Mapping[str, Path | None],
                  writers: Mapping[str, Callable[[Path], object]]) -> None:
    """
    Write the files that are asked for, and print the path of each.

    Parameters
    ----------
    paths : mapping
        See ``check_outputs``.
    writers : mapping
        By option, what writes to a path.

    Raises
    ------
    ParameterError
        A file cannot be written, or would be empty.

    """
    for option, write in writers.items():
        path = paths[option]
        if path is None:
            continue
        try:
            write(path)
        except OSError as problem:
            raise ParameterError(f'{option} {path}: cannot be written '
                                 f'({problem.strerror or problem})') from problem
        except ValueError as problem:
            raise ParameterError(f'{option} {path}: {problem}') from problem
        print(path)
