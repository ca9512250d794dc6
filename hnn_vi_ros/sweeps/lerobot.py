# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes as a LeRobot dataset, version 3.0 of its format: Parquet and JSON."""

from collections.abc import Iterator, Mapping
from contextlib import closing
import json
from pathlib import Path
import shutil
from typing import Any, BinaryIO

from hnn_vi_ros.errors import DataError, RecordingError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.sweeps.episodes import Episode, rate_of
from hnn_vi_ros.sweeps.plan import SweepPlan
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

_VERSION = 'v3.0'
# Files in a folder, and how large one grows [MB of 2^20 bytes]: the format's usual ones.
_CHUNK, _MEGABYTES = 1000, 100
_FILE = 'chunk-{chunk_index:03d}/file-{file_index:03d}.parquet'
_STATE, _ENERGY = 'observation.state', 'observation.energy'
# Columns of each frame besides its observations.
_COUNTS = ('frame_index', 'episode_index', 'index', 'task_index')
_Stats = dict[str, np.ndarray]


def write_lerobot(plan: SweepPlan, episodes: Iterator[Episode], folder: Path) -> None:
    """
    Write episodes as a LeRobot dataset.

    The frames of an episode are its initial state and the samples after it;
    ``observation.state`` is (q, p), ``observation.energy`` is H [J], both in float32, as in
    LeRobot's own. What varied is in ``meta/episodes``, under ``sweep/index`` and
    ``sweep/values``.

    Parameters
    ----------
    plan : SweepPlan
        Of the sweep.
    episodes : iterator of Episode
        Its trajectories.
    folder : Path
        Which must not exist.

    Raises
    ------
    DataError
        The samples of a second are no whole number, which the format asks for; or a number is
        beyond float32.
    RecordingError
        The folder exists, or cannot be written; what was begun of it is removed.

    References
    ----------
    R. Cadene et al., LeRobot: State-of-the-art Machine Learning for Real-World Robotics in
    Pytorch, github.com/huggingface/lerobot, docs/source/lerobot-dataset-v3.mdx.

    """
    rate = rate_of(plan)
    if abs(rate - round(rate)) > 1e-9 * rate:
        raise DataError(
            f'--episodes lerobot: {rate:g} samples a second are no whole number, as the format '
            'asks for; set `every` of the sweep to another number of steps of '
            f'{plan.scene.known_step_size:g} s')
    try:
        folder.mkdir(parents=True)
        try:
            (folder / 'meta').mkdir()
            with closing(_Files(folder / 'data')) as data, \
                    closing(_Files(folder / 'meta' / 'episodes')) as meta:
                _write(plan, episodes, folder, round(rate), data, meta)
        except BaseException:
            shutil.rmtree(folder)
            raise
    except OSError as problem:
        raise RecordingError(f'{folder}: {problem.strerror or one_line(problem)}; give an --out '
                             'that does not exist and can be written') from problem


def _write(plan: SweepPlan, episodes: Iterator[Episode], folder: Path, rate: int,
           data: '_Files', meta: '_Files') -> None:
    names = [*plan.names['q'], *(f'p_{name}' for name in plan.names['p'])]
    task = plan.sweep.description or plan.scene.description or plan.scene.name
    total: dict[str, _Stats] = {}
    frames = number = 0
    for episode in episodes:
        columns = _columns(episode, number, frames, rate)
        length = len(columns[_STATE])
        stats = {name: _stats(values) for name, values in columns.items()}
        total = {name: _joined(total[name], own) if name in total else own
                 for name, own in stats.items()}
        places = (*data.place(), *meta.place())
        data.put(pa.table({name: _arrow(values) for name, values in columns.items()}))
        meta.put(pa.Table.from_pylist([{
            'episode_index': number, 'tasks': [task], 'length': length,
            'data/chunk_index': places[0], 'data/file_index': places[1],
            'dataset_from_index': frames, 'dataset_to_index': frames + length,
            **{f'stats/{name}/{kind}': value.tolist() for name, own in stats.items()
               for kind, value in own.items()},
            'meta/episodes/chunk_index': places[2], 'meta/episodes/file_index': places[3],
            'sweep/index': episode.number, 'sweep/values': json.dumps(episode.values)}]))
        number, frames = number + 1, frames + length
    data.complete()
    meta.complete()
    pq.write_table(_tasks(task), folder / 'meta' / 'tasks.parquet')
    _write_json(folder / 'meta' / 'stats.json', {name: {
        kind: value.tolist() for kind, value in own.items()} for name, own in total.items()})
    _write_json(folder / 'meta' / 'info.json', {
        'codebase_version': _VERSION, 'robot_type': plan.scene.name,
        'total_episodes': number, 'total_frames': frames, 'total_tasks': 1,
        'chunks_size': _CHUNK, 'data_files_size_in_mb': _MEGABYTES,
        'video_files_size_in_mb': _MEGABYTES, 'fps': rate, 'splits': {'train': f'0:{number}'},
        'data_path': f'data/{_FILE}', 'video_path': None, 'features': {
            _STATE: {'dtype': 'float32', 'shape': [len(names)], 'names': names},
            _ENERGY: {'dtype': 'float32', 'shape': [1], 'names': ['energy']},
            'timestamp': {'dtype': 'float32', 'shape': [1], 'names': None},
            **{name: {'dtype': 'int64', 'shape': [1], 'names': None} for name in _COUNTS}}})


