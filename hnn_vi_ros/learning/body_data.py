# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Motions of a body that turns, from arrays in an .npz file, as tensors."""

from pathlib import Path
from typing import Literal, NamedTuple

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.learning.motion_arrays import read_archive
from hnn_vi_ros.models.attitude_features import turn_matrices
import numpy as np
from pydantic import Field
import torch

# What R^T R and the norm of a quaternion may be off by in data that were written with few digits.
_NOT_TURNING = 1e-3
# What it is off by in those that were written with all digits.
_ROUNDING = 1e-14


class BodyArrays(StrictModel):
    """
    Arrays of motions: of one run, or of several, each with its name before the key.

    An attitude is a unit quaternion x, y, z, w, or the nine entries of its matrix row by row; a
    pose has its place before that. Each input is held until the next sample.
    """

    kind: Literal['arrays']
    path: str = Field('', description='the file; or given on the command line')
    time: str = Field('t', description='key of the times [s], shape (N,), evenly spaced')
    q: str = Field('q', description=(
        'key of the attitudes, shape (N, 4) or (N, 9), or of the poses, (N, 7) or (N, 12)'))
    v: str = Field('dq', description=(
        'key of the velocities in the frame of the body, shape (N, 3); of a pose (N, 6), that of '
        'its place first'))
    tau: str | None = Field('tau', description='key of the inputs, shape (N, m); null: none')
    test_runs: list[str] = Field([], description=(
        'runs to judge the model by; none: the last fifth of each run in time'))


class BodyWindows(StrictModel):
    """
    One array of many short motions, with all columns side by side.

    The columns are attitude, velocity and inputs as in BodyArrays, of a pose place and attitude.
    """

    kind: Literal['windows']
    path: str = Field('', description='the file; or given on the command line')
    train: str = Field('train', description='key of the motions to learn from')
    test: str = Field('test', description='key of the motions to judge by')
    time_axis: int = Field(1, ge=0, description='the axis of times; the last one is of columns')
    interval: float = Field(gt=0.0, description='from one time to the next [s]')
    attitude: Literal['matrix', 'quaternion'] = 'matrix'


BodyData = BodyArrays | BodyWindows


class Motions(NamedTuple):
    """
    M motions of T instants, one after another in the last but one axis of each.

    Parameters
    ----------
    x, R, v, u : torch.Tensor
        Places (T, M, k - 3), attitudes (T, M, 3, 3), velocities in the frame of the body
        (T, M, k), and inputs that are held until the next instant (T, M, m).
    interval : float
        From one instant to the next [s].

    """

    x: torch.Tensor
    R: torch.Tensor
    v: torch.Tensor
    u: torch.Tensor
    interval: float

    def windows(self, count: int) -> 'Motions':
        """Return all windows of ``count`` intervals, overlapping, as motions."""
        length = len(self.R)
        if count >= length:
            raise DataError(f'windows of {count} intervals are longer than the motions, of '
                            f'{length - 1}; lower windows')
        parts = (torch.cat([part[i:length - count + i][:, None] for i in range(count + 1)], dim=1)
                 for part in self[:4])
        return Motions(*(part.transpose(0, 1).flatten(1, 2) for part in parts), self.interval)


def read_bodies(path: Path, data: BodyData, kind: str) -> tuple[list[Motions], list[Motions], str]:
    """
    Read motions to learn from, and to judge by.

    Parameters
    ----------
    path : Path
        A file that np.savez wrote, of at most 1 GiB. Nothing in it is unpickled.
    data : BodyArrays or BodyWindows
        Its keys.
    kind : str
        ``'rotation'`` or ``'pose'``.

    Returns
    -------
    list of Motions, list of Motions and str
        The two, and what they are, for the model card.

    Raises
    ------
    DataError
        The file cannot be read, lacks a key, or an array cannot be used.

    """
    arrays, digest = read_archive(path)
    if isinstance(data, BodyWindows):
        train, test = (_of_windows(path, arrays, key, data, kind)
                       for key in (data.train, data.test))
        return [train], [test], f'{path.name}: {data.train}, sha256 {digest}'
    train_runs, test_runs = _of_runs(path, arrays, data, kind)
    return train_runs, test_runs, f'{path.name}, sha256 {digest}'


