# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Processors that this process may use, and children that no interrupt reaches."""

import os
import re
import signal
import subprocess
import sys
from threading import Thread

from hnn_vi_ros.commands import doctor
from hnn_vi_ros.simulation import ignore_sigint_in_children, usable_processors
import pytest
from sources import PACKAGE
from studies import hard_cases

# These name the machine, whose processors are all that it has.
OF_THE_MACHINE = {'simulation/processors.py', 'simulation/accuracy/automatic_choice.py',
                  'commands/doctor.py'}


@pytest.mark.skipif(not hasattr(os, 'sched_setaffinity'), reason='takes affinities, as Linux has')
def test_a_process_that_is_bound_to_one_processor_has_one(capsys):
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        assert usable_processors() == 1
        assert hard_cases.parser().parse_args([]).jobs == 1
        doctor.main([])
        assert 'of which 1 for this process' in capsys.readouterr().out
    finally:
        os.sched_setaffinity(0, before)
    assert usable_processors() == len(before)


def test_nothing_else_counts_the_processors_of_the_machine():
    counts = {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob('*.py')
              if re.search(r'cpu_count|sched_getaffinity', path.read_text())}
    assert counts == OF_THE_MACHINE


# Children that an interrupt of the terminal does not reach.

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
