# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Load training data from the source named by a configuration or on the command line."""

from collections.abc import Sequence
from dataclasses import replace
import os
from pathlib import Path
import re
from typing import Annotated, Any

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.arrays import Archive, ArraysData, read_arrays, split_runs
from hnn_vi_ros.learning.data.bag_signals import joint_names, SignalReader
from hnn_vi_ros.learning.data.bags import BagData, BagMotions, read_bags
from hnn_vi_ros.learning.data.dataset import (
    BLOCKS, Dataset, dataset_of, ExactData, MIN_ROWS, sample_exact)
from hnn_vi_ros.learning.data.header import column_of, COORDINATES, read_header
from hnn_vi_ros.learning.data.motions import (
    even_motions, EvenMotion, joined, Motion, MotionData, Recording)
from hnn_vi_ros.learning.data.text import LogMotions, MeasuredData, read_text
from hnn_vi_ros.phase_space import Coordinate
import numpy as np
from pydantic import Field

Source = Annotated[ExactData | MeasuredData | BagData | ArraysData | LogMotions,
                   Field(discriminator='kind')]
MotionSource = ArraysData | BagMotions | LogMotions
# Suffix of array files.
_ARRAYS = '.npz'


def dimension(data: Source) -> int | None:
    """Return the number of coordinates of a data source; None if only its arrays tell."""
    if isinstance(data, ArraysData):
        return None
    if isinstance(data, BagData):
        return len(data.joints)
    return len(data.box.q if isinstance(data, ExactData) else data.q)


