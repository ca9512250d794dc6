# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark's table: for people in Markdown, for programs in JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, UTC
from importlib.metadata import PackageNotFoundError, version
import json
from pathlib import Path
import platform

from benchmarks.measurement import Row
from hnn_vi_ros.studies.results import commit, machine

_PACKAGES = ('numpy', 'numba', 'llvmlite', 'scipy', 'jax', 'jaxlib', 'diffrax', 'torch',
             'torchdiffeq')
_HEADING = """\
# Benchmarks

Every row is measured against its peer in turns, in one run, one thread each unless it says
otherwise; `make bench` writes this file anew. A ratio is the median of the turns' ratios, ours
over the peer's, with its quartiles; at most its target is good.
"""


def as_json(rows: Sequence[Row]) -> str:
    """Return a list of {name, ratio, target}."""
    return json.dumps(
        [{'name': row.name, 'ratio': row.ratio, 'target': row.target} for row in rows],
        indent=2) + '\n'


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Keep the rows of a group."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([asdict(row) for row in rows], indent=2) + '\n')


def read_rows(path: Path) -> list[Row] | None:
    """Return the rows of a group that were kept, None where there are none."""
    if not path.is_file():
        return None
    return [Row(**{**row, 'quartiles': tuple(row['quartiles'])})
            for row in json.loads(path.read_text())]


def as_table(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = ['| row | ours | peer | ratio | quartiles | turns | target | met |',
             '|---|---|---|---|---|---|---|---|']
    for row in rows:
        low, high = row.quartiles
        target = '' if row.target is None else f'{row.target:g}'
        met = {None: '', True: 'yes', False: '**no**'}[row.met]
        lines.append(
            f'| {row.name} | {row.ours} | {row.peer} | {row.ratio:.2f} {row.unit}'.rstrip()
            + f' | {low:.2f} to {high:.2f} | {row.repetitions} | {target} | {met} |')
    return '\n'.join(lines) + '\n'


def as_markdown(rows: Sequence[Row], seeds: dict[str, int]) -> str:
    """Return the whole document."""
    missed = [row for row in rows if row.met is False]
    misses = [f'- **{row.name}**, {row.ratio:.2f} for {row.target:g}: '
              f'{row.miss or "not explained yet."}' for row in missed]
    notes = [f'- {row.name}: {row.note}.' for row in rows if row.note]
    parts = [_HEADING, as_table(rows), '## Rows that miss their target\n',
             '\n'.join(misses or ['None.']) + '\n', '## Notes\n', '\n'.join(notes) + '\n',
             '## Where\n', '\n'.join(_circumstances(seeds)) + '\n']
    return '\n'.join(parts)


def _circumstances(seeds: dict[str, int]) -> list[str]:
    return [
        f'- Machine: {machine()}',
        f'- Commit: {commit()}',
        f'- Versions: Python {platform.python_version()}, {_versions()}',
        f'- Date: {datetime.now(UTC):%Y-%m-%d %H:%M} UTC',
        f'- Seeds: {", ".join(f"{name} {seed}" for name, seed in seeds.items())}',
    ]


def _versions() -> str:
    versions = []
    for name in _PACKAGES:
        try:
            versions.append(f'{name} {version(name)}')
        except PackageNotFoundError:
            versions.append(f'no {name}')
    return ', '.join(versions)
