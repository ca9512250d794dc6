# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a sweep: what it holds, what is still to be made, and how a file comes into it."""

from contextlib import suppress
import json
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import one_line, parse_json, read_limited, replacing, write_new
from hnn_vi_ros.sweeps.parquet import check_shard
from hnn_vi_ros.sweeps.plan import as_json, SweepPlan

_RECORD = 'sweep.json'
_LARGEST = 2**26


class Survey(NamedTuple):
    """
    Shards of a sweep, each checked to its last bit.

    Parameters
    ----------
    missing : list of int
        Those to make: that are not there, or cannot be used.
    damaged : list of str
        Files that cannot be used, and why.
    failures : int
        Trajectories that failed, in the others.

    """

    missing: list[int]
    damaged: list[str]
    failures: int


class SweepFolder:
    """
    A folder that processes fill with shards; one that is renamed into its place is whole.

    Parameters
    ----------
    path : Path
        It need not exist.

    """

    def __init__(self, path: Path):
        self.path = path

    def record(self) -> dict[str, Any] | None:
        """
        Return the content of ``sweep.json``; None if the file is missing.

        Raises
        ------
        RecordingError
            It cannot be read.

        """
        file = self.path / _RECORD
        try:
            found = parse_json(read_limited(file, _LARGEST))
            if not isinstance(found, dict) or not isinstance(found.get('scene'), dict):
                raise ValueError('no record of a sweep')
            return found
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as problem:
            raise RecordingError(f'{file}: {one_line(problem)}; put it back as it was, remove it '
                                 'if no shard is there, or give another --out') from problem

    def begin(self, plan: SweepPlan) -> None:
        """
        Make the folder that of a sweep, or find that it is.

        Raises
        ------
        RecordingError
            It cannot be written, holds something else or another sweep.

        """
        there = self.record()
        if there is None:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                strange = next((file.name for file in self.path.iterdir()
                                if not file.name.startswith('.') and file.name != _RECORD), None)
                if strange is not None:
                    raise RecordingError(f'{self.path} holds {strange} and no {_RECORD}: no sweep '
                                         'began there; give another --out')
                with suppress(FileExistsError):
                    write_new(self.path / _RECORD, as_json(plan.record).encode())
            except OSError as problem:
                raise RecordingError(f'{self.path}: {problem.strerror}; give another --out'
                                     ) from problem
            # Another process may have begun another sweep meanwhile.
            there = self.record()
        if there != plan.record:
            raise RecordingError(
                f'{self.path} holds another sweep: {_difference(there, plan.record)}; give '
                'another --out, or take that sweep as it was')

    def file(self, shard: int) -> Path:
        """Return the file of a shard."""
        return self.path / f'part-{shard:06d}.parquet'

    def survey(self, plan: SweepPlan) -> Survey:
        """Check all shards."""
        missing, damaged, failures = [], [], 0
        for shard in range(plan.shards):
            file = self.file(shard)
            try:
                if file.exists():
                    failures += check_shard(file, plan.record['digest'], shard)
                else:
                    missing.append(shard)
            except RecordingError as problem:
                missing.append(shard)
                damaged.append(str(problem))
        return Survey(missing, damaged, failures)

    def put(self, shard: int, content: bytes) -> None:
        """
        Add the file of a shard, whole or not at all.

        Raises
        ------
        RecordingError
            It cannot be written.

        """
        file = self.file(shard)
        try:
            with replacing(file) as part:
                part.write_bytes(content)
        except OSError as problem:
            # Another sweep into this folder may have made the same file, and cleaned up.
            if not (isinstance(problem, FileNotFoundError) and file.is_file()):
                raise RecordingError(f'{file}: {one_line(problem)}; what is whole stays: mend '
                                     'that, and give the same command again') from problem
        # Processes killed while writing it left these files; it is whole now.
        for left in self.path.glob(f'.{file.stem}.*'):
            left.unlink(missing_ok=True)


def _difference(there: Any, here: Any, key: str = '') -> str:
    """Return where two records differ first, and how; what only one has comes first."""
    if isinstance(there, dict) and isinstance(here, dict):
        # The digest is that of all others.
        for name in sorted(dict.fromkeys((*here, *there)), key=lambda name: (
                name == 'digest', name in here and name in there)):
            if there.get(name) != here.get(name):
                return _difference(there.get(name), here.get(name), f'{key}.{name}'.lstrip('.'))
    if isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for k, (one, other) in enumerate(zip(there, here, strict=True)):
            if one != other:
                return _difference(one, other, f'{key}.{k}')
    return f'{key} is {json.dumps(there)[:80]} there, {json.dumps(here)[:80]} here'
