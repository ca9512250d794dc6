# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Load training data from the source named by a configuration or on the command line."""

from collections.abc import Sequence
import os
from pathlib import Path
from typing import Annotated

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.arrays import ArraysData, read_arrays, split_runs
from hnn_vi_ros.learning.data.bags import BagData, BagMotions, read_bags
from hnn_vi_ros.learning.data.dataset import Dataset, dataset_of, ExactData, sample_exact
from hnn_vi_ros.learning.data.motions import (
    even_motions, EvenMotion, Motion, MotionData, Recording)
from hnn_vi_ros.learning.data.text import LogMotions, MeasuredData, read_text
import numpy as np
from pydantic import Field

Source = Annotated[ExactData | MeasuredData | BagData, Field(discriminator='kind')]
MotionSource = ArraysData | BagMotions | LogMotions
# Suffix of array files.
_ARRAYS = '.npz'


def dimension(data: Source) -> int:
    """Return the number of coordinates of a data source."""
    if isinstance(data, BagData):
        return len(data.joints)
    return len(data.box.q if isinstance(data, ExactData) else data.q)


def make_dataset(data: Source, seed: int, source: Path, given: Sequence[str] = ()) -> Dataset:
    """
    Sample or read states and their rates of change.

    Parameters
    ----------
    data : Source
        Data source.
    seed : int
        Seed of the random samples.
    source : Path
        Path of the configuration; relative data paths are looked up in its folder,
        then in the working directory.
    given : sequence of str
        Files that override the configured ones.

    Raises
    ------
    DataError
        The data cannot be read, or files are given for exact data.

    """
    if isinstance(data, ExactData):
        if given:
            raise DataError(f'{source}: its data is exact, so --data {given[0]} has no use; '
                            'leave it out')
        return sample_exact(data, seed)
    return dataset_of(_recording(source, data, (), given), data)


def read_motions(source: Path, data: MotionSource, names: Sequence[str], given: Sequence[str] = ()
                 ) -> tuple[list[EvenMotion], str]:
    """
    Read measured motions and resample them at even times.

    Parameters
    ----------
    source, given
        As in make_dataset; ``FILE:RUN,RUN`` selects runs of arrays.
    data : ArraysData, BagMotions or LogMotions
        Format of the data.
    names : sequence of str
        Names of the coordinates.

    Returns
    -------
    list of EvenMotion and str
        The motions, which share one interval, and a description of the data.

    Raises
    ------
    DataError
        The motions cannot be read.

    """
    return even_motions(_recording(source, data, names, given), data)


def _recording(source: Path, data: MeasuredData | BagData | MotionSource, names: Sequence[str],
               given: Sequence[str]) -> Recording:
    """Return the motions as measured."""
    if isinstance(data, BagData | BagMotions):
        return read_bags(bags_of(source, data.paths, given), data, names)
    hint = f', which is {data.source}' if isinstance(data, MeasuredData) and data.source else ''
    file = one_file(source, data.path, given, hint)
    if isinstance(data, MeasuredData | LogMotions):
        return read_text(file, data)
    path, runs = split_runs(str(file)) if given else (file, [])
    return read_arrays(path, data, len(names), runs)


def motions_of(dataset: Dataset, data: MotionData) -> tuple[list[EvenMotion], str]:
    """
    Convert states and rates to measured motions, with commands as forces.

    Raises
    ------
    DataError
        There are no times, or no motion has enough consecutive samples.

    """
    if dataset.t is None:
        raise DataError(f'{dataset.description}: no motions, but single states; give data with '
                        'times, such as exact data with a trajectory')
    runs = []
    for number in np.unique(dataset.motion):
        rows = dataset.rows(dataset.motion == number)
        assert rows.t is not None, 'checked above'
        runs.append(Motion(
            str(number), f'{dataset.description}: motion {number}', rows.t, rows.q, rows.dq_dt,
            rows.commands, held=rows.commands is not None))
    return even_motions(Recording(runs, dataset.description, ''), data)


def one_file(source: Path, path: str, given: Sequence[str], hint: str = '') -> Path:
    """Return the one data file, given or configured; raise DataError for none or several."""
    if len(given) > 1:
        raise DataError(f'{source}: its data are one file, but --data has {len(given)}; join '
                        'them')
    if not (given or path):
        raise DataError(f'{source}: data.path is empty; pass the file with --data FILE{hint}')
    return Path(given[0]) if given else _beside(source, path)


def bags_of(source: Path, paths: Sequence[str], given: Sequence[str]) -> list[Path]:
    """Return the given bags, or else the configured ones; raise DataError if there are none."""
    if not (given or paths):
        raise DataError(f'{source}: data.paths is empty; pass bags with --data BAG ...')
    return [Path(path) for path in given] or [_beside(source, path) for path in paths]


def _beside(source: Path, path: str) -> Path:
    """Return a file in the folder of the configuration if it exists, else the path as given."""
    beside = source.parent / path
    return beside if os.path.exists(beside) else Path(path)


def guessed(path: str) -> ArraysData | BagMotions:
    """Guess the format of a file from its name, arrays or a bag; DataError if unknown."""
    file, _ = split_runs(path)
    if file.suffix == _ARRAYS:
        return ArraysData()
    if file.is_dir() or file.suffix in ('.mcap', '.db3', '.yaml'):
        return BagMotions()
    if not os.path.exists(file):
        raise DataError(f'{file}: no such file; give a bag, or an .npz file of arrays')
    raise DataError(f'{file}: expected a bag, or an .npz file of arrays; of a text file, name the '
                    'columns in the data of a training configuration, and give that with --config')
