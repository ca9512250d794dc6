# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shards as Parquet: the same bytes for the same trajectories."""

from collections.abc import Callable, Iterable
from hashlib import sha256
from io import BytesIO
import json
from pathlib import Path
import re
from typing import Any

from hnn_vi_ros.errors import optional, RecordingError
from hnn_vi_ros.files import one_line, read_limited
from hnn_vi_ros.sweeps.plan import as_json, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Rows
import numpy as np

# Every use of sweeps, in Python too, imports this file before any other that takes the package.
with optional('pyarrow', 'a sweep'):
    import pyarrow as pa
    import pyarrow.parquet as pq

_DIGEST, _SHARD = b'hnn_vi_ros.digest', b'hnn_vi_ros.shard'
# A shard is sealed: its number comes with the SHA-256 of its file, computed with these digits as
# zeros. A checksum of pages would not cover the footer, which locates the columns.
_SEALED = re.compile(rb'(\d{1,10}) sha256:([0-9a-f]{64})')
_OPEN = b'0' * 64
_LARGEST = 2**31
_TYPES = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
_LISTS = {'event_times': pa.list_(pa.float64()), 'events': pa.list_(pa.string())}


def schema_of(plan: SweepPlan) -> pa.Schema:
    """Return the columns of a shard, with the scene and the versions as metadata."""
    sweep, record = plan.sweep, plan.record
    measured: list[str] = list(sweep.statistics)
    if 'event_times' in measured:
        measured.append('events')
    columns = [
        pa.field('index', pa.int64()),
        *(pa.field(key, _TYPES[axis.kind]) for axis in plan.axes for key in axis.keys),
        pa.field('t', pa.float64()),
        *(pa.field(f'{half}_{name}', pa.float64()) for half, names in plan.names.items()
          for name in names),
        pa.field('energy', pa.float64()),
        *(pa.field(name, _LISTS.get(name, pa.float64())) for name in measured),
        *(pa.field(name, pa.float64()) for name in (
            sweep.reduction.columns if sweep.reduction else ())),
        pa.field('alarms', pa.list_(pa.string())),
        pa.field('failure', pa.string()),
    ]
    return pa.schema(columns, {
        _DIGEST: record['digest'],
        b'hnn_vi_ros.sweep': as_json(record['sweep']),
        b'hnn_vi_ros.scene': as_json(record['scene']),
        b'hnn_vi_ros.models': as_json(record['models']),
        b'hnn_vi_ros.versions': as_json(record['versions'])})


def _plain(value: Any, kind: pa.DataType) -> Any:
    """Return a value as its column holds it."""
    return json.dumps(value) if kind == pa.string() and not isinstance(value, str) else value


def write_shard(plan: SweepPlan, shard: int, blocks: Iterable[list[Rows]],
                on_block: Callable[[int], None] = lambda count: None) -> bytes:
    """
    Return the file of a shard: one row group, which holds no more rows than the plan allows.

    Parameters
    ----------
    plan : SweepPlan
        Of the sweep.
    shard : int
        Which.
    blocks : iterable of list of Rows
        Its trajectories.
    on_block : callable, optional
        Called with how many trajectories have been made, after each block.

    """
    parts: list[Rows] = []
    for block in blocks:
        parts += block
        on_block(sum(len(part.indices) for part in block))
    schema = schema_of(plan)
    table = pa.table(_columns(parts, schema, plan.keys), schema=schema)
    stream = BytesIO()
    with pq.ParquetWriter(stream, schema, compression='zstd', version='2.6') as writer:
        writer.write_table(table, row_group_size=table.num_rows)
        writer.add_key_value_metadata({_SHARD: b'%d sha256:%b' % (shard, _OPEN)})
    content = stream.getvalue()
    before, _, after = content.rpartition(_OPEN)
    return before + _digest_of(content) + after


def _columns(parts: list[Rows], schema: pa.Schema, keys: list[str]) -> list[pa.Array]:
    """Return the columns of a shard: a row for each sample that is kept, by index."""
    indices = np.concatenate([part.indices for part in parts])
    lengths = np.repeat([part.length for part in parts], [len(part.indices) for part in parts])
    owners = np.repeat(np.arange(len(indices)), lengths)
    order = np.argsort(indices[owners], kind='stable')
    owners = owners[order]

    def of_each(values: Iterable[Any], name: str) -> pa.Array:
        """Return a value for each trajectory in each of its rows."""
        return pa.array(list(values), schema.field(name).type).take(pa.array(owners))

    def numbers(samples: Iterable[np.ndarray]) -> pa.Array:
        """Return numbers of all samples; NaN is none."""
        return pa.array(np.concatenate(list(samples))[order], from_pandas=True)

    columns = [pa.array(indices[owners])]
    columns += [of_each((_plain(row[k], schema.field(key).type) for part in parts
                         for row in part.values), key) for k, key in enumerate(keys)]
    columns.append(numbers(part.t for part in parts))
    for half in ('q', 'p'):
        columns += [numbers(getattr(part, half)[:, i] for part in parts)
                    for i in range(getattr(parts[0], half).shape[1])]
    columns.append(numbers(part.energy for part in parts))
    columns += [of_each((part.measured.get(name) for part in parts for _ in part.indices), name)
                for name in schema.names[len(columns):-2]]
    columns.append(of_each((own for part in parts for own in part.alarms), 'alarms'))
    columns.append(of_each((part.failure for part in parts for _ in part.indices), 'failure'))
    return columns


def check_shard(path: Path, digest: str, shard: int) -> int:
    """
    Check that a file is a shard of a sweep, to its last bit; return how many trajectories failed.

    Parameters
    ----------
    path : Path
        The file.
    digest : str
        Of the sweep.
    shard : int
        Which.

    Raises
    ------
    RecordingError
        It is damaged, another shard, or that of another sweep; one line, without a remedy.

    """
    try:
        content = read_limited(path, _LARGEST)
        seal = _SEALED.search(content, max(content.rfind(_SHARD), 0))
        if seal is None or seal[2] != _digest_of(
                content[:seal.start(2)] + _OPEN + content[seal.end(2):]):
            raise ValueError('its SHA-256 is not the one that it was written with')
        table = pq.read_table(pa.BufferReader(content), columns=['failure'])
        failure = table['failure']
    except (OSError, ValueError, KeyError, pa.ArrowException) as problem:
        raise RecordingError(f'{path}: is damaged ({one_line(problem)})') from problem
    if (table.schema.metadata or {}).get(_DIGEST) != digest.encode():
        raise RecordingError(f'{path}: is of another sweep')
    if int(seal[1]) != shard:
        raise RecordingError(f'{path}: is shard {int(seal[1])} of this sweep')
    # One row each.
    return len(failure) - int(failure.null_count)


def _digest_of(content: bytes) -> bytes:
    return sha256(content).hexdigest().encode()
