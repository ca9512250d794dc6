# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One live line with the state of a run."""

from collections.abc import Callable
import sys
import time
from typing import Protocol

from hnn_vi_ros.files.standard_streams import rewrite_line
from hnn_vi_ros.simulation.sample import Sample


class Logger(Protocol):
    """The methods needed of a logger: ROS loggers have them."""

    def info(self, message: str) -> None:
        """Log a line."""


class StatusLine:
    """
    Show time, energy and pace: rewritten in place on a terminal, else logged now and then.

    Parameters
    ----------
    logger : Logger
        Takes the lines when standard output is no terminal.
    now : callable
        A steady clock [s].

    """

    def __init__(self, logger: Logger, now: Callable[[], float] = time.monotonic):
        self._logger, self._now = logger, now
        self._terminal = sys.stdout.isatty()
        self._interval = 0.2 if self._terminal else 5.0
        self._shown = False
        self.restart(0)

    def restart(self, stamp: int) -> None:
        """Measure the pace from now and this stamp on [ns]: a pause or a reset has no pace."""
        now = self._now()
        self._last, self._next = (now, stamp), now + self._interval

    def show(self, sample: Sample, overruns: int) -> None:
        """Show a sample, if it is time to."""
        now = self._now()
        if now < self._next:
            return
        wall, stamp = self._last
        pace = (sample.stamp - stamp) * 1e-9 / (now - wall)
        self._last, self._next = (now, sample.stamp), now + self._interval
        text = (f't = {sample.stamp * 1e-9:.2f} s   H = {sample.energy:.6g} J   '
                f'energy error {sample.energy_error:+.2e}   {pace:.2f} x real time'
                + (f'   {overruns} overruns' if overruns else ''))
        if self._terminal:
            rewrite_line(sys.stdout, text)
            self._shown = True
        else:
            self._logger.info(text)

    def close(self) -> None:
        """Leave the line on the terminal: what is printed next begins a line of its own."""
        if self._shown:
            self._shown = False
            sys.stdout.write('\n')
            sys.stdout.flush()
