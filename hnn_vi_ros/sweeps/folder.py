# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a sweep: its record, its missing shards, and the atomic writing of files."""

from collections import Counter
import json
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import (
    make_folder, one_line, parse_json, read_limited, write_bytes, write_text)
from hnn_vi_ros.sweeps.parquet import check_shard
from hnn_vi_ros.sweeps.plan import canonical_json, SweepPlan

_RECORD = 'sweep.json'
_MAX_RECORD_SIZE = 2**26


class ShardSurvey(NamedTuple):
    """
    Result of checking the checksums of all shards.

    Parameters
    ----------
    missing : list of int
        Shards that are missing or damaged.
    damaged : list of str
        Damaged files, each with the reason.
    failures : int
        Number of failed trajectories in the intact shards.
    alarms : Counter of str
        Number of trajectories with each kind of alarm.

    """

    missing: list[int]
    damaged: list[str]
    failures: int
    alarms: Counter[str]


class SweepFolder:
    """
    The folder of a sweep; shards are renamed into place only when complete.

    Parameters
    ----------
    path : Path
        Path of the folder; it need not exist.

    """

    def __init__(self, path: Path):
        self.path = path

    def record(self) -> dict[str, Any] | None:
        """
        Return the content of ``sweep.json``; None if the file is missing.

        Raises
        ------
        RecordingError
            The file cannot be read.

        """
        file = self.path / _RECORD
        try:
            found = parse_json(read_limited(file, _MAX_RECORD_SIZE))
            if not isinstance(found, dict) or not isinstance(found.get('scene'), dict):
                raise ValueError('not the record of a sweep')
            return found
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as problem:
            raise RecordingError(f'{file}: {one_line(problem)}; restore it, remove it if the '
                                 'folder has no shards, or give another --out') from problem

    def begin(self, plan: SweepPlan) -> None:
        """
        Create the folder for a sweep, or check that it belongs to it.

        Raises
        ------
        RecordingError
            The folder cannot be written, holds something else, or holds another sweep.

        """
        there = self.record()
        if there is None:
            try:
                make_folder(self.path)
                strange = next((file.name for file in self.path.iterdir()
                                if not file.name.startswith('.') and file.name != _RECORD), None)
                if strange is not None:
                    raise RecordingError(f'{self.path} contains {strange} but no {_RECORD}: it is '
                                         'not the folder of a sweep; give another --out')
                write_text(self.path / _RECORD, canonical_json(plan.record), new=True)
            except OSError as problem:
                raise RecordingError(f'{self.path}: {problem.strerror}; give another --out'
                                     ) from problem
        elif there != plan.record:
            raise RecordingError(
                f'{self.path} contains another sweep: {_difference(there, plan.record)}; give '
                'another --out, or restore that sweep')

    def file(self, shard: int) -> Path:
        """Return the file of a shard."""
        return self.path / f'part-{shard:06d}.parquet'

    def survey(self, plan: SweepPlan) -> ShardSurvey:
        """Check all shards of the plan."""
        missing, damaged, failures, alarms = [], [], 0, Counter[str]()
        for shard in range(plan.shards):
            file = self.file(shard)
            try:
                if file.exists():
                    failed, alarmed = check_shard(file, plan.record['digest'], shard)
                    failures += failed
                    alarms += alarmed
                else:
                    missing.append(shard)
            except RecordingError as problem:
                missing.append(shard)
                damaged.append(str(problem))
        return ShardSurvey(missing, damaged, failures, alarms)

    def put(self, shard: int, content: bytes) -> None:
        """
        Write the file of a shard atomically.

        Raises
        ------
        RecordingError
            The file cannot be written.

        """
        file = self.file(shard)
        try:
            write_bytes(file, content)
        except OSError as problem:
            raise RecordingError(f'{file}: {problem.strerror}; complete shards are kept: '
                                 'correct this, and run the same command again') from problem
        # Temporary files of processes that were killed; the shard is complete now.
        for left in self.path.glob(f'.{file.stem}.*'):
            left.unlink(missing_ok=True)


def _difference(there: Any, here: Any, key: str = '') -> str:
    """Describe the first difference of two records; keys present in only one come first."""
    if isinstance(there, dict) and isinstance(here, dict):
        # The digest depends on all other keys, so it is compared last.
        for name in sorted(dict.fromkeys((*here, *there)), key=lambda name: (
                name == 'digest', name in here and name in there)):
            if there.get(name) != here.get(name):
                return _difference(there.get(name), here.get(name), f'{key}.{name}'.lstrip('.'))
    if isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for k, (one, other) in enumerate(zip(there, here, strict=True)):
            if one != other:
                return _difference(one, other, f'{key}.{k}')
    return f'{key} is {json.dumps(there)[:80]} there, {json.dumps(here)[:80]} here'
