# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the content of rerun recordings back."""

from pathlib import Path
import subprocess
import sys

from rerun.chunk import RrdReader


def read(path: Path) -> dict[str, dict[str, list]]:
    """Return the temporal data as entity -> column -> rows."""
    entities: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            rows = entities.setdefault(chunk.entity_path, {})
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                # As integers: otherwise time columns become datetime objects.
                if name in ('sim_time', 'ros_time'):
                    column = column.cast('int64')
                rows.setdefault(name, []).extend(column.to_pylist())
    return entities


def still_entities(path: Path) -> set[str]:
    """Return the entities with static data."""
    return {chunk.entity_path for chunk in RrdReader(path).stream() if chunk.is_static}


def assert_verified(path: Path) -> None:
    """Assert that rerun accepts a recording."""
    check = subprocess.run([sys.executable, '-m', 'rerun_cli', 'rrd', 'verify', str(path)],
                           capture_output=True, text=True, timeout=60)
    assert check.returncode == 0, check.stderr
