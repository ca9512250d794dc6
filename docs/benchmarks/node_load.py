# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rows 9: what the simulator's process costs at 1 kHz, over a bare node of the same messages.

Each process has a processor of its own where there are two. Without that the listener is moved to
the processor that a node leaves when it sleeps, takes 0.1 ms more for a message there, and its
lateness counts as the node's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from benchmarks import bare_node
from benchmarks.cold_start import OURS_ALONE, simulator
from benchmarks.measurement import Row, Settings
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64

# Wall time before and while a process is looked at [s].
_SETTLED, _WATCHED, _QUICK = 2.0, 8.0, 2.0
_FEW = 5
_TICKS = os.sysconf('SC_CLK_TCK')
_COMMON = ('scene:=harmonic_oscillator', 'publish_rate:=1000.0', 'step_size:=0.001')
_OFF = ('record:=false', 'rerun_sink:=none')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure processor time and the period of the messages."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    commands = {
        'off': [str(simulator()), *_parameters(*_COMMON, *_OFF)],
        'bare': [sys.executable, bare_node.__file__],
        'on': [str(simulator()), *_parameters(*_COMMON)],
    }
    turns = min(_FEW, settings.repetitions)
    seen = {name: np.empty((turns, 2)) for name in commands}
    for turn in range(turns):
        for name, command in commands.items():
            settings.say(f'turn {turn + 1} of {turns}: {name}')
            watched = _QUICK if settings.quick else _WATCHED
            # Threads of the middleware stay where the one was that made them.
            with _apart() as processor:
                seen[name][turn] = _measure(name, command, watched, processor)
    yield _row('simulator at 1 kHz: processor time', 'bare node', seen['off'][:, 0],
               seen['bare'][:, 0], 1.5, 's/s')
    yield _row('simulator at 1 kHz: period error, 99th percentile', 'bare node',
               1e6 * seen['off'][:, 1], 1e6 * seen['bare'][:, 1], 1.2, 'us')
    yield _row('recording and picture at 1 kHz: processor time', 'without', seen['on'][:, 0],
               seen['off'][:, 0], 1.5, 's/s')


def _row(name: str, peer: str, ours: np.ndarray, theirs: np.ndarray, target: float, unit: str
         ) -> Row:
    low, median, high = np.quantile(ours / theirs, [0.25, 0.5, 0.75])
    return Row(name, f'{np.median(ours):.3g} {unit}', f'{peer} {np.median(theirs):.3g} {unit}',
               float(median), (float(low), float(high)), target, ours.size)


def _parameters(*parameters: str) -> list[str]:
    return ['--ros-args', *[word for parameter in parameters for word in ('-p', parameter)]]


def _measure(name: str, command: list[str], watched: float, processor: set[int]
             ) -> tuple[float, float]:
    """Return the processors that a process keeps busy [s/s], and the error of its period [s]."""
    topic = '/bare/energy' if name == 'bare' else '/hnn_simulator/energy'
    heard: list[float] = []
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('bench_listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    # Raw: what arrives is not looked at.
    node.create_subscription(
        Float64, topic, lambda _: heard.append(time.perf_counter()), 1000, raw=True)
    environment = {key: value for key, value in os.environ.items() if key not in OURS_ALONE}
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(command, cwd=folder, env=environment,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.sched_setaffinity(process.pid, processor)
        try:
            _spin(executor, process, lambda: bool(heard), 120.0)
            _spin_for(executor, _SETTLED)
            heard.clear()
            start, used = time.perf_counter(), processor_time(process.pid)
            _spin_for(executor, watched)
            busy = (processor_time(process.pid) - used) / (time.perf_counter() - start)
        finally:
            process.terminate()
            process.wait()
            node.destroy_node()
            rclpy.try_shutdown(context=context)
    errors = np.abs(np.diff(heard) - bare_node.PERIOD)
    return busy, float(np.quantile(errors, 0.99))


@contextmanager
def _apart() -> Iterator[set[int]]:
    """Keep to one processor, and give the one that another process is to keep to."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield {min(allowed)}
    finally:
        os.sched_setaffinity(0, allowed)


def _spin(executor: SingleThreadedExecutor, process: subprocess.Popen, done, limit: float
          ) -> None:
    deadline = time.perf_counter() + limit
    while not done():
        if process.poll() is not None or time.perf_counter() > deadline:
            raise RuntimeError(f'no message from {" ".join(map(str, process.args))}')
        executor.spin_once(timeout_sec=0.1)


def _spin_for(executor: SingleThreadedExecutor, seconds: float) -> None:
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        executor.spin_once(timeout_sec=0.1)


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used so far [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS
