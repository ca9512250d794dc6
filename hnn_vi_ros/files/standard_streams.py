# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Standard output and error that are closed, full, or pipes that nobody reads any more."""

from collections.abc import Iterator
from contextlib import contextmanager
import io
import os
import shutil
import signal
import sys
import threading
import time
from typing import Any, TextIO

from hnn_vi_ros.errors import printable

# Signals that end a process in good order; the last one arrives when its terminal closes.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# How often a line of progress is written on a terminal, and elsewhere [s].
_TERMINAL, _ELSEWHERE, _BAR = 0.2, 10.0, 24


class _Lossy(io.FileIO):
    """
    A file whose writes never fail: what it cannot take is lost, and why is remembered.

    A recording, a training or a study is not to end because its lines cannot be shown.

    Attributes
    ----------
    problem : OSError or None
        Why something was lost.
    matters : bool
        Whether what is printed is what the process is for.

    """

    problem: OSError | None = None
    matters = True

    def write(self, data: Any) -> int:
        """Write, as long as that works."""
        if self.problem is None:
            try:
                return super().write(data)
            except OSError as problem:
                self.problem = problem
        return len(data)


class _Plain(io.TextIOWrapper):
    """Text stream that shows control characters: what is printed may hold texts of others."""

    keep = '\n\t'

    def write(self, text: str) -> int:
        """Write a text of any origin."""
        super().write(printable(text, self.keep))
        return len(text)

    def write_emphasised(self, begin: str, *rest: str) -> None:
        """Write a line whose beginning is bold and red."""
        super().write(f'\x1b[1;31m{printable(begin)}\x1b[0m{printable("".join(rest))}\n')

    def rewrite(self, text: str) -> None:
        """Write a text in place of the line in which the cursor of a terminal is."""
        super().write(f'\r\x1b[K{printable(text)}')


def write_problem(line: str) -> None:
    """Write a line on what is wrong to standard error; on a terminal its command in red."""
    stream = sys.stderr
    if isinstance(stream, _Plain) and stream.isatty() and not os.environ.get('NO_COLOR') and \
            os.environ.get('TERM') != 'dumb':
        stream.write_emphasised(*line.partition(':'))
    else:
        print(line, file=stream)


def rewrite_line(stream: TextIO, text: str) -> None:
    """Show a text in place of the last line of a terminal."""
    if isinstance(stream, _Plain):
        stream.rewrite(text)
    else:
        stream.write(f'\r\x1b[K{printable(text)}')
    stream.flush()


def guard_streams() -> None:
    """
    Let no write to standard output or error raise, and no terminal obey what is printed.

    See ``lost_output``; how far a training or a study is shows by carriage returns on standard
    error.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # Else the next file that is opened, such as a bag, would be what is printed to. Opened
            # so that writing fails, as with a closed stream.
            os.open(os.devnull, os.O_WRONLY if number == 0 else os.O_RDONLY)
    out, error = _guarded(1, sys.stdout), _guarded(2, sys.stderr)
    error.keep += '\r'
    sys.stdout, sys.stderr = out, error


def spare_output() -> None:
    """Note that the process is for messages or files, whatever becomes of its output."""
    if isinstance(raw := getattr(getattr(sys.stdout, 'buffer', None), 'raw', None), _Lossy):
        raw.matters = False


def lost_output() -> tuple[OSError | None, bool]:
    """Return why something that was printed has not arrived, None if all has; if it matters."""
    sys.stdout.flush()
    buffer: Any = sys.stdout.buffer
    return buffer.raw.problem, buffer.raw.matters


class ProgressLine:
    """Line on standard error, rewritten in place on a terminal; elsewhere one every 10 s."""

    def __init__(self) -> None:
        self._terminal, self._shown = sys.stderr.isatty(), False
        self._interval = _TERMINAL if self._terminal else _ELSEWHERE
        self._next = time.monotonic() + self._interval

    def show(self, share: float, what: str) -> None:
        """Show how much is done, from 0 to 1, and what is being done, if it is time to."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._interval
        done = round(_BAR * share)
        bar = f'[{"#" * done}{"." * (_BAR - done)}] ' if self._terminal else ''
        _show_progress(f'{bar}{share:4.0%}  {what}')
        self._shown = self._terminal

    def close(self) -> None:
        """Clear the line: what is printed next takes its place."""
        if self._shown:
            rewrite_line(sys.stderr, '')


@contextmanager
def elapsed(what: str) -> Iterator[None]:
    """Write on standard error, every 10 s and on a terminal in one line, how long work takes."""
    begin, done, terminal = time.monotonic(), threading.Event(), sys.stderr.isatty()

    def show() -> None:
        while not done.wait(1.0 if terminal else _ELSEWHERE):
            _show_progress(f'{what}, {time.monotonic() - begin:.0f} s so far')

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        if terminal:
            rewrite_line(sys.stderr, '')


def _show_progress(text: str) -> None:
    """Write a line on standard error, on a terminal in place of the one before."""
    if sys.stderr.isatty():
        # A line that is wrapped would not be cleared as a whole.
        rewrite_line(sys.stderr, text[:shutil.get_terminal_size().columns - 1])
    else:
        print(text, file=sys.stderr, flush=True)


def _guarded(number: int, stream: TextIO | None) -> _Plain:
    """Return a text stream like the one that Python has made, if it has made one."""
    terminal = os.isatty(number)
    return _Plain(
        io.BufferedWriter(_Lossy(number, 'w', closefd=False)),
        encoding=stream.encoding if stream else 'utf-8',
        # A letter that a terminal cannot show, or a name that is no text, is to end nothing.
        errors='backslashreplace',
        line_buffering=terminal or number == 2,
        write_through=isinstance(stream, io.TextIOWrapper) and stream.write_through)
