# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions from arrays in an .npz file."""

from collections.abc import Sequence
import errno
import os
from pathlib import Path

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files.limits import array_names, sha256_of, unpack_arrays
from hnn_vi_ros.files.regular_file import regular
from hnn_vi_ros.learning.motions import as_motions, MeasuredRun, Motion, MotionData
import numpy as np
from pydantic import Field

MAX_BYTES = 1 << 30


class ArraysData(MotionData):
    """Arrays of an .npz file: of one run, or of several, each with its name before the key."""

    path: str = Field('', description='the file; or given on the command line')
    runs: list[str] = Field([], description=(
        'the runs to take, RUN of the keys RUN/t, RUN/q, ...; none for all'))
    time: str = Field('t', description='key of the times [s], shape (N,)')
    interval: float | None = Field(None, gt=0.0, description=(
        'time from one sample to the next [s], where the file holds no times'))
    q: str = Field('q', description='key of the coordinates, shape (N, d)')
    v: str | None = Field('dq', description=(
        'key of the velocities, shape (N, d); null: they are estimated from q'))
    a: str | None = Field(None, description=(
        'key of the accelerations, shape (N, d); null: they are estimated'))
    tau: str | None = Field('tau', description=(
        'key of the generalised forces, shape (N, d), or of those of m < d motors, shape (N, m); '
        'null: there are none'))


def split_runs(data: str) -> tuple[Path, list[str]]:
    """Return the file and the runs of ``FILE:RUN,RUN``; of ``FILE``, no runs, which is all."""
    file, colon, runs = data.rpartition(':')
    # Which tells of no name that is too long to be one.
    if not colon or os.path.exists(data):
        return Path(data), []
    return Path(file), runs.split(',')


def read_archive(path: Path) -> tuple[dict[str, np.ndarray], str]:
    """
    Return the arrays of an .npz file by their keys, and the beginning of its checksum.

    Raises
    ------
    DataError
        The file cannot be read, is too large, or holds what is no plain array.

    """
    try:
        return unpack_arrays(path, MAX_BYTES), sha256_of(path, MAX_BYTES)[:16]
    except OSError as problem:
        what, remedy = f'cannot be read ({problem.strerror or problem})', 'numpy.savez wrote'
        if problem.errno == errno.EFBIG:
            what, remedy = str(problem.strerror), 'is smaller, such as a part of it'
        raise DataError(f'{path}: {what}; give an .npz file that {remedy}') from problem
    except ValueError as problem:
        raise DataError(f'{path}: {problem}; give an .npz file that numpy.savez wrote'
                        ) from problem


def keys_of(path: Path) -> set[str]:
    """Return the keys of an .npz file without those of its runs; none of one that is none."""
    try:
        return {key.rpartition('/')[2] for key in array_names(path, MAX_BYTES)}
    except (OSError, ValueError):
        return set()


def read_arrays(path: Path, data: ArraysData, d: int, runs: Sequence[str] = ()
                ) -> tuple[list[Motion], str]:
    """
    Read runs from an .npz file, and put each on even times.

    Parameters
    ----------
    path : Path
        A file that np.savez wrote, of at most 1 GiB. Nothing in it is unpickled.
    data : ArraysData
        Its keys.
    d : int
        Number of coordinates.
    runs : sequence of str
        The runs to take, instead of ``data.runs``.

    Returns
    -------
    list of Motion and str
        The runs, and what they are, for the model card.

    Raises
    ------
    DataError
        The file cannot be read, lacks a run or a key, or an array cannot be used.

    """
    arrays, digest = read_archive(path)
    first = data.time if data.interval is None else data.q
    found = [key.rpartition('/')[0] for key in arrays if key.rpartition('/')[2] == first]
    wanted = [*(runs or data.runs)] or found
    for run in wanted:
        if run not in found:
            raise DataError(f'{path}: no run {run!r} with a key {first}; its runs: '
                            f'{listed(found) or "none"}; name the keys in data')
    if not wanted:
        raise DataError(f'{path}: no key {first}, nor any RUN/{first}; it has '
                        f'{listed(arrays) or "none"}; name the keys in data')
    found_runs = [_run(path, run, arrays, data, d) for run in wanted]
    named = ', '.join(run for run in wanted if run)
    return as_motions(found_runs, data, f'{path.name}: {named}' if named else path.name,
                      digest)


def _run(path: Path, run: str, arrays: dict[str, np.ndarray], data: ArraysData, d: int
         ) -> MeasuredRun:
    def array(key: str, shape: tuple[int, ...], fewer: bool = False) -> np.ndarray:
        name = f'{run}/{key}' if run else key
        if name not in arrays:
            raise DataError(f'{path}: no key {name}; it has {listed(arrays)}; name the '
                            'keys in data')
        values = arrays[name]
        fits = values.shape == shape or (
            fewer and values.ndim == 2 and len(values) == shape[0]
            and 1 <= values.shape[1] <= shape[1])
        if not fits or values.dtype.kind not in 'fiu':
            column = values.shape == shape[:1] and (fewer or shape[1:] == (1,))
            raise DataError(f'{path}: {name} has shape {values.shape} of {values.dtype}, expected '
                            f'numbers of shape {shape}{", or with fewer columns" * fewer}'
                            f'{f"; save {key}[:, None]" * column}')
        return values.astype(np.float64)

    name = f'{run}/' if run else ''
    if data.interval is None:
        t = array(data.time, (arrays[name + data.time].size,))
    else:
        t = data.interval * np.arange(arrays[name + data.q].size // d)
    q, v, tau, a = (None if key is None else array(key, (len(t), d), key == data.tau)
                    for key in (data.q, data.v, data.tau, data.a))
    assert q is not None
    return MeasuredRun(run or path.stem, f'{path}: {name}{data.q}', t, q, v, tau, a=a)
