# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Number of usable processors; threads and processes that end with their caller."""

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
    """Return the number of usable processors, given by the CPU affinity if there is one."""
    if hasattr(os, 'sched_getaffinity'):
        # A container's cpuset, taskset or a batch queue may allow only some of the processors.
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(work: Callable[[int], _Result], workers: int) -> list[_Result]:
    """
    Return the results of a function for 0, 1, ... workers - 1, each in its own thread.

    After an exception in one of them, or Ctrl-C, all end at their next call of
    ``check_interrupt``.
    """
    stop = Event()

    def begin(worker: int) -> _Result:
        _own.stop = stop
        return work(worker)

    pool = ThreadPoolExecutor(workers)
    try:
        # Consume the iterator, so that an exception of a worker is raised here.
        return list(pool.map(begin, range(workers)))
    except BaseException:
        stop.set()
        raise
    finally:
        # Do not wait for a thread that is compiling: its result is no longer needed.
        pool.shutdown(wait=False)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if this thread should stop; call periodically in long loops."""
    if hasattr(_own, 'stop') and _own.stop.is_set():
        raise KeyboardInterrupt


class Helper:
    """
    A thread that helps the thread that made it, and ends with the process.

    Parameters
    ----------
    work : callable
        Called in the thread; an exception of it is raised by ``join``.

    """

    def __init__(self, work: Callable[[], None]):
        self._work, self._stop = work, Event()
        self._problem: BaseException | None = None
        self._thread = Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        _own.stop = self._stop
        try:
            self._work()
        except BaseException as problem:  # noqa: B902  raised by join
            self._problem = problem

    @property
    def started(self) -> bool:
        """Return whether the thread was started."""
        return self._thread.ident is not None

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the thread, if it was started, and raise its exception."""
        if self.started:
            self._thread.join()
        if self._problem is not None:
            raise self._problem

    def stop(self) -> None:
        """End the work at its next call of ``check_interrupt``, without waiting for it."""
        self._stop.set()


@contextmanager
def ignore_sigint_in_children() -> Iterator[None]:
    """
    Make child processes started inside ignore SIGINT from their first instruction.

    A child that sets this itself would do so only after seconds of imports, in which an interrupt
    prints a traceback. An interrupt during these milliseconds is lost and must be repeated. In
    threads other than the main one, which cannot set signal handlers, this does nothing.
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
    Yield a pool of spawned processes that end with their parent process.

    Submit work inside ``ignore_sigint_in_children``, since a submission starts a process. Any
    exception inside, including KeyboardInterrupt, kills the processes at once, because user code
    may never return.
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
    # Ctrl-C in a terminal reaches all its processes; the parent ends its children.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None, 'it was spawned'

    def end() -> None:
        parent.join()
        os._exit(1)
    Thread(target=end, daemon=True).start()
