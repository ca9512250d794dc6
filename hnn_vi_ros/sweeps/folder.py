# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a sweep: what it holds, what is still to be made, and how a file comes into it."""

import json
import os
from pathlib import Path
import socket
from typing import Any, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.limits import parse_json
from hnn_vi_ros.files.regular_file import read_limited
from hnn_vi_ros.files.yaml_text import one_line
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
    A folder that several processes and machines fill with shards.

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
            raise RecordingError(f'{file}: {one_line(problem)}; put it back as it was, or give '
                                 'another --out') from problem

    def begin(self, plan: SweepPlan) -> None:
        """
        Make the folder that of a sweep, or find that it is.

        Raises
        ------
        RecordingError
            It cannot be written, holds something else or another sweep.

        """
        there = self.record()
        if there is not None:
            if there != plan.record:
                raise RecordingError(
                    f'{self.path} holds another sweep: {_difference(there, plan.record)}; give '
                    'another --out, or take that sweep as it was')
            return
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            strange = next((file.name for file in self.path.iterdir()
                            if not file.name.startswith('.')), None)
        except OSError as problem:
            raise RecordingError(f'{self.path}: {problem.strerror}; give another --out'
                                 ) from problem
        if strange is not None:
            if self.record() is None:
                raise RecordingError(f'{self.path} holds {strange} and no {_RECORD}: no sweep '
                                     'began there; give another --out')
            # Another process began it just now.
            self.begin(plan)
            return
        self._place(_RECORD, as_json(plan.record).encode())

    def file(self, shard: int) -> Path:
        """Return the file of a shard."""
        return self.path / f'part-{shard:06d}.parquet'

    def survey(self, plan: SweepPlan, share: tuple[int, int] = (0, 1)) -> Survey:
        """Check every n-th shard, from the i-th on."""
        missing, damaged, failures = [], [], 0
        for shard in range(share[0], plan.shards, share[1]):
            try:
                failures += check_shard(self.file(shard), plan.record['digest'], shard)
            except FileNotFoundError:
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
        self._place(self.file(shard).name, content)

    def _place(self, name: str, content: bytes) -> None:
        """Write a file under another name, and rename it once it is on the disk."""
        part = self.path / f'.{name}.{socket.gethostname()}.{os.getpid()}'
        try:
            with open(part, 'wb') as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.path / name)
            # So that the name outlives the end of the power as well.
            folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as problem:
            if isinstance(problem, FileNotFoundError) and (self.path / name).is_file():
                # Another process made the same file meanwhile, and cleaned up.
                return
            part.unlink(missing_ok=True)
            raise RecordingError(f'{self.path / name}: {one_line(problem)}; what is whole stays: '
                                 'mend that, and give the same command again') from problem
        # Processes killed while writing it left these files; it is whole now.
        for left in self.path.glob(f'.{name}.*'):
            left.unlink(missing_ok=True)


def _difference(there: Any, here: Any, key: str = '') -> str:
    """Return where two records differ first, and how; what only one has comes first."""
    if isinstance(there, dict) and isinstance(here, dict):
        for name in sorted(dict.fromkeys((*here, *there)), key=lambda x: x in here and x in there):
            if there.get(name) != here.get(name) and name != 'digest':
                return _difference(there.get(name), here.get(name), f'{key}.{name}'.lstrip('.'))
    if isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for k, (one, other) in enumerate(zip(there, here, strict=True)):
            if one != other:
                return _difference(one, other, f'{key}.{k}')
    return f'{key or "its digest"} is {json.dumps(there)[:80]} there, {json.dumps(here)[:80]} here'


def shards_of(share: str) -> tuple[int, int]:
    """
    Return the share that ``I/N`` names.

    Raises
    ------
    ValueError
        It names none.

    """
    first, _, every = share.partition('/')
    if not (first.isdecimal() and every.isdecimal() and int(first) < int(every)):
        raise ValueError(f'--shard {share}: expected I/N, counted from 0: 0/N to N-1/N')
    return int(first), int(every)
