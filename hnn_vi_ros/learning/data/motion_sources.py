# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions from wherever a configuration or a command line says that they are."""

from collections.abc import Sequence
import os
from pathlib import Path

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motion_arrays import ArraysData, read_arrays, split_runs
from hnn_vi_ros.learning.data.motion_bags import BagMotions, read_bag_motions
from hnn_vi_ros.learning.data.motion_logs import LogMotions, read_log_motions
from hnn_vi_ros.learning.data.motions import Motion

MotionSource = ArraysData | BagMotions | LogMotions
# Of files that are no bag and no log.
_ARRAYS = '.npz'


def read_motions(source: Path, data: MotionSource, names: Sequence[str], given: Sequence[str] = ()
                 ) -> tuple[list[Motion], str]:
    """
    Read measured motions.

    Parameters
    ----------
    source : Path
        The file of the configuration, for messages; paths in it are looked up beside it, then in
        the working directory.
    data : ArraysData, BagMotions or LogMotions
        What is where.
    names : sequence of str
        Of the coordinates.
    given : sequence of str
        Files in place of those of the data; ``FILE:RUN,RUN`` for some runs of arrays.

    Returns
    -------
    list of Motion and str
        The motions, which share one interval, and what they are.

    Raises
    ------
    DataError
        They cannot be read.

    """
    if isinstance(data, BagMotions):
        paths = [Path(path) for path in given] or [_beside(source, path) for path in data.paths]
        if not paths:
            raise DataError(f'{source}: data.paths is empty; pass bags with --data BAG ...')
        motions, description = read_bag_motions(paths, data, names)
    else:
        if len(given) > 1 or not (given or data.path):
            raise DataError(f'{source}: expected one file, in data.path or with --data FILE; it '
                            f'has {len(given)}')
        path, runs = split_runs(given[0]) if given and isinstance(data, ArraysData) else (
            Path(given[0]) if given else _beside(source, data.path), [])
        motions, description = read_arrays(path, data, len(names), runs) if isinstance(
            data, ArraysData) else read_log_motions(path, data)
    return motions, description


def guessed(path: str) -> ArraysData | BagMotions:
    """Return how a file is read that nothing is said of: arrays, or a bag; or raise DataError."""
    file, _ = split_runs(path)
    if file.suffix == _ARRAYS:
        return ArraysData()
    if file.is_dir() or file.suffix in ('.mcap', '.db3', '.yaml'):
        return BagMotions()
    if not os.path.exists(file):
        raise DataError(f'{file}: no such file; give a bag, or an .npz file of arrays')
    raise DataError(f'{file}: expected a bag, or an .npz file of arrays; of a text file, name the '
                    'columns in the data of a training configuration, and give that with --config')


def _beside(source: Path, path: str) -> Path:
    beside = source.parent / path
    return beside if os.path.exists(beside) else Path(path)
