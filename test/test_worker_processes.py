# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Children that an interrupt of the terminal does not reach."""

import signal
import subprocess
import sys
from threading import Thread

from hnn_vi_ros.processors import ignore_sigint_in_children

ASK = [sys.executable, '-c', 'import signal; print(signal.getsignal(signal.SIGINT).__class__)']


def handler_of_a_child() -> str:
    return subprocess.run(ASK, capture_output=True, text=True, check=True).stdout


def test_children_are_deaf_from_their_start_and_the_caller_hears_again():
    before = signal.getsignal(signal.SIGINT)
    with ignore_sigint_in_children():
        assert 'Handlers' in handler_of_a_child()
    assert signal.getsignal(signal.SIGINT) is before
    # Python has its own function there, of a child that hears.
    assert 'builtin_function' in handler_of_a_child()


def test_other_threads_leave_signals_alone():
    found = []

    def work() -> None:
        with ignore_sigint_in_children():
            found.append(signal.getsignal(signal.SIGINT))
    thread = Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(signal.SIGINT)]
