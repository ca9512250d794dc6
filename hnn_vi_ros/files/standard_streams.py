# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Handle standard output and error that are closed, full, or pipes without a reader."""

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

# Signals that end a process cleanly; SIGHUP arrives when its terminal closes.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Interval of progress lines on a terminal and elsewhere [s], and width of the bar.
_TERMINAL_INTERVAL, _LOG_INTERVAL, _BAR_WIDTH = 0.2, 10.0, 24


class _Lossy(io.FileIO):
    """
    A file whose writes never fail: data may be lost, and the first error is stored.

    A recording, a training or a study must not fail because its output cannot be shown.

    Attributes
    ----------
    problem : OSError or None
        Error that caused the loss of data.
    matters : bool
        True if the output is the purpose of the process.

    """

    problem: OSError | None = None
    matters = True

    def write(self, data: Any) -> int:
        """Write until the first error; discard data after it."""
        if self.problem is None:
            try:
                return super().write(data)
            except OSError as problem:
                self.problem = problem
        return len(data)


class _Plain(io.TextIOWrapper):
    """Text stream that escapes control characters, since printed text may be untrusted."""

    keep = '\n\t'

    def write(self, text: str) -> int:
        """Write a text with control characters escaped."""
        super().write(printable(text, self.keep))
        return len(text)

    def write_emphasised(self, begin: str, *rest: str) -> None:
        """Write a line that starts in bold red."""
        super().write(f'\x1b[1;31m{printable(begin)}\x1b[0m{printable("".join(rest))}\n')

    def rewrite(self, text: str) -> None:
        """Replace the current line of a terminal."""
        super().write(f'\r\x1b[K{printable(text)}')


def write_problem(line: str) -> None:
    """Write an error line to standard error; on a terminal with the command in red."""
    stream = sys.stderr
    if isinstance(stream, _Plain) and stream.isatty() and not os.environ.get('NO_COLOR') and \
            os.environ.get('TERM') != 'dumb':
        stream.write_emphasised(*line.partition(':'))
    else:
        print(line, file=stream)


def rewrite_line(stream: TextIO, text: str) -> None:
    """Replace the last line of a terminal."""
    if isinstance(stream, _Plain):
        stream.rewrite(text)
    else:
        stream.write(f'\r\x1b[K{printable(text)}')
    stream.flush()


def harden_streams() -> None:
    """
    Make writes to standard output and error never raise, and escape control characters.

    See ``lost_output``. Only progress lines on standard error may use carriage returns.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # Otherwise the next opened file, such as a bag, would receive the output. This file is
            # opened such that writing fails, as with a closed stream.
            os.open(os.devnull, os.O_WRONLY if number == 0 else os.O_RDONLY)
    out, error = _hardened_stream(1, sys.stdout), _hardened_stream(2, sys.stderr)
    error.keep += '\r'
    sys.stdout, sys.stderr = out, error


def spare_output() -> None:
    """Mark the output as dispensable, because the process produces messages or files."""
    if isinstance(raw := getattr(getattr(sys.stdout, 'buffer', None), 'raw', None), _Lossy):
        raw.matters = False


def lost_output() -> tuple[OSError | None, bool]:
    """Return the error that lost printed text, None if there is none; and whether it matters."""
    sys.stdout.flush()
    buffer: Any = sys.stdout.buffer
    return buffer.raw.problem, buffer.raw.matters


class ProgressLine:
    """Progress line on standard error: rewritten on a terminal; elsewhere a line every 10 s."""

    def __init__(self) -> None:
        self._terminal, self._shown = sys.stderr.isatty(), False
        self._interval = _TERMINAL_INTERVAL if self._terminal else _LOG_INTERVAL
        self._next = time.monotonic() + self._interval

    def show(self, share: float, what: str) -> None:
        """Show the progress from 0 to 1 and the current activity, if the interval has passed."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._interval
        done = round(_BAR_WIDTH * share)
        bar = f'[{"#" * done}{"." * (_BAR_WIDTH - done)}] ' if self._terminal else ''
        _show_progress(f'{bar}{share:4.0%}  {what}')
        self._shown = self._terminal

    def close(self) -> None:
        """Clear the line for further output."""
        if self._shown:
            rewrite_line(sys.stderr, '')


@contextmanager
def elapsed(what: str) -> Iterator[None]:
    """Report the elapsed time on standard error: in one line on a terminal, else every 10 s."""
    begin, done, terminal = time.monotonic(), threading.Event(), sys.stderr.isatty()

    def show() -> None:
        while not done.wait(1.0 if terminal else _LOG_INTERVAL):
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
    """Write a line on standard error; on a terminal it replaces the previous one."""
    if sys.stderr.isatty():
        # Truncate the line: a wrapped one could not be cleared completely.
        rewrite_line(sys.stderr, text[:shutil.get_terminal_size().columns - 1])
    else:
        print(text, file=sys.stderr, flush=True)


def _hardened_stream(number: int, stream: TextIO | None) -> _Plain:
    """Return a text stream with the settings of Python's own, if that exists."""
    terminal = os.isatty(number)
    return _Plain(
        io.BufferedWriter(_Lossy(number, 'w', closefd=False)),
        encoding=stream.encoding if stream else 'utf-8',
        # Unencodable characters and names must not raise an error.
        errors='backslashreplace',
        line_buffering=terminal or number == 2,
        write_through=isinstance(stream, io.TextIOWrapper) and stream.write_through)
