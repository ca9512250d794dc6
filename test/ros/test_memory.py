# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Resets and recordings, however many, leave neither threads nor memory behind."""

from collections.abc import Callable
import os
from pathlib import Path
import statistics
import time

from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build
from peer import Peer, simulating, stamp
import pytest

# Allocators settle in the first ones. A leak that was found left 2.1 MB each; what comes and goes
# are some 2 MB, on a busy machine 6 [MB].
WARM, NOISE = 20, 12.0
COUNTS = pytest.mark.parametrize('count', [20, pytest.param(120, marks=pytest.mark.long)])


def threads(pid: int) -> int:
    return len(os.listdir(f'/proc/{pid}/task'))


def resident(pid: int, moments: int = 5) -> float:
    """Return the memory that a process holds [MB], the median of a few moments."""
    pages = []
    for _ in range(moments):
        pages.append(int(Path(f'/proc/{pid}/statm').read_text().split()[1]))
        time.sleep(0.05)
    return statistics.median(pages) * os.sysconf('SC_PAGE_SIZE') / 1e6


def assert_nothing_is_left(folder: Path, measured: Callable, name: str, count: int,
                           act: Callable[[Peer], None]) -> None:
    # A node that finds its rescue compiled compiles nothing beside the run, which takes memory.
    build(load_scene('exact_harmonic_oscillator')).compile_rescue()
    with simulating(folder, record='true', rerun_sink='file') as (other, process):
        # A thread takes the run again from its 512th step on.
        other.spin_until(lambda: other.states and stamp(other.states[-1]) > 5.5e9)
        for _ in range(WARM):
            act(other)
        before = threads(process.pid), resident(process.pid)
        for _ in range(count):
            act(other)
        after = threads(process.pid), resident(process.pid)
    growth = (after[1] - before[1]) / count
    measured('what one leaves behind: memory [MB]', name, growth, f'{NOISE / count:g}')
    assert after[0] == before[0]
    assert growth < NOISE / count


@COUNTS
def test_resets_leave_neither_threads_nor_memory_behind(tmp_path, measured, count):
    def reset(other: Peer) -> None:
        assert other.trigger('reset').success

    assert_nothing_is_left(tmp_path, measured, 'reset', count, reset)
    assert len(list(tmp_path.glob('runs/*/*.rrd'))) == 1 + WARM + count


@COUNTS
def test_recordings_leave_neither_threads_nor_memory_behind(tmp_path, measured, count):
    def record(other: Peer) -> None:
        assert other.trigger('stop_recording').success
        assert other.trigger('start_recording').success

    assert_nothing_is_left(tmp_path, measured, 'recording', count, record)
    assert len(list(tmp_path.glob('runs/*/bag*'))) == 1 + WARM + count
