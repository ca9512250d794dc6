# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read measured motions of machines and of rotating bodies from arrays in an .npz file."""

from collections.abc import Callable, Sequence
import errno
import os
from pathlib import Path
from typing import Literal, NamedTuple, TYPE_CHECKING

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files import array_names, sha256_of, StrictModel, unpack_arrays
from hnn_vi_ros.learning.data.motions import (
    Motion, MotionData, Recording, TEST_RUNS, with_commands)
from hnn_vi_ros.models import turn_matrices
import numpy as np
from pydantic import Field

if TYPE_CHECKING:
    import torch

MAX_BYTES = 1 << 30
_NAMED = '; name the keys with --keys, or in the data section of a configuration'
# Largest accepted deviation of R^T R and of quaternion norms, for data with few digits, and
# deviation above which attitudes are projected onto the group; below it is rounding.
_NOT_TURNING, _ROUNDING = 1e-3, 1e-14


class ArraysData(MotionData):
    """Keys of the arrays in an .npz file with one run, or several whose names prefix the keys."""

    kind: Literal['arrays'] = 'arrays'
    path: str = Field('', description='the file; --data overrides it')
    runs: list[str] = Field([], description=(
        'names of the runs, RUN in the keys RUN/t, RUN/q, ...; none: all runs'))
    time: str = Field('t', description='key of the times [s], shape (N,)')
    interval: float | None = Field(None, gt=0.0, description=(
        'sampling interval [s], if the file has no times'))
    q: str = Field('q', description='key of the coordinates, shape (N, d)')
    v: str | None = Field('dq', description=(
        'key of the velocities, shape (N, d); v and dq are interchangeable; null: estimated from '
        'q'))
    a: str | None = Field(None, description=(
        'key of the accelerations, shape (N, d); null: estimated'))
    tau: str | None = Field('tau', description=(
        'key of the generalised forces, shape (N, d), or of the forces of m < d motors, shape (N, '
        'm); null: none'))
    command: str | None = Field(None, description=(
        'key of positions commanded to servos, shape (N, m), for identify; null: none'))
    enabled: str | None = Field(None, description=(
        'key of an array that is 0 while the motors are off, shape (N,) or (N, m)'))


class BodyArrays(StrictModel):
    """
    Keys of the arrays of body motions, of one run or of several whose names prefix the keys.

    An attitude is a unit quaternion x, y, z, w or the nine entries of its matrix, row by row; a
    pose is a position followed by an attitude. Each input is held until the next sample.
    """

    kind: Literal['arrays']
    path: str = Field('', description='the file; --data overrides it')
    time: str = Field('t', description='key of the times [s], shape (N,), evenly spaced')
    q: str = Field('q', description=(
        'key of the attitudes, shape (N, 4) or (N, 9), or of the poses, (N, 7) or (N, 12)'))
    v: str = Field('dq', description=(
        'key of the velocities in the frame of the body, shape (N, 3), or (N, 6) for poses: '
        'linear, then angular velocity'))
    tau: str | None = Field('tau', description='key of the inputs, shape (N, m); null: none')
    test_runs: list[str] = TEST_RUNS


class BodyWindows(StrictModel):
    """
    Key of one array of many short motions, with all columns side by side.

    Columns as in BodyArrays: attitude (of a pose: position and attitude), velocity, inputs.
    """

    kind: Literal['windows']
    path: str = Field('', description='the file; --data overrides it')
    train: str = Field('train', description='key of the training motions')
    test: str = Field('test', description='key of the test motions')
    time_axis: int = Field(1, ge=0, description=(
        'axis of the times; the last axis contains the columns'))
    interval: float = Field(gt=0.0, description='sampling interval [s]')
    attitude: Literal['matrix', 'quaternion'] = 'matrix'


