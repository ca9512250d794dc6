# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes that Ctrl-C of their terminal does not reach: who began them ends them."""

from collections.abc import Iterator
from contextlib import contextmanager
import signal
from threading import current_thread, main_thread


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