def make_dataset(data: Source, seed: int, source: Path, given: Sequence[str] = (),
                 units: Sequence[str] = ()) -> Dataset:
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
    units : sequence of str
        Units of the coordinates.

    Raises
    ------
    DataError
        The data cannot be read, or files are given for exact data.

    """
    if isinstance(data, ExactData):
        if given:
            raise DataError(f'{source}: its data are exact, so --data {given[0]} is not used; '
                            'remove it')
        return sample_exact(data, seed)
    _refuse_commands(source, data)
    # Arrays are read for as many coordinates as there are units.
    recording = recording_of(source, data, units, given, units)
    return states_of(*even_motions(recording, data)) if isinstance(data, MotionData) else \
        dataset_of(recording, data)


def read_motions(source: Path, data: MotionSource, names: Sequence[str],
                 given: Sequence[str] = (), units: Sequence[str] = (), commanded: bool = False
                 ) -> tuple[list[EvenMotion], str]:
    """
    Read measured motions and resample them at even times.

    Parameters
    ----------
    source, given, units
        As in make_dataset; ``FILE:RUN,RUN`` selects runs of arrays.
    data : ArraysData, BagMotions or LogMotions
        Format of the data.
    names : sequence of str
        Names of the coordinates.
    commanded : bool, optional
        Accept commanded positions instead of forces.

    Returns
    -------
    list of EvenMotion and str
        The motions, which share one interval, and a description of the data.

    Raises
    ------
    DataError
        The motions cannot be read.

    """
    if data.measured and [*names] != data.measured:
        raise DataError(f'{source}: data.measured names only {", ".join(data.measured)} of the '
                        f'coordinates {", ".join(names)}; only identify supports this')
    if not commanded:
        _refuse_commands(source, data)
    return even_motions(recording_of(source, data, names, given, units), data)


def _refuse_commands(source: Path, data: Source | MotionSource) -> None:
    """Raise DataError for commanded positions, which are no forces."""
    if getattr(data, 'command', None):
        raise DataError(f'{source}: data.command: only hnn identify fits servos to commanded '
                        'positions; remove it, or use hnn identify')


def recording_of(source: Path, data: MeasuredData | BagData | MotionSource,
                 names: Sequence[str], given: Sequence[str], units: Sequence[str]) -> Recording:
    """Return the motions as measured."""
    if isinstance(data, BagData | BagMotions):
        return read_bags(bags_of(source, data.paths, given), data, names)
    hint = f', which is {data.source}' if isinstance(data, MeasuredData) and data.source else ''
    files = [Path(path) for path in given] or [one_file(source, data.path, given, hint)]
    if isinstance(data, MeasuredData | LogMotions):
        return _joined([read_text(file, data, units) for file in files], files)
    paths, runs = zip(*(split_runs(str(file)) if given else (file, []) for file in files),
                      strict=True)
    return _joined([read_arrays(path, data, len(names), own) for path, own in zip(
        paths, runs, strict=True)], paths)


def _joined(recordings: Sequence[Recording], files: Sequence[Path]) -> Recording:
    """Return the runs of all files, which are named after them if there are several."""
    if len(files) == 1:
        return recordings[0]
    distinct = len({file.stem for file in files}) == len(files)
    motions = [replace(motion, name='/'.join([
        file.stem if distinct else str(file), *[motion.name] * (len(one.motions) > 1)]))
        for one, file in zip(recordings, files, strict=True) for motion in one.motions]
    return Recording(motions, ', '.join(one.name for one in recordings),
                     ' '.join(one.digest for one in recordings))


def states_of(motions: Sequence[EvenMotion], description: str) -> Dataset:
    """Return the smoothed states of motions, with velocities as momenta, forces as commands."""
    t, q, v, a, tau = joined(motions, 't', 'q_smooth', 'v_smooth', 'a_smooth', 'tau')
    counts = [len(motion.t) for motion in motions]
    # At least MIN_ROWS rows, so that a block has windows of several steps.
    block = np.concatenate([
        np.arange(count) * max(1, min(BLOCKS, count // MIN_ROWS)) // count for count in counts])
    run = np.repeat(np.arange(len(counts)), counts)
    return Dataset(q, v, v, a, BLOCKS * run + block, description, t, run, a,
                   tau if tau.any() else None).checked()


def motions_of(dataset: Dataset, data: MotionData) -> tuple[list[EvenMotion], str]:
    """
    Convert states and rates to measured motions, with commands as forces.

    Raises
    ------
    DataError
        There are no times, or no motion has enough consecutive samples.

    """
    if dataset.t is None:
        raise DataError(f'{dataset.description}: single states, not motions; use data with times, '
                        'such as exact data with a trajectory')
    runs = []
    for number in np.unique(dataset.motion):
        rows = dataset.rows(dataset.motion == number)
        assert rows.t is not None, 'checked above'
        runs.append(Motion(
            str(number), f'{dataset.description}: motion {number}', rows.t, rows.q, rows.dq_dt,
            rows.commands, inputs='linear' if rows.commands is None else 'held'))
    return even_motions(Recording(runs, dataset.description, ''), data)


def one_file(source: Path, path: str, given: Sequence[str], hint: str = '') -> Path:
    """Return the one data file, given or configured; raise DataError for none or several."""
    if len(given) > 1:
        raise DataError(f'{source}: its data are one file, but --data has {len(given)}; merge '
                        'them')
    if not (given or path):
        raise DataError(f'{source}: data.path is empty; pass the file with --data FILE{hint}')
    return Path(given[0]) if given else _locate(source, path)


def bags_of(source: Path, paths: Sequence[str], given: Sequence[str]) -> list[Path]:
    """Return the given bags, or else the configured ones; raise DataError if there are none."""
    if not (given or paths):
        raise DataError(f'{source}: data.paths is empty; pass bags with --data BAG ...')
    return [Path(path) for path in given] or [_locate(source, path) for path in paths]


def _locate(source: Path, path: str) -> Path:
    """Return a file in the folder of the configuration if it exists, else the path as given."""
    beside = source.parent / path
    return beside if os.path.exists(beside) else Path(path)


def source_of(path: str, coordinates: Sequence[Coordinate] = (), counts: float | None = None,
              commanded: bool = False) -> MotionSource:
    """
    Find out how a file is read.

    Parameters
    ----------
    path : str
        Bag, arrays, or a text file, whose columns are found by their names.
    coordinates : sequence of Coordinate
        Coordinates of the scene or model.
    counts : float, optional
        Counts per turn of a coordinate of a log; default: as in its header.
    commanded : bool, optional
        Read commanded positions instead of forces.

    Raises
    ------
    DataError
        There is no such file, or a log has two readings.

    """
    file = _file_of(path, counts)
    if file.suffix == _ARRAYS:
        return ArraysData()
    if is_bag(file):
        topics = SignalReader(file, [one.name for one in coordinates]).command_topics() \
            if commanded else []
        if len(topics) > 1:
            raise DataError(f'{file}: {len(topics)} topics of commanded positions: '
                            f'{", ".join(topics)}; name one as data.command in --config')
        return BagMotions(command=topics[0] if topics else None)
    if not os.path.exists(file):
        raise DataError(f'{file}: no such file; give a bag, an .npz file of arrays, or a log')
    reading = read_header(file, coordinates, counts)
    return LogMotions.model_validate(reading.commanded if commanded else reading.data)


def _file_of(path: str, counts: float | None) -> Path:
    """Return the file without its runs; DataError for counts per turn of one that is no log."""
    file, _ = split_runs(path)
    if counts is not None and (file.suffix == _ARRAYS or is_bag(file)):
        raise DataError(f'{file}: --counts {counts:g} is for logs with named columns; remove it')
    return file


def is_bag(file: Path) -> bool:
    """Return whether a path has the name of a bag."""
    return file.is_dir() or file.suffix in ('.mcap', '.db3', '.yaml')


def configuration_of(given: Sequence[str], counts: float | None = None, usual: str = ''
                     ) -> dict[str, Any]:
    """
    Return a training configuration for the only reading of some data.

    Parameters
    ----------
    given : sequence of str
        Logs, arrays or bags.
    counts : float, optional
        See source_of.
    usual : str, optional
        Kind of coordinates of arrays and bags whose names do not tell it; default: refuse them.

    Raises
    ------
    DataError
        There is no reading, or there are two; the message has both.

    """
    file = _file_of(given[0], counts)
    if file.suffix == _ARRAYS:
        archive = Archive(file)
        q = archive.array(next((key for key in archive.arrays if key.rpartition('/')[2] == 'q'
                                ), 'q'))
        width = q.shape[1] if q.ndim > 1 else 1
        return _of_joints(f'{file}: q', {'kind': 'arrays', 'path': str(file)}, [
            f'q{k + 1}' if width > 1 else 'q' for k in range(width)], usual)
    if is_bag(file):
        return _of_joints(f'{file}: joint_states', {'kind': 'bag', 'paths': list(given)},
                          joint_names(file), usual)
    readings = [read_header(Path(path), counts=counts) for path in given]
    sections = [{**one.data, 'path': ''} for one in readings]
    for one, section in zip(readings, sections, strict=True):
        if section != sections[0]:
            raise DataError(f'{one.path}: its columns differ from those of {file}; give files of '
                            'one machine, with the same header')
    configuration = replace(readings[0], turns=[any(turns) for turns in zip(
        *(one.turns for one in readings), strict=True)]).configuration
    # A configuration names one file; several are given each time.
    return configuration if len(given) == 1 else configuration | {'data': sections[0]}


def _of_joints(where: str, data: dict[str, Any], names: Sequence[str], usual: str
               ) -> dict[str, Any]:
    """Return a configuration of joints; kinds follow from names, or are the usual one."""
    kinds = [column_of(name, {}).kind or usual for name in names]
    if not all(kinds):
        name = next(name for name, kind in zip(names, kinds, strict=True) if not kind)
        ways = ' or '.join(str({'name': name, **units}).replace("'", '')
                           for units in COORDINATES.values())
        raise DataError(f'{where}: {name} may be an angle or a length; write a configuration with '
                        f'family: {{kind: mechanical}}, data: {{kind: {data["kind"]}}} and '
                        f'coordinates: [{ways}]')
    return {'coordinates': [{'name': re.sub(r'\W+', '_', name)} | COORDINATES[kind]
                            for name, kind in zip(names, kinds, strict=True)],
            'data': data | ({'joints': [*names]} if 'paths' in data else {}),
            'family': {'kind': 'mechanical'}}
