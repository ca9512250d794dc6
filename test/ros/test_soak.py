# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An hour of simulated time: memory, samples and repeatability."""

from pathlib import Path
import time

from bag_content import content_of
import numpy as np
from processes import finish, start
import pytest
import test_memory

pytestmark = pytest.mark.long
HOUR, STEP, RATE = 3600, 0.001, 10
SAMPLES = HOUR * RATE
# The process is warm once this share of the samples is in the bag, and completes it from there on.
WARM, COMPLETE = 1.0 / 3.0, 0.97
TOPICS = ['/hnn_simulator/energy', '/hnn_simulator/p', '/hnn_simulator/q',
          '/hnn_simulator/state', '/joint_states']


def resident(pid: int) -> float:
    """Return the memory that a process holds [MB]; 0 once it has ended."""
    try:
        return test_memory.resident(pid, 1)
    except (OSError, IndexError):
        return 0.0


def size_of_log(folder: Path) -> int:
    """Return how many bytes the bag has so far; it is flushed once a second."""
    return sum(path.stat().st_size for path in folder.glob('runs/*/bag/*.mcap'))


@pytest.fixture(scope='module')
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, list[tuple[int, float]]]]:
    """Run an hour twice, side by side; return each folder and its (log size, memory) over time."""
    folders = [tmp_path_factory.mktemp('soak') for _ in range(2)]
    processes = [start(folder, scene='pendulum', step_size=STEP, publish_rate=RATE,
                       duration=HOUR, real_time_factor=0, record='true', rerun_sink='file')
                 for folder in folders]
    seen: list[list[tuple[int, float]]] = [[], []]
    try:
        while any(process.poll() is None for process in processes):
            for process, folder, rows in zip(processes, folders, seen, strict=True):
                rows.append((size_of_log(folder), resident(process.pid)))
            time.sleep(0.1)
        for process in processes:
            assert finish(process)[0] == 0
    finally:
        for process in processes:
            process.kill()
    return list(zip(folders, seen, strict=True))


def recorded(folder: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return the log time and the bytes of each message of the topics of every tick."""
    (bag,) = folder.glob('runs/*/bag')
    found: dict[str, list] = {topic: [] for topic in TOPICS}
    for topic, stamp, data in content_of(bag):
        if topic in TOPICS:
            found[topic].append((stamp, data))
    return found


def test_hour_of_the_node_takes_no_more_memory_as_it_goes(runs, measured):
    """Less than 5 MB more than when it was warm, with the bag and the picture being written."""
    for number, (folder, seen) in enumerate(runs, start=1):
        whole = size_of_log(folder)
        # Completing the files takes 8 MB for a moment, at the end.
        warm = [memory for size, memory in seen
                if WARM * whole < size < COMPLETE * whole and memory > 0.0]
        assert len(warm) >= 20
        # Medians: buffers come and go.
        tenth = len(warm) // 10
        growth = float(np.median(warm[-tenth:]) - np.median(warm[:tenth]))
        measured('memory is flat over an hour of simulated time: growth [MB]',
                 f'pendulum, run {number}', growth, '5')
        assert growth < 5.0
        assert list(folder.glob('runs/*/recording.rrd'))


def test_hour_of_the_node_loses_no_sample_and_repeats_bit_by_bit(runs):
    first, second = (recorded(folder) for folder, _ in runs)
    due = [round(1e9 / RATE) * tick for tick in range(1, SAMPLES + 1)]
    for topic in TOPICS:
        assert [stamp for stamp, _ in first[topic]] == due
        assert first[topic] == second[topic]
