# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The pace of the status line is that of the steps since it was last started, by any clock."""

import io
import re
import sys

from hnn_vi_ros.recording import Sample
from hnn_vi_ros.run import StatusLine
import numpy as np
import pytest

SECOND = 10**9


class Terminal(io.StringIO):
    """A standard output that is a terminal."""

    def isatty(self) -> bool:
        return True


class Shown:
    """A status line on a clock that is put forward by hand, and the paces that it shows."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.time, self.terminal = 0.0, Terminal()
        monkeypatch.setattr(sys, 'stdout', self.terminal)
        self.line = StatusLine(None, 'J', lambda: self.time)

    def run(self, begin: int, seconds: float, pace: float) -> None:
        """Show samples of a run at a pace, every 20 ms of wall time, from a stamp on."""
        start = self.time
        for tick in range(1, round(seconds / 0.02) + 1):
            self.time = start + 0.02 * tick
            self.line.show(sample(begin + round(tick * 0.02 * pace * SECOND)), 0, True)

    @property
    def paces(self) -> list[float]:
        """Return what was shown, and forget it."""
        found = re.findall(r'(\S+) x real time', self.terminal.getvalue())
        self.terminal.seek(0)
        self.terminal.truncate()
        return [float(pace) for pace in found]


def sample(stamp: int) -> Sample:
    one = np.ones(1)
    return Sample(0, stamp, one, one, one, one, 0.5, 0.5, 0.0)


def test_pace_counts_from_the_first_step(monkeypatch):
    shown = Shown(monkeypatch)
    # Configuration and discovery.
    shown.time = 30.0
    shown.line.restart(0)
    shown.run(0, 1.0, pace=2.0)
    paces = shown.paces
    # Every 0.2 s, of which rounding may take one to the next sample.
    assert len(paces) in (4, 5) and set(paces) == {2.0}


@pytest.mark.parametrize('wait, before, after', [
    (20.0, SECOND, SECOND), (0.0, 100 * SECOND, 0), (7.0, 0, 50 * SECOND)],
    ids=['pause', 'reset of the time', 'resumed'])
def test_pace_counts_from_each_restart(monkeypatch, wait, before, after):
    shown = Shown(monkeypatch)
    shown.line.restart(before - SECOND)
    shown.run(before - SECOND, 1.0, pace=1.0)
    shown.time += wait
    shown.line.restart(after)
    shown.run(after, 1.0, pace=1.0)
    paces = shown.paces
    assert len(paces) >= 8 and set(paces) == {1.0}


def test_line_is_left_once_so_that_what_follows_begins_a_line_of_its_own(monkeypatch):
    shown = Shown(monkeypatch)
    shown.line.close()
    assert shown.terminal.getvalue() == ''
    shown.run(0, 0.3, 1.0)
    assert '   relative energy error +0.00e+00   ' in shown.terminal.getvalue()
    shown.line.close()
    shown.line.close()
    assert shown.terminal.getvalue().count('\n') == 1
    assert shown.terminal.getvalue().endswith('real time\n')