class BodyMotions(NamedTuple):
    """
    M motions of T samples each; time is the first axis and the motion is the second.

    Parameters
    ----------
    x, R, v, u : torch.Tensor
        Positions (T, M, k - 3), attitudes (T, M, 3, 3), velocities in the body frame
        (T, M, k), and inputs that are held until the next sample (T, M, m).
    interval : float
        Time between samples [s].

    """

    x: 'torch.Tensor'
    R: 'torch.Tensor'
    v: 'torch.Tensor'
    u: 'torch.Tensor'
    interval: float

    def at(self, times: slice) -> 'BodyMotions':
        """Return the samples of all motions in a slice of times."""
        return self._each(lambda part: part[times])

    def of(self, rows: 'torch.Tensor') -> 'BodyMotions':
        """Return the motions with these indices."""
        return self._each(lambda part: part[:, rows])

    def windows(self, count: int) -> 'BodyMotions':
        """Return all overlapping windows of ``count`` intervals as motions."""
        length = len(self.R)
        if count >= length:
            raise DataError(f'windows of {count} intervals are longer than the motions of '
                            f'{length - 1}; reduce windows')
        return self._each(lambda part: part.unfold(0, count + 1, 1).movedim(-1, 0)[
            :, :length - count].flatten(1, 2))

    def _each(self, change: Callable[['torch.Tensor'], 'torch.Tensor']) -> 'BodyMotions':
        x, R, v, u = map(change, self[:4])
        return BodyMotions(x, R, v, u, self.interval)


