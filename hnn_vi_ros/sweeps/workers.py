# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make shards in this process or in several on this machine; any of them may be killed."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.simulation import ignore_sigint_in_children, worker_processes
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.parquet import write_shard
from hnn_vi_ros.sweeps.plan import make_plan, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Runner

# Cache of the plan and the runner of a sweep by digest: each shard brings a new copy of its job.
_ready: dict[str, tuple[SweepPlan, Runner]] = {}


@dataclass(frozen=True)
class ShardJob:
    """
    Job of a worker process that makes shards of a sweep; paths must be valid in that process.

    Parameters
    ----------
    definition : str or mapping
        See ``make_plan``.
    chosen : mapping
        See ``make_plan``.
    digest : str
        Expected digest of the plan.
    device : str or None
        See ``make_plan``.

    """

    definition: str | Mapping[str, Any]
    chosen: Mapping[str, Any]
    digest: str
    device: str | None = None

    def make(self, shard: int) -> tuple[int, bytes]:
        """
        Return a shard and its file.

        Raises
        ------
        HnnViRosError
            The plan differs in this process, because its files or versions differ.

        """
        # Lazily, with the first shard: an error in an actor's constructor loses its reason.
        if self.digest not in _ready:
            plan = make_plan(self.definition, self.chosen, self.device)
            if plan.record['digest'] != self.digest:
                raise HnnViRosError(
                    'the sweep, its scene, its model or the versions of packages differ between a '
                    'worker and the main process; make them the same')
            _ready[self.digest] = plan, Runner(plan)
        plan, runner = _ready[self.digest]
        return shard, write_shard(plan, shard, runner.shard(shard))


def make_here(plan: SweepPlan, folder: SweepFolder, shards: Sequence[int]) -> Iterator[int]:
    """Make shards in this process, and yield the number of each one written."""
    runner = Runner(plan)
    for shard in shards:
        folder.put(shard, write_shard(plan, shard, runner.shard(shard)))
        yield shard


def make_in_processes(job: ShardJob, folder: SweepFolder, shards: Sequence[int], processes: int
                      ) -> Iterator[int]:
    """
    Make shards in several processes, and yield the number of each one written.

    Raises
    ------
    HnnViRosError
        A shard cannot be written, or a process was killed.

    """
    try:
        with worker_processes(min(processes, len(shards))) as pool:
            with ignore_sigint_in_children():
                made = [pool.submit(_make, job, folder.path, shard) for shard in shards]
            for future in as_completed(made):
                yield future.result()
    except BrokenProcessPool as problem:
        raise HnnViRosError('a worker process was killed, perhaps for lack of memory; complete '
                            'shards are kept: run the same command again, with fewer --jobs'
                            ) from problem


def _make(job: ShardJob, path: Path, shard: int) -> int:
    SweepFolder(path).put(*job.make(shard))
    return shard
