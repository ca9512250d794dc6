# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Number of processors that this process may use, and threads that end with their caller."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os
from threading import Event, local
from typing import TypeVar

_Result = TypeVar('_Result')
_own = local()


def usable_processors() -> int:
    """Return how many processors this process may use: its affinity's, or all without one."""
    if hasattr(os, 'sched_getaffinity'):
        # A container's cpuset, taskset or a queue may allow fewer than the machine has.
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(work: Callable[[int], _Result], workers: int) -> list[_Result]:
    """
    Return what a function returns for 0, 1, ... workers - 1, each in a thread of its own.

    Where it fails in one of them, or Ctrl-C is pressed, all end as soon as they ``heed``.
    """
    stop = Event()

    def begin(worker: int) -> _Result:
        _own.stop = stop
        return work(worker)

    pool = ThreadPoolExecutor(workers)
    try:
        # Taken from the iterator, so that a failure of one worker is raised here.
        return list(pool.map(begin, range(workers)))
    except BaseException:
        stop.set()
        raise
    finally:
        # Not for one that compiles, which nobody needs any more.
        pool.shutdown(wait=False)


def heed() -> None:
    """Raise KeyboardInterrupt in a thread that is to end; for what takes long, now and then."""
    if hasattr(_own, 'stop') and _own.stop.is_set():
        raise KeyboardInterrupt