def _columns(episode: Episode, number: int, first: int, rate: int) -> dict[str, np.ndarray]:
    """Return the frames of an episode, which follow others in the dataset."""
    samples = [episode.sampler.sample(), *episode.samples()]
    places = np.arange(len(samples))
    states = np.array([[*sample.q, *sample.p] for sample in samples])
    energies = np.array([sample.energy for sample in samples])
    for name, values in (_STATE, states), (_ENERGY, energies):
        if not (np.abs(values) <= np.finfo(np.float32).max).all():
            raise DataError(f'--episodes lerobot: {name} of trajectory {episode.number} is beyond '
                            'float32, as the format has it; leave it out of --select')
    return {
        _STATE: states.astype(np.float32), _ENERGY: energies.astype(np.float32),
        'timestamp': (places / rate).astype(np.float32),
        'frame_index': places, 'episode_index': np.full(len(samples), number),
        'index': first + places, 'task_index': np.zeros(len(samples), dtype=np.int64)}


def _arrow(values: np.ndarray) -> pa.Array:
    """Return a column; of several numbers a frame, lists of one length."""
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _stats(values: np.ndarray) -> _Stats:
    """Return the statistics of a feature over some frames, shape (k,) each but the count."""
    frames = values.reshape(len(values), -1).astype(np.float64)
    return {'min': frames.min(axis=0), 'max': frames.max(axis=0), 'mean': frames.mean(axis=0),
            'std': frames.std(axis=0), 'count': np.array([len(frames)])}


def _joined(one: _Stats, other: _Stats) -> _Stats:
    """
    Return the statistics of two sets of frames together.

    References
    ----------
    T. Chan, G. Golub, R. LeVeque, Updating formulae and a pairwise algorithm for computing
    sample variances, COMPSTAT 1982.

    """
    count = one['count'] + other['count']
    share = other['count'] / count
    shift = other['mean'] - one['mean']
    variance = (one['std']**2 * (1.0 - share) + other['std']**2 * share
                + shift**2 * share * (1.0 - share))
    return {'min': np.minimum(one['min'], other['min']),
            'max': np.maximum(one['max'], other['max']),
            'mean': one['mean'] + shift * share, 'std': np.sqrt(variance), 'count': count}


def _tasks(task: str) -> pa.Table:
    """Return the table of tasks, whose index, for pandas, is their text."""
    def described(name: str, kind: str, stored: str) -> dict[str, Any]:
        return {'name': name, 'field_name': name, 'pandas_type': kind, 'numpy_type': stored,
                'metadata': None}
    pandas = {'index_columns': ['task'], 'column_indexes': [], 'columns': [
        described('task_index', 'int64', 'int64'), described('task', 'unicode', 'object')],
        'creator': {'library': 'pyarrow', 'version': pa.__version__}, 'pandas_version': '2.0.0'}
    return pa.table({'task_index': [0], 'task': [task]}).replace_schema_metadata(
        {'pandas': json.dumps(pandas)})


def _write_json(path: Path, data: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=4, ensure_ascii=False) + '\n', encoding='utf-8')


class _Files:
    """
    Numbered Parquet files, each of some row groups: one for each episode.

    Parameters
    ----------
    folder : Path
        Of the folders that they are in.

    """

    def __init__(self, folder: Path):
        self._folder, self._number = folder, -1
        self._stream: BinaryIO | None = None
        self._writer: Any = None

    def place(self) -> tuple[int, int]:
        """Return the numbers of the folder and of the file that the next table comes to."""
        if self._stream is None or self._stream.tell() >= _MEGABYTES * 2**20:
            self.complete()
            self._number += 1
            chunk, file = divmod(self._number, _CHUNK)
            path = self._folder / _FILE.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open('wb')
        return divmod(self._number, _CHUNK)

    def put(self, table: pa.Table) -> None:
        """Write a table to the file that ``place`` named."""
        if self._writer is None:
            self._writer = pq.ParquetWriter(self._stream, table.schema, compression='snappy')
        self._writer.write_table(table, row_group_size=table.num_rows)

    def complete(self) -> None:
        """Complete the file, if there is one."""
        if self._writer is not None:
            self._writer.close()
        self.close()

    def close(self) -> None:
        """Close the file, if there is one; what was not completed is no Parquet file."""
        if self._writer is not None:
            # Else it would try to complete the file when it is collected.
            self._writer.is_open = False
        if self._stream is not None:
            self._stream.close()
        self._writer = self._stream = None
