# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write shards as Parquet; equal trajectories give equal bytes."""

from collections import Counter
from collections.abc import Iterable
from hashlib import sha256
from io import BytesIO
import json
from pathlib import Path
import re
from typing import Any

from hnn_vi_ros.errors import optional, RecordingError
from hnn_vi_ros.files import memory_for, one_line, read_limited
from hnn_vi_ros.sweeps.plan import canonical_json, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Rows
import numpy as np

# Sweeps import this module first, so pyarrow is reported missing before anything else runs.
with optional('pyarrow', 'a sweep'):
    import pyarrow as pa
    import pyarrow.parquet as pq

_DIGEST, _SHARD = b'hnn_vi_ros.digest', b'hnn_vi_ros.shard'
# Seal of a shard: its number and the SHA-256 of its file, computed with zeros in place of these
# digits. Page checksums would not cover the footer, which locates the columns.
_SEAL = re.compile(rb'(\d{1,10}) sha256:([0-9a-f]{64})')
_DIGEST_PLACEHOLDER = b'0' * 64
_MAX_SHARD_SIZE = 2**31
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
        b'hnn_vi_ros.sweep': canonical_json(record['sweep']),
        b'hnn_vi_ros.scene': canonical_json(record['scene']),
        b'hnn_vi_ros.models': canonical_json(record['models']),
        b'hnn_vi_ros.versions': canonical_json(record['versions'])})


def _convert(value: Any, kind: pa.DataType) -> Any:
    """Convert a value to the type of its column."""
    return json.dumps(value) if kind == pa.string() and not isinstance(value, str) else value


def write_shard(plan: SweepPlan, shard: int, blocks: Iterable[list[Rows]]) -> bytes:
    """
    Return the file of a shard: one row group with at most the planned number of rows.

    Parameters
    ----------
    plan : SweepPlan
        Plan of the sweep.
    shard : int
        Number of the shard.
    blocks : iterable of list of Rows
        Blocks of its trajectories.

    """
    parts = [rows for block in blocks for rows in block]
    schema = schema_of(plan)
    table = pa.table(_columns(parts, schema, plan.keys), schema=schema)
    stream = BytesIO()
    with pq.ParquetWriter(stream, schema, compression='zstd', version='2.6') as writer:
        writer.write_table(table, row_group_size=table.num_rows)
        writer.add_key_value_metadata({_SHARD: b'%d sha256:%b' % (shard, _DIGEST_PLACEHOLDER)})
    content = stream.getvalue()
    before, _, after = content.rpartition(_DIGEST_PLACEHOLDER)
    return before + _digest_of(content) + after


def _columns(parts: list[Rows], schema: pa.Schema, keys: list[str]) -> list[pa.Array]:
    """Return the columns of a shard: one row per kept sample, ordered by index."""
    indices = np.concatenate([part.indices for part in parts])
    lengths = np.repeat([part.length for part in parts], [len(part.indices) for part in parts])
    owners = np.repeat(np.arange(len(indices)), lengths)
    order = np.argsort(indices[owners], kind='stable')
    owners = owners[order]

    def of_each(values: Iterable[Any], name: str) -> pa.Array:
        """Repeat each trajectory's value in all of its rows."""
        return pa.array(list(values), schema.field(name).type).take(pa.array(owners))

    def numbers(samples: Iterable[np.ndarray]) -> pa.Array:
        """Return the numbers of all samples; NaN becomes null."""
        return pa.array(np.concatenate(list(samples))[order], from_pandas=True)

    columns = [pa.array(indices[owners])]
    columns += [of_each((_convert(row[k], schema.field(key).type) for part in parts
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


def check_shard(path: Path, digest: str, shard: int) -> tuple[int, Counter[str]]:
    """
    Check that a file is an intact shard of a sweep; return the number of failed trajectories.

    The second result is the number of trajectories with each kind of alarm.

    Parameters
    ----------
    path : Path
        The file.
    digest : str
        Digest of the sweep.
    shard : int
        Number of the shard.

    Raises
    ------
    RecordingError
        Damaged, another shard, or a shard of another sweep; the message is one line, no remedy.

    """
    try:
        content = read_limited(path, _MAX_SHARD_SIZE)
        seal = _SEAL.search(content, max(content.rfind(_SHARD), 0))
        if seal is None or seal[2] != _digest_of(
                content[:seal.start(2)] + _DIGEST_PLACEHOLDER + content[seal.end(2):]):
            raise ValueError('its SHA-256 differs from the recorded one')
        # Without threads: one that still starts when the process ends would abort it.
        # The numbers of a row take more in the file than these columns in memory.
        with memory_for(len(content) + 2**29):
            table = pq.ParquetFile(pa.BufferReader(content)).read(
                ['failure', 'index', 'alarms'], use_threads=False)
            # A trajectory has the same alarms in all of its rows, and one row if it failed.
            first = np.flatnonzero(np.diff(table['index'].to_numpy(), prepend=-1))
            alarms = Counter(kind for row in table['alarms'].take(first).to_pylist()
                             for kind in set(row or ()))
    except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as problem:
        raise RecordingError(f'{path}: is damaged ({one_line(problem)})') from problem
    if (table.schema.metadata or {}).get(_DIGEST) != digest.encode():
        raise RecordingError(f'{path}: belongs to another sweep')
    if int(seal[1]) != shard:
        raise RecordingError(f'{path}: is shard {int(seal[1])} of this sweep')
    return len(table) - int(table['failure'].null_count), alarms


def _digest_of(content: bytes) -> bytes:
    return sha256(content).hexdigest().encode()
