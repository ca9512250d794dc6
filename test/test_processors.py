# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Processors: those that this process may use count, not those of the machine."""

import os
from pathlib import Path
import re

from hnn_vi_ros.commands import doctor
from hnn_vi_ros.processors import usable_processors
import pytest
from studies import hard_cases

PACKAGE = Path(__file__).resolve().parents[1] / 'hnn_vi_ros'
# These name the machine, whose processors are all that it has.
OF_THE_MACHINE = {'processors.py', 'accuracy/automatic_choice.py', 'commands/doctor.py'}


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
