# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shards made by this process, or by several of this machine of which any may be killed."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
import os
from pathlib import Path
import signal
from threading import Thread
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.run.deaf_children import deaf_children
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.parquet import write_shard
from hnn_vi_ros.sweeps.plan import make_plan, SweepPlan
from hnn_vi_ros.sweeps.trajectories import Runner

# Lost processes in a row, without a shard between them, after which something else is wrong.
_MOST_LOSSES = 3


@dataclass(frozen=True)
class ShardJob:
    """
    Job of another process that makes shards of a sweep.

    Parameters
    ----------
    definition : str or mapping
        See ``make_plan``.
    chosen : mapping
        See ``make_plan``.
    digest : str
        Of the plan that must come of it.
    device : str or None
        See ``make_plan``.

    """

    definition: str | Mapping[str, Any]
    chosen: Mapping[str, Any]
    digest: str
    device: str | None = None

    def prepare(self) -> tuple[SweepPlan, Runner]:
        """
        Return the plan and what makes its trajectories.

        Raises
        ------
        HnnViRosError
            It comes out otherwise here: other files or versions.

        """
        plan = make_plan(self.definition, self.chosen, self.device)
        if plan.record['digest'] != self.digest:
            raise HnnViRosError(
                'the sweep, its scene, its model or the versions of packages are others in a '
                'worker than in the process that began it; make them the same')
        return plan, Runner(plan)


def make_here(plan: SweepPlan, folder: SweepFolder, shards: Sequence[int],
              on_block: Callable[[int], None]) -> Iterator[int]:
    """Make shards in this process, and yield each that is in the folder."""
    runner = Runner(plan)
    for shard in shards:
        folder.put(shard, write_shard(plan, shard, runner.shard(shard), on_block))
        yield shard


def make_in_processes(job: ShardJob, folder: SweepFolder, shards: Sequence[int], processes: int
                      ) -> Iterator[int]:
    """
    Make shards in several processes, and yield each that is in the folder.

    Raises
    ------
    HnnViRosError
        A shard cannot be written, or processes die again and again.

    """
    pending, losses = deque(shards), 0
    while pending:
        stop = get_context('spawn').Event()
        with ProcessPoolExecutor(min(processes, len(pending)), get_context('spawn'),
                                 initializer=_begin, initargs=(stop,)) as pool:
            running: dict[Future[None], int] = {}
            try:
                while pending or running:
                    # No more than keeps them busy: a shard that waits is not lost with them.
                    while pending and len(running) < 2 * processes:
                        with deaf_children():
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
            except BaseException:
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                raise


_stop: Event | None = None


def _begin(stop: Event) -> None:
    """Prepare a worker: it ends on request, and with the process that began it."""
    global _stop
    _stop = stop
    # That of the terminal reaches all its processes; the first one tells the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None, 'it was spawned'

    def end() -> None:
        parent.join()
        os._exit(1)
    Thread(target=end, daemon=True).start()


class _Stopped(Exception):
    """The process that began a worker is about to end."""


def _heed(count: int) -> None:
    if _stop is not None and _stop.is_set():
        raise _Stopped


_ready: dict[str, tuple[SweepPlan, Runner]] = {}


def _make(job: ShardJob, path: Path, shard: int) -> None:
    if job.digest not in _ready:
        _ready[job.digest] = job.prepare()
    plan, runner = _ready[job.digest]
    SweepFolder(path).put(shard, write_shard(plan, shard, runner.shard(shard), _heed))
