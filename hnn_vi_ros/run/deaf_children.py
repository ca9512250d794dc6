# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes that Ctrl-C of their terminal does not reach: who began them ends them."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
import os
import signal
from threading import current_thread, main_thread, Thread


@contextmanager
def deaf_children() -> Iterator[None]:
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
def deaf_workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """
    Yield a pool of spawned processes that end with the process that began them.

    Submit what they are to do inside ``deaf_children``: these begin the processes. An error
    inside, an interrupt among them, ends the processes at once, whatever they are doing: code of
    the user's may never return.
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
