# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""When recorded messages are handed out: rate, pause, steps, rounds, and /clock."""

import threading
import time
from typing import NamedTuple

from hnn_vi_ros.ros.replay.player import Player, read_ahead
from hnn_vi_ros.ros.topics.messages import CLOCK_PERIOD
import numpy as np
from processes import wait_until
import pytest

MS = 1_000_000
# A busy machine may be late all the time, but not each time; a drift is.
ATTEMPTS = 5


class Message(NamedTuple):
    time: int
    data: bytes = b''


def play(times: list[int], last: int | None = None, clock: bool = False, **options: object
         ) -> tuple[Player, list[tuple[int, int]], list[int]]:
    """Return a player that was started, what it hands out with wall times, and /clock."""
    heard, told = [], []
    player = Player(
        lambda: read_ahead(iter([Message(stamp) for stamp in times])),
        lambda message: heard.append((message.time, time.monotonic_ns())),
        told.append if clock else None, times[0] if times else 0,
        (times[-1] if times else 0) if last is None else last, **options)
    player.start()
    return player, heard, told


@pytest.mark.parametrize('rate', [0.5, 1.0, 4.0])
def test_player_keeps_to_the_times_at_any_rate(rate):
    times = [i * 10 * MS for i in range(41)]
    for _ in range(ATTEMPTS):
        begin = time.monotonic_ns()
        player, heard, _ = play(times, rate=rate)
        player.join(60.0)
        stamps, walls = np.array(heard).T
        assert stamps.tolist() == times
        # Never early; how late depends on the machine, but it does not add up.
        assert (walls - begin >= stamps / rate).all()
        late = walls - walls[0] - stamps / rate
        if in_time := late[-20:].min() < 5 * MS:
            break
    assert in_time
    assert player.published == 41 and player.problem is None
    told = player.timing_errors()
    assert 0.0 <= told['median'] <= told['p99'] <= told['largest']


def test_player_goes_on_after_a_pause_where_it_was_without_a_burst():
    times = [i * 20 * MS for i in range(101)]
    player, heard, _ = play(times)
    wait_until(lambda: len(heard) > 3)
    player.set_paused(True)
    before = len(heard)
    assert before < 101
    time.sleep(0.4)
    # One may have been on its way, of 20 that would have come.
    assert len(heard) <= before + 1
    before = len(heard)
    resumed = time.monotonic_ns()
    player.set_paused(False)
    player.join(60.0)
    stamps, walls = np.array(heard).T
    assert stamps.tolist() == times
    # The rest took the rest of the time, up to one message of it.
    assert walls[-1] - resumed > (100 - before - 1) * 20 * MS


def test_step_hands_out_all_messages_of_one_time_and_only_while_paused():
    times = [i // 4 * 10 * MS for i in range(20)]
    player, heard, _ = play(times, paused=True)
    time.sleep(0.05)
    assert heard == []
    for step in range(3):
        assert player.step() == step * 10 * MS
        assert len(heard) == 4 * (step + 1)
    player.set_paused(False)
    assert player.step() is None
    player.join(60.0)
    assert [stamp for stamp, _ in heard] == times


def test_player_loops_without_drift_until_it_is_stopped():
    times = [i * 10 * MS for i in range(11)]
    for _ in range(ATTEMPTS):
        player, heard, _ = play(times, loop=True)
        wait_until(lambda heard=heard: len(heard) > 55)
        player.stop()
        assert not player.is_alive()
        assert [stamp for stamp, _ in heard[:55]] == times * 5
        firsts = np.array([wall for stamp, wall in heard if stamp == 0])[:6]
        # How late a round begins depends on the machine; a drift would add up.
        late = firsts - firsts[0] - 100 * MS * np.arange(firsts.size)
        if in_time := late[-3:].min() < 20 * MS:
            break
    assert in_time


def test_clock_is_told_each_10_ms_never_zero_never_twice():
    player, heard, told = play([0, 3 * MS, 4 * MS, 100 * MS], clock=True)
    player.join(60.0)
    assert told[0] > 0
    assert np.diff(told).min() > 0
    assert np.diff(told).max() <= CLOCK_PERIOD
    assert told[-1] == 100 * MS
    assert len(heard) == 4


def test_window_without_messages_takes_its_time():
    begin = time.monotonic()
    player, heard, _ = play([], last=100 * MS)
    player.join(60.0)
    assert heard == [] and time.monotonic() - begin >= 0.1


def test_player_waits_for_a_time_beyond_the_longest_timeout():
    player, heard, _ = play([0, 2**64 - 1])
    player.join(0.5)
    assert player.is_alive() and player.problem is None
    player.stop()
    player.join(60.0)
    assert not player.is_alive() and len(heard) <= 1


def test_error_of_the_reader_ends_the_player_and_is_kept():
    def read():
        yield Message(0)
        raise OSError('the disk is gone')

    heard = []
    player = Player(lambda: read_ahead(read()), heard.append, None, 0, 1)
    player.start()
    player.join(60.0)
    assert not player.is_alive()
    assert str(player.problem) == 'the disk is gone' and len(heard) == 1


def test_reading_ahead_is_bounded_and_ends_with_its_taker():
    read = []

    def endless():
        while True:
            read.append(0)
            yield Message(len(read), bytes(1000))

    before = threading.active_count()
    messages = read_ahead(endless())
    assert next(messages).time == 1
    time.sleep(0.1)
    assert len(read) < 20 * 270
    messages.close()
    deadline = time.monotonic() + 60.0
    while threading.active_count() > before:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_long_pause_is_told():
    """A bag whose end was recorded half an hour after its start."""
    told: list[str] = []
    player, _, _ = play([0, 1800 * 10**9], tell=told.append)
    wait_until(lambda: told)
    player.stop()
    assert told == ['no message in the bag for 1800 s: waiting 1800 s; set start_offset to begin '
                    'after it']
