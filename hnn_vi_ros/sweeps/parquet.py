# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shards as Parquet: the same bytes for the same trajectories."""

from collections.abc import Callable, Iterable, Sequence
from io import BytesIO
import json
from pathlib import Path
from typing import Any

from hnn_vi_ros.sweeps.plan import as_json, Plan
from hnn_vi_ros.sweeps.trajectories import Outcome
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

_DIGEST, _SHARD = b'hnn_vi_ros.digest', b'hnn_vi_ros.shard'
_TYPES = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
_LISTS = {'event_times': pa.list_(pa.float64()), 'events': pa.list_(pa.string())}


def schema_of(plan: Plan, shard: int) -> pa.Schema:
    """Return the columns of a shard, with the scene and the versions as metadata."""
    names, sweep, record = plan.names, plan.sweep, plan.record
    measured = list(sweep.statistics)
    if 'event_times' in measured:
        measured.append('events')
    columns = [
        pa.field('index', pa.int64()),
        *(pa.field(key, _TYPES[kind]) for axis in plan.axes
          for key, kind in zip(axis.keys, axis.types, strict=True)),
        pa.field('t', pa.float64()),
        *(pa.field(f'{half}_{name}', pa.float64()) for half in 'qp' for name in names),
        pa.field('energy', pa.float64()),
        *(pa.field(name, _LISTS.get(name, pa.float64())) for name in measured),
        *(pa.field(name, pa.float64()) for name in (
            sweep.reduction.columns if sweep.reduction else ())),
        pa.field('alarms', pa.list_(pa.string())),
        pa.field('failure', pa.string()),
    ]
    return pa.schema(columns, {
        _DIGEST: record['digest'], _SHARD: str(shard),
        b'hnn_vi_ros.sweep': as_json(record['sweep']),
        b'hnn_vi_ros.scene': as_json(record['scene']),
        b'hnn_vi_ros.models': as_json(record['models']),
        b'hnn_vi_ros.versions': as_json(record['versions'])})


def _plain(value: Any, kind: pa.DataType) -> Any:
    """Return a value as its column holds it."""
    return json.dumps(value) if kind == pa.string() and not isinstance(value, str) else value


def write_shard(plan: Plan, shard: int, blocks: Iterable[list[Outcome]],
                on_block: Callable[[int], None] = lambda count: None) -> bytes:
    """
    Return the file of a shard: one row group, which holds no more rows than the plan allows.

    Parameters
    ----------
    plan : Plan
        Of the sweep.
    shard : int
        Which.
    blocks : iterable of list of Outcome
        Its trajectories.
    on_block : callable, optional
        Called with how many trajectories have been made, after each block.

    """
    schema = schema_of(plan, shard)
    batches = []
    for outcomes in blocks:
        batches.append(_batch(plan, outcomes, schema))
        on_block(len(outcomes))
    table = pa.Table.from_batches(batches, schema)
    stream = BytesIO()
    with pq.ParquetWriter(stream, schema, compression='zstd', version='2.6') as writer:
        writer.write_table(table, row_group_size=max(table.num_rows, 1))
    return stream.getvalue()


def _batch(plan: Plan, outcomes: list[Outcome], schema: pa.Schema) -> pa.RecordBatch:
    """Return a block as a record batch: a row for each sample that is kept."""
    rows = np.array([len(one.t) for one in outcomes])

    def repeated(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
        """Return a value for each trajectory in each of its rows."""
        array = pa.array(values, kind)
        return array if rows.max() == 1 else array.take(pa.array(
            np.repeat(np.arange(len(outcomes)), rows)))

    def numbers(parts: Iterable[np.ndarray]) -> pa.Array:
        """Return numbers of all samples; NaN is none."""
        return pa.array(np.concatenate(list(parts)), pa.float64(), from_pandas=True)

    d, keys = plan.hamiltonian.dimension, plan.keys
    columns = [repeated([one.index for one in outcomes], pa.int64())]
    columns += [repeated([_plain(one.values[k], schema.field(key).type) for one in outcomes],
                         schema.field(key).type) for k, key in enumerate(keys)]
    columns.append(numbers(one.t for one in outcomes))
    for half in 'qp':
        columns += [numbers(getattr(one, half)[:, i] for one in outcomes) for i in range(d)]
    columns.append(numbers(one.energy for one in outcomes))
    columns += [repeated([one.measured.get(name) for one in outcomes], schema.field(name).type)
                for name in schema.names[len(columns):-2]]
    columns.append(repeated([one.alarms for one in outcomes], schema.field('alarms').type))
    columns.append(repeated([one.failure for one in outcomes], pa.string()))
    return pa.record_batch(columns, schema=schema)


def is_shard(path: Path, digest: str, shard: int) -> bool:
    """Tell whether a file is a shard of a sweep, whole."""
    try:
        metadata = pq.read_metadata(path).metadata or {}
    except (OSError, pa.ArrowInvalid):
        return False
    return metadata.get(_DIGEST) == digest.encode() and metadata.get(_SHARD) == b'%d' % shard


def count_failures(path: Path) -> int:
    """Return how many trajectories of a shard failed: one row each."""
    column = pq.read_table(path, columns=['failure'])['failure']
    return len(column) - int(column.null_count)
