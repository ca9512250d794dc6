# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make shards in this process or in several on this machine; any of them may be killed."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
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

# Number of consecutive worker losses, with no shard finished in between, that aborts the sweep.
_MOST_LOSSES = 3
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
                    'the sweep, its scene, its model or the versions of packages are others in a '
                    'worker than in the process that began it; make them the same')
            _ready[self.digest] = plan, Runner(plan)
        plan, runner = _ready[self.digest]
        return shard, write_shard(plan, shard, runner.shard(shard))


def make_here(plan: SweepPlan, folder: SweepFolder, shards: Sequence[int],
              on_block: Callable[[int], None]) -> Iterator[int]:
    """Make shards in this process, and yield the number of each one written."""
    runner = Runner(plan)
    for shard in shards:
        folder.put(shard, write_shard(plan, shard, runner.shard(shard), on_block))
        yield shard


def make_in_processes(job: ShardJob, folder: SweepFolder, shards: Sequence[int], processes: int
                      ) -> Iterator[int]:
    """
    Make shards in several processes, and yield the number of each one written.

    Raises
    ------
    HnnViRosError
        A shard cannot be written, or processes die repeatedly.

    """
    pending, losses = deque(shards), 0
    while pending:
        with worker_processes(min(processes, len(pending))) as pool:
            running: dict[Future[None], int] = {}
            try:
                while pending or running:
                    # Submit only enough to keep them busy: a waiting shard cannot be lost.
                    while pending and len(running) < 2 * processes:
                        with ignore_sigint_in_children():
                            future = pool.submit(_make, job, folder.path, pending[0])
                        running[future] = pending[0]
                        pending.popleft()
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        future.result()
                        losses = 0
                        yield running.pop(future)
            except BrokenProcessPool as problem:
                losses += 1
                if losses > _MOST_LOSSES:
                    raise HnnViRosError(
                        f'worker processes were killed {losses} times in a row, as for lack of '
                        'memory; take fewer --jobs, and give the same command again') from problem
                pending.extendleft(sorted(running.values(), reverse=True))


def _make(job: ShardJob, path: Path, shard: int) -> None:
    SweepFolder(path).put(*job.make(shard))