class Archive:
    """
    Arrays of an .npz file written by numpy.savez, at most 1 GiB; pickled data is rejected.

    Parameters
    ----------
    path : Path
        Path of the file.

    Attributes
    ----------
    arrays : dict
        Arrays by key.
    digest : str
        First digits of the SHA-256 of the file.

    Raises
    ------
    DataError
        The file cannot be read, is too large, or holds anything but plain arrays.

    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self.arrays = unpack_arrays(path, MAX_BYTES)
            self.digest = sha256_of(path, MAX_BYTES)[:16]
        except OSError as problem:
            what, remedy = f'cannot be read ({problem.strerror or problem})', 'numpy.savez wrote'
            if problem.errno == errno.EFBIG:
                what, remedy = str(problem.strerror), 'is smaller, for example a part of this one'
            raise DataError(f'{path}: {what}; give an .npz file that {remedy}') from problem
        except ValueError as problem:
            raise DataError(f'{path}: {problem}; give an .npz file that numpy.savez wrote'
                            ) from problem

    def runs(self, key: str, wanted: Sequence[str] = ()) -> list[str]:
        """Return ``wanted``, or the names of all runs that have a key; '' is the unnamed run."""
        found = [name.rpartition('/')[0] for name in self.arrays if name.rpartition('/')[2] == key]
        for run in wanted:
            if run not in found:
                raise DataError(f'{self.path}: no run {run!r} with a key {key}; its runs: '
                                f'{listed(found) or "none"}{_NAMED}')
        if not found:
            raise DataError(f'{self.path}: no key {key} or RUN/{key}; it has '
                            f'{self._keys()}{_NAMED}')
        return [*wanted] or found

    def array(self, key: str, rows: int | None = None, widths: Sequence[int] = (),
              fewer: bool = False) -> np.ndarray:
        """
        Return an array of numbers.

        If ``rows`` is given, the shape must be (rows, width) with a width in ``widths`` (any width
        if that is empty); ``fewer`` also allows smaller widths.
        """
        if key not in self.arrays:
            raise DataError(f'{self.path}: no key {key}; it has {self._keys()}{_NAMED}')
        values, expected = self.arrays[key], 'numbers'
        fits = values.dtype.kind in 'fiub'
        if rows is not None:
            expected += f' of shape ({rows}, {" or ".join(map(str, widths)) or "m"})'
            expected += ', or with fewer columns' * fewer
            fits &= values.ndim == 2 and len(values) == rows and (
                not widths or values.shape[1] in widths
                or (fewer and 1 <= values.shape[1] <= max(widths)))
        if not fits:
            column = values.shape == (rows,) and (fewer or 1 in widths)
            raise DataError(f'{self.path}: {key} has shape {values.shape} of {values.dtype}, '
                            f'expected {expected}{f"; save {key}[:, None]" * column}')
        return values.astype(np.float64)

    def velocities(self, run: str, key: str | None) -> str | None:
        """Return the key of the velocities of a run; dq and v are synonyms."""
        others = ('dq', 'v') if key in ('dq', 'v') else (key,)
        found = [other for other in others if other is None or run + other in self.arrays]
        if not found:
            raise DataError(f'{self.path}: no key {run}{" or ".join(map(str, others))}; it has '
                            f'{self._keys()}; name the key of the velocities in data, or have '
                            'them estimated from q: v: null, or --keys t,q,,tau')
        return key if key in found else found[0]

    def _keys(self) -> str:
        return listed(self.arrays) or 'none'


def keys_of(path: Path) -> set[str]:
    """Return the keys of an .npz file without run prefixes; the empty set for other files."""
    try:
        return {key.rpartition('/')[2] for key in array_names(path, MAX_BYTES)}
    except (OSError, ValueError):
        return set()


def split_runs(data: str) -> tuple[Path, list[str]]:
    """Split ``FILE:RUN,RUN`` into file and runs; for ``FILE`` the list is empty and means all."""
    file, colon, runs = data.rpartition(':')
    # os.path.exists also returns False for names that are too long.
    if not colon or os.path.exists(data):
        return Path(data), []
    return Path(file), runs.split(',')


def read_arrays(path: Path, data: ArraysData, d: int, runs: Sequence[str] = ()) -> Recording:
    """
    Read the motions of a machine, one per run.

    Parameters
    ----------
    path : Path
        Path of the file; see Archive.
    data : ArraysData
        Keys of the arrays.
    d : int
        Number of coordinates.
    runs : sequence of str
        Runs to read; overrides ``data.runs``.

    Raises
    ------
    DataError
        The file cannot be read, a run or a key is missing, or an array is invalid.

    """
    archive = Archive(path)
    wanted = archive.runs(data.time if data.interval is None else data.q, runs or data.runs)
    found = []
    for run in wanted:
        name = f'{run}/' if run else ''
        if data.interval is None:
            t = archive.array(name + data.time).ravel()
        else:
            t = data.interval * np.arange(archive.array(name + data.q).size // d)
        q = archive.array(name + data.q, len(t), [d])
        v, a = (None if key is None else archive.array(name + key, len(t), [d])
                for key in (archive.velocities(name, data.v), data.a))
        tau, command = (None if key is None else archive.array(
            name + key, len(t), [d], fewer=True) for key in (data.tau, data.command))
        enabled = None if data.enabled is None else np.atleast_1d(
            archive.array(name + data.enabled))
        found.append(with_commands(Motion(
            run or path.stem, f'{path}: {name}{data.q}', t, q, v, tau, a), command, enabled))
    named = ', '.join(run for run in wanted if run)
    return Recording(found, f'{path.name}: {named}' if named else path.name, archive.digest)


def read_bodies(path: Path, data: BodyArrays | BodyWindows, kind: str
                ) -> tuple[list[BodyMotions], list[BodyMotions], str]:
    """
    Read the training and the test motions of a body.

    Parameters
    ----------
    path : Path
        Path of the file; see Archive.
    data : BodyArrays or BodyWindows
        Keys of the arrays.
    kind : str
        ``'rotation'`` or ``'pose'``.

    Returns
    -------
    list of BodyMotions, list of BodyMotions and str
        Training motions, test motions, and a description of both for the model card.

    Raises
    ------
    DataError
        The file cannot be read, a key is missing, or an array is invalid.

    """
    archive, places = Archive(path), 0 if kind == 'rotation' else 3
    if isinstance(data, BodyWindows):
        train, test = (_of_windows(archive, key, data, places) for key in (data.train, data.test))
        return [train], [test], f'{path.name}: {data.train}, sha256 {archive.digest}'
    names = archive.runs(data.time)
    for run in data.test_runs:
        if run not in names:
            raise DataError(f'{path}: data.test_runs: no run {run!r} among {listed(names)}')
    runs = {run: _of_run(archive, data, places, f'{run}/' if run else '') for run in names}
    known = [motion for run, motion in runs.items() if run not in data.test_runs]
    judged = [runs[run] for run in names if run in data.test_runs]
    if not known:
        raise DataError(f'{path}: data.test_runs leave no run for training')
    if not judged:
        ends = [4 * len(motion.R) // 5 for motion in known]
        judged = [motion.at(slice(end, None)) for motion, end in zip(known, ends, strict=True)]
        known = [motion.at(slice(None, end)) for motion, end in zip(known, ends, strict=True)]
    return known, judged, f'{path.name}, sha256 {archive.digest}'


def _of_windows(archive: Archive, key: str, data: BodyWindows, places: int) -> BodyMotions:
    table = archive.array(key)
    if table.ndim < 2 or data.time_axis >= table.ndim - 1:
        raise DataError(f'{archive.path}: {key} has shape {table.shape}, expected times along '
                        f'axis {data.time_axis} and columns along the last axis')
    table = np.moveaxis(table, data.time_axis, 0)
    table = table.reshape(len(table), -1, table.shape[-1])
    ends = np.cumsum([places, 9 if data.attitude == 'matrix' else 4, 3 + places])
    if table.shape[-1] < ends[-1]:
        raise DataError(f'{archive.path}: {key} has {table.shape[-1]} columns, expected at least '
                        f'{ends[-1]}: those of attitude and velocity, then inputs')
    return _motions(f'{archive.path}: {key}', np.split(table, ends, axis=-1), data.interval)


def _of_run(archive: Archive, data: BodyArrays, places: int, run: str) -> BodyMotions:
    t = archive.array(run + data.time).ravel()
    q = archive.array(run + data.q, t.size, [4 + places, 9 + places])
    v = archive.array(run + data.v, t.size, [3 + places])
    u = np.empty((t.size, 0)) if data.tau is None else archive.array(run + data.tau, t.size)
    steps = np.diff(t)
    if t.size < 2 or not np.ptp(steps) <= 0.01 * steps.mean():
        raise DataError(f'{archive.path}: {run}{data.time} is not evenly spaced; interpolate the '
                        'run to even times')
    return _motions(f'{archive.path}: {run}{data.q}', [
        part[:, None] for part in (q[:, :places], q[:, places:], v, u)], float(steps.mean()))


def _motions(name: str, parts: Sequence[np.ndarray], interval: float) -> BodyMotions:
    """Return the motions with attitudes converted to matrices."""
    x, attitude, v, u = parts
    if not all(np.isfinite(part).all() for part in parts):
        raise DataError(f'{name}: it, or the array next to it, contains values that are not '
                        'finite numbers')
    if attitude.shape[-1] == 4:
        R = turn_matrices(attitude.reshape(-1, 4))
    else:
        R = attitude.reshape(-1, 3, 3).copy()
    gram = R.transpose(0, 2, 1) @ R
    # A reflection has determinant -1.
    wrong = np.abs(gram - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0.0)
    if not (wrong <= _NOT_TURNING).all():
        raise DataError(f'{name}: attitude {int(wrong.argmax())} is not a rotation; expected a '
                        'unit quaternion x, y, z, w, or the rotation matrix from the frame of the '
                        'body to the fixed frame, row by row')
    # Attitudes off the group by more than rounding are replaced by the nearest rotations.
    off = wrong > _ROUNDING
    left, _, right = np.linalg.svd(R[off])
    R[off] = left @ right
    R = R.reshape(*attitude.shape[:-1], 3, 3)
    # Imported lazily: hnn identify reads other arrays without it.
    import torch
    x, R, v, u = map(torch.tensor, (x, R, v, u))
    return BodyMotions(x, R, v, u, interval)
