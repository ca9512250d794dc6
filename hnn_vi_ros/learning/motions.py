# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions of a mechanism, (t, q, v, tau), from arrays in an .npz file."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
import zipfile

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.yaml_file import StrictModel
import numpy as np
from pydantic import Field
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, sosfiltfilt

MAX_BYTES = 1 << 30
MIN_SAMPLES = 20
# Order of the low-pass; run forth and back it counts twice and shifts no phase.
_ORDER = 2
# Samples further apart than this many usual intervals are a gap, over which nothing is known.
_GAP = 10.0


class ArraysData(StrictModel):
    """Arrays of an .npz file: of one run, or of several, each with its name before the key."""

    path: str = Field('', description='the file; or given on the command line')
    runs: list[str] = Field([], description=(
        'the runs to take, RUN of the keys RUN/t, RUN/q, ...; none for all'))
    time: str = Field('t', description='key of the times [s], shape (N,)')
    q: str = Field('q', description='key of the coordinates, shape (N, d)')
    v: str = Field('dq', description='key of the velocities, shape (N, d)')
    tau: str | None = Field('tau', description=(
        'key of the generalised forces of the motors, shape (N, d); null: there are none'))
    smoothing: float = Field(40.0, gt=0.0, description=(
        'cut-off of the zero-phase filter from which initial states and accelerations come [Hz]'))


@dataclass(frozen=True)
class Motion:
    """
    One run, at even times.

    Parameters
    ----------
    name : str
        Of the run.
    t : np.ndarray, shape (N,)
        Times [s].
    q, v, tau : np.ndarray, shape (N, d)
        Coordinates, velocities and generalised forces of the motors, as measured.
    q_smooth, v_smooth, a_smooth : np.ndarray, shape (N, d)
        Coordinates, velocities and accelerations through a zero-phase low-pass filter.

    """

    name: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    q_smooth: np.ndarray
    v_smooth: np.ndarray
    a_smooth: np.ndarray

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return float(self.t[1] - self.t[0])


def split_runs(data: str) -> tuple[Path, list[str]]:
    """Return the file and the runs of ``FILE:RUN,RUN``; of ``FILE``, no runs, which is all."""
    file, colon, runs = data.rpartition(':')
    if not colon or Path(data).exists():
        return Path(data), []
    return Path(file), runs.split(',')


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
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f'{path}: larger than {MAX_BYTES >> 30} GiB; give a part of it')
        digest = sha256(path.read_bytes()).hexdigest()
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    except OSError as problem:
        raise DataError(f'{path}: cannot be read: {problem.strerror or problem}') from problem
    except (ValueError, zipfile.BadZipFile, AttributeError) as problem:
        raise DataError(f'{path}: not an .npz file of plain arrays ({problem}); write it with '
                        'numpy.savez') from problem
    found = [key.rpartition('/')[0] for key in arrays if key.rpartition('/')[2] == data.time]
    wanted = [*(runs or data.runs)] or found
    for run in wanted:
        if run not in found:
            raise DataError(f'{path}: no run {run!r} with a key {data.time}; its runs: '
                            f'{", ".join(found) or "none"}; name the keys in data')
    if not wanted:
        raise DataError(f'{path}: no key {data.time}, nor any RUN/{data.time}; it has '
                        f'{", ".join([*arrays][:8])}; name the keys in data')
    motions = [_motion(path, run, arrays, data, d) for run in wanted]
    samples = sum(len(motion.t) for motion in motions)
    return motions, (f'{path.name} ({", ".join(run for run in wanted if run) or "one run"}; '
                     f'{samples} samples, sha256 {digest[:16]})')


def _motion(path: Path, run: str, arrays: dict[str, np.ndarray], data: ArraysData, d: int
            ) -> Motion:
    def array(key: str, shape: tuple[int, ...]) -> np.ndarray:
        name = f'{run}/{key}' if run else key
        if name not in arrays:
            raise DataError(f'{path}: no key {name}; it has {", ".join([*arrays][:8])}; name the '
                            'keys in data')
        values = arrays[name]
        if values.shape != shape or values.dtype.kind not in 'fiu':
            raise DataError(f'{path}: {name} has shape {values.shape} of {values.dtype}, expected '
                            f'numbers of shape {shape}')
        if not np.isfinite(values).all():
            raise DataError(f'{path}: {name}[{np.argwhere(~np.isfinite(values))[0][0]}] is no '
                            'finite number; leave such samples out')
        return values.astype(np.float64)

    name = f'{run}/{data.time}' if run else data.time
    n = arrays[name].size
    t = array(data.time, (n,))
    if n < MIN_SAMPLES or not (np.diff(t) > 0.0).all():
        raise DataError(f'{path}: {name}: expected at least {MIN_SAMPLES} times that increase; '
                        'leave out samples that come twice or late')
    q, v = array(data.q, (n, d)), array(data.v, (n, d))
    tau = np.zeros((n, d)) if data.tau is None else array(data.tau, (n, d))
    spacing, widest = float(np.median(np.diff(t))), float(np.diff(t).max())
    if widest > _GAP * spacing:
        raise DataError(f'{path}: {name}: {widest:.3g} s without a sample, {spacing:.3g} s as a '
                        'rule; cut the run in two there')
    return smoothed(run or path.stem, *_even(t, q, v, tau, spacing), data.smoothing)


def _even(t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray, spacing: float
          ) -> tuple[np.ndarray, ...]:
    """Return the same at times that are ``spacing`` apart, from the first on."""
    times = t[0] + spacing * np.arange(int((t[-1] - t[0]) / spacing * (1.0 + 1e-12)) + 1)
    times = np.minimum(times, t[-1])
    # q by its slope v as well: clocks of drivers jitter by a large part of the interval.
    return (times, CubicHermiteSpline(t, q, v)(times), *(
        np.stack([np.interp(times, t, column) for column in values.T], axis=-1)
        for values in (v, tau)))


def smoothed(name: str, t: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray,
             cutoff: float) -> Motion:
    """Return a motion with its smoothed states and accelerations; at even times."""
    spacing = t[1] - t[0]
    # At most nine tenths of what the sampling can hold: then there is nothing to take away.
    share = min(2.0 * spacing * cutoff, 0.9)
    filtered = butter(_ORDER, share, output='sos')
    q_smooth, v_smooth = (np.ascontiguousarray(sosfiltfilt(filtered, values, axis=0))
                          for values in (q, v))
    return Motion(name, t, q, v, tau, q_smooth, v_smooth,
                  np.gradient(v_smooth, spacing, axis=0))
