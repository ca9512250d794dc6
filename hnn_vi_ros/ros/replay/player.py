# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Playback of recorded messages at their times, against a steady clock."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
import threading
import time

from hnn_vi_ros.recording import RecordedMessage
from hnn_vi_ros.ros.topics.messages import CLOCK_PERIOD
import numpy as np

# Read ahead: number of batches, and the largest number of messages and of bytes in a batch.
_MAX_BATCHES, _MAX_BATCH_MESSAGES, _MAX_BATCH_BYTES = 16, 256, 2**18
# Number of timing errors kept for the statistics.
_MAX_TIMING_ERRORS = 1_000_000
# A longer wall time between two messages looks like a hang and is reported [s].
_MAX_SILENCE = 5.0
# Timeout of a step [s].
_STEP_TIMEOUT = 5.0


def read_ahead(messages: Iterator[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Return an iterator over the same items, which a thread reads in advance from now on."""
    reader = ThreadPoolExecutor(1, 'read ahead')
    batches = deque(reader.submit(_batch, messages) for _ in range(_MAX_BATCHES))

    def take() -> Iterator[RecordedMessage]:
        try:
            while True:
                batch, problem = batches.popleft().result()
                yield from batch
                if problem is not None:
                    raise problem
                if not batch:
                    return
                batches.append(reader.submit(_batch, messages))
        finally:
            reader.shutdown(wait=False, cancel_futures=True)
    return take()


def _batch(messages: Iterator[RecordedMessage]) -> tuple[list[RecordedMessage], Exception | None]:
    """Return the next messages, [] at the end, and the exception that ended reading, if any."""
    batch: list[RecordedMessage] = []
    size = 0
    try:
        for message in messages:
            batch.append(message)
            size += len(message.data)
            if len(batch) == _MAX_BATCH_MESSAGES or size > _MAX_BATCH_BYTES:
                break
    except Exception as problem:
        return batch, problem
    return batch, None


class Player(threading.Thread):
    """
    Thread that publishes messages when they are due.

    Deadlines are measured from the start, so that timing errors do not accumulate.

    Parameters
    ----------
    read : callable
        Returns the messages from the start on, in the order of their times.
    publish : callable
        Publishes a message.
    tell_time : callable or None
        Publishes the bag's time [ns] on /clock, for every 10 ms of it.
    first, last : int
        Times at which playback begins and ends [ns].
    rate : float
        Seconds of the bag per second of wall time.
    loop : bool
        True to begin again at the end.
    paused : bool
        True to begin paused.
    tell : callable or None
        Logs a line about a long pause that is waited for.

    Attributes
    ----------
    published : int
        Number of messages published so far.
    problem : BaseException or None
        Exception that ended the playback early.

    """

    def __init__(self, read: Callable[[], Iterator[RecordedMessage]],
                 publish: Callable[[RecordedMessage], None],
                 tell_time: Callable[[int], None] | None, first: int, last: int,
                 rate: float = 1.0, loop: bool = False, paused: bool = False,
                 tell: Callable[[str], None] | None = None):
        super().__init__(name='player', daemon=True)
        self._read, self._publish, self._tell_time = read, publish, tell_time
        self._first, self._last, self._rate, self._loop = first, last, rate, loop
        self._tell = tell
        self._changed = threading.Condition()
        self._paused, self._stopped, self._stepping = paused, False, False
        # Time of the bag, and the time of the steady clock at which it was reached [ns].
        self._position, self._since = first, time.monotonic_ns()
        self._clock_due = 0
        self._errors: deque[int] = deque(maxlen=_MAX_TIMING_ERRORS)
        self.published = 0
        self.problem: Exception | None = None

    def run(self) -> None:
        """Play until the end, or until it is stopped."""
        try:
            messages = self._read()
            # Start the clock after the first message has been read.
            upcoming: Iterator[RecordedMessage] = chain(list(islice(messages, 1)), messages)
            self._since = time.monotonic_ns()
            while True:
                # The messages of the next round are read while this one is played.
                messages, upcoming = upcoming, self._read() if self._loop else iter(())
                if not self._play(messages) or not self._loop:
                    return
                with self._changed:
                    # The next round starts at the deadline of this one, so that nothing drifts.
                    self._since = self._deadline(self._last) if not self._paused \
                        else time.monotonic_ns()
                    self._position = self._first
        except Exception as problem:
            self.problem = problem

    def stop(self) -> None:
        """Stop publishing, and wait for the thread to end."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self.join()

    def set_paused(self, paused: bool) -> None:
        """Pause, or resume from where it was paused."""
        with self._changed:
            now = time.monotonic_ns()
            if paused and not self._paused:
                self._position = min(self._time(now), self._last)
            if self._paused != paused:
                self._since = now
            self._paused = paused
            self._changed.notify_all()

    def step(self) -> int | None:
        """Publish all messages of the next time and return that time; None if it is not paused."""
        with self._changed:
            if not self._paused or self._stopped or not self.is_alive():
                return None
            self._stepping = True
            self._changed.notify_all()
            done = self._changed.wait_for(
                lambda: not self._stepping or self._stopped, _STEP_TIMEOUT)
            return self._position if done else None

    def timing_errors(self) -> dict[str, float]:
        """Return the lateness of the messages [ms]: median, p99 and largest; empty without any."""
        if not self._errors:
            return {}
        errors = np.array(self._errors) * 1e-6
        return {'median': float(np.median(errors)), 'p99': float(np.quantile(errors, 0.99)),
                'largest': float(errors.max())}

    def _time(self, now: int) -> int:
        return self._position + round((now - self._since) * self._rate)

    def _deadline(self, stamp: int) -> int:
        return self._since + round((stamp - self._position) / self._rate)

    def _play(self, messages: Iterator[RecordedMessage]) -> bool:
        """Play one round from start to end; return False if it was stopped."""
        self._clock_due = max(self._first, 1)
        step, before = None, self._first
        for message in messages:
            # A step publishes all messages with the same time.
            if step != message.time:
                if step is not None:
                    self._end_step(step)
                step = None
                self._tell_pause((message.time - before) * 1e-9)
                before = message.time
                if not self._wait(message.time):
                    return False
                if self._stepping:
                    step = message.time
            if step is None:
                with self._changed:
                    self._errors.append(time.monotonic_ns() - self._deadline(message.time))
            self._publish(message)
            self.published += 1
        if step is not None:
            self._end_step(step)
        going = self._wait(self._last)
        if self._stepping:
            self._end_step(self._last)
        return going

    def _tell_pause(self, pause: float) -> None:
        """Report a long pause between two messages [s]."""
        if pause / self._rate > _MAX_SILENCE and self._tell is not None:
            self._tell(f'no message in the bag for {pause:.6g} s: waiting '
                       f'{pause / self._rate:.6g} s; set start_offset to begin after it')

    def _end_step(self, stamp: int) -> None:
        self._show_clock(stamp)
        with self._changed:
            self._position, self._stepping = stamp, False
            self._changed.notify_all()

    def _wait(self, stamp: int) -> bool:
        """Wait until a time of the bag is due or a step is requested; return False if stopped."""
        while True:
            with self._changed:
                if self._stopped:
                    return False
                if self._paused:
                    if self._stepping:
                        return True
                    self._changed.wait()
                    continue
                due = stamp if self._tell_time is None else min(stamp, self._clock_due)
                remaining = self._deadline(due) - time.monotonic_ns()
                if remaining > 0:
                    self._changed.wait(min(remaining * 1e-9, threading.TIMEOUT_MAX))
                    continue
            self._show_clock(due)
            if due == stamp:
                return True

    def _show_clock(self, stamp: int) -> None:
        """Publish the bag's time, at most once for each 10 ms of it."""
        if self._tell_time is not None and stamp >= self._clock_due:
            self._tell_time(stamp)
            self._clock_due = (stamp // CLOCK_PERIOD + 1) * CLOCK_PERIOD
