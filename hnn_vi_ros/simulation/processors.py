# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Processors that this process may use; threads and processes that end with their caller."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
import os
import signal
from threading import current_thread, Event, local, main_thread, Thread
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


@contextmanager
def ignore_sigint_in_children() -> Iterator[None]:
    """
    Let processes that are begun inside ignore SIGINT, from their first instruction on.

    One that sets this itself is deaf only after seconds of imports, in which an interrupt prints a
    traceback. An interrupt meanwhile, of some milliseconds, is lost: it is pressed again. Other
    threads than the main one set no signals: there it does nothing.
    """
    if current_thread() is not main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def worker_processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """
    Yield a pool of spawned processes that end with the process that began them.

    Submit their work inside ``ignore_sigint_in_children``, since a submission begins a process. An
    error inside, an interrupt among them, ends the processes at once, whatever they are doing:
    code of the user's may never return.
    """
    others = set(active_children())
    with ProcessPoolExecutor(count, get_context('spawn'), initializer=_begin) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in set(active_children()) - others:
                worker.kill()
            raise


def _begin() -> None:
    # That of the terminal reaches all its processes; the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None, 'it was spawned'

    def end() -> None:
        parent.join()
        os._exit(1)
    Thread(target=end, daemon=True).start()