def _of_windows(path: Path, arrays: dict[str, np.ndarray], key: str, data: BodyWindows, kind: str
                ) -> Motions:
    table = _array(path, arrays, key)
    if table.ndim < 2 or data.time_axis >= table.ndim - 1:
        raise DataError(f'{path}: {key} has shape {table.shape}, expected an axis '
                        f'{data.time_axis} of times and a last one of columns')
    table = np.moveaxis(table, data.time_axis, 0)
    table = table.reshape(len(table), -1, table.shape[-1])
    places = 0 if kind == 'rotation' else 3
    ends = np.cumsum([places, 9 if data.attitude == 'matrix' else 4, 3 + places])
    if table.shape[-1] < ends[-1]:
        raise DataError(f'{path}: {key} has {table.shape[-1]} columns, expected at least '
                        f'{ends[-1]}: those of a {kind} and its velocity, then inputs')
    x, attitude, v, u = np.split(table, ends, axis=-1)
    return _motions(f'{path}: {key}', x, attitude, v, u, data.interval)


def _of_runs(path: Path, arrays: dict[str, np.ndarray], data: BodyArrays, kind: str
             ) -> tuple[list[Motions], list[Motions]]:
    runs = [key.rpartition('/')[0] for key in arrays if key.rpartition('/')[2] == data.time]
    if not runs:
        raise DataError(f'{path}: no key {data.time}, nor any RUN/{data.time}; it has '
                        f'{listed(arrays) or "none"}; name the keys in data')
    for run in data.test_runs:
        if run not in runs:
            raise DataError(f'{path}: data.test_runs: no run {run!r} among {listed(runs)}')
    train, test = [], []
    for run in runs:
        motion = _of_run(path, arrays, data, kind, f'{run}/' if run else '')
        if data.test_runs:
            (test if run in data.test_runs else train).append(motion)
        else:
            end = 4 * len(motion.R) // 5
            train.append(Motions(*(part[:end] for part in motion[:4]), motion.interval))
            test.append(Motions(*(part[end:] for part in motion[:4]), motion.interval))
    if not train:
        raise DataError(f'{path}: data.test_runs leave nothing to learn from')
    return train, test


def _of_run(path: Path, arrays: dict[str, np.ndarray], data: BodyArrays, kind: str, run: str
            ) -> Motions:
    t = _array(path, arrays, run + data.time)
    q, v = _array(path, arrays, run + data.q), _array(path, arrays, run + data.v)
    u = np.empty((t.size, 0)) if data.tau is None else _array(path, arrays, run + data.tau)
    places = 0 if kind == 'rotation' else 3
    for name, part, widths in ((data.q, q, (4 + places, 9 + places)), (data.v, v, (3 + places,))):
        if part.ndim != 2 or len(part) != t.size or part.shape[1] not in widths:
            raise DataError(f'{path}: {run}{name} has shape {part.shape}, expected ({t.size}, '
                            f'{" or ".join(map(str, widths))}) for a {kind}')
    if u.ndim != 2 or len(u) != t.size:
        raise DataError(f'{path}: {run}{data.tau} has shape {u.shape}, expected ({t.size}, m)')
    steps = np.diff(t)
    if t.size < 2 or not np.ptp(steps) <= 0.01 * steps.mean():
        raise DataError(f'{path}: {run}{data.time} are not evenly spaced times; interpolate the '
                        'run to even ones')
    return _motions(f'{path}: {run}{data.q}', *(
        part[:, None] for part in (q[:, :places], q[:, places:], v, u)), float(steps.mean()))


def _array(path: Path, arrays: dict[str, np.ndarray], key: str) -> np.ndarray:
    if key not in arrays:
        raise DataError(f'{path}: no key {key}; it has {listed(arrays)}; name the keys '
                        'in data')
    values = arrays[key]
    if values.dtype.kind not in 'fiu' or not np.isfinite(values).all():
        raise DataError(f'{path}: {key} holds something else than finite numbers')
    return values.astype(np.float64)


def _motions(name: str, x: np.ndarray, attitude: np.ndarray, v: np.ndarray, u: np.ndarray,
             interval: float) -> Motions:
    if attitude.shape[-1] == 4:
        R = turn_matrices(attitude.reshape(-1, 4))[0]
    else:
        R = attitude.reshape(-1, 3, 3).copy()
    gram = R.transpose(0, 2, 1) @ R
    # Of a mirror image the determinant is -1.
    wrong = np.abs(gram - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0.0)
    if not (wrong <= _NOT_TURNING).all():
        raise DataError(f'{name}: attitude {int(wrong.argmax())} is no rotation; expected a unit '
                        'quaternion x, y, z, w, or the matrix that takes vectors of the body to '
                        'space, row by row')
    # The next attitude on the group, of those that are off it by more than rounding.
    off = wrong > _ROUNDING
    left, _, right = np.linalg.svd(R[off])
    R[off] = left @ right
    R = R.reshape(*attitude.shape[:-1], 3, 3)
    return Motions(*map(torch.tensor, (x, R, v, u)), interval)
