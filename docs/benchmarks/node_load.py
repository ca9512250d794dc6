# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rows 9: load of the simulator at 1 kHz, compared with a bare node with the same messages.

If there are two processors, each process gets its own. Otherwise the listener is moved to
the processor that a node leaves when it sleeps, takes 0.1 ms more for a message there, and its
lateness counts as the node's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
import sys
import time

from benchmarks import bare_node
from benchmarks.measurement import compare, Row, Settings
from benchmarks.processes import heard, simulator
import numpy as np
from std_msgs.msg import Float64

# Wall time before and while a process is looked at [s].
_SETTLED, _WATCHED, _QUICK = 2.0, 8.0, 2.0
_FEW = 5
_COMMON = {'scene': 'harmonic_oscillator', 'publish_rate': 1000.0, 'step_size': 0.001}


def rows(settings: Settings) -> Iterator[Row]:
    """Measure processor time and the period of the messages."""
    commands = {
        'off': simulator(**_COMMON, record='false', rerun_sink='none'),
        'bare': [sys.executable, bare_node.__file__],
        'on': simulator(**_COMMON),
    }
    turns = min(_FEW, settings.repetitions)
    seen = {name: np.empty((turns, 2)) for name in commands}
    for turn in range(turns):
        for name, command in commands.items():
            settings.say(f'turn {turn + 1} of {turns}: {name}')
            # Threads of the middleware stay where the one was that made them.
            with _apart() as processor:
                seen[name][turn] = _measure(
                    command, '/bare/energy' if name == 'bare' else '/hnn_simulator/energy',
                    _QUICK if settings.quick else _WATCHED, processor)
    off, bare, on = (seen[name].T for name in ('off', 'bare', 'on'))
    yield compare('simulator at 1 kHz: processor time', off[0], bare[0], target=1.5, unit='s/s',
                  peer_name='bare node')
    yield compare('simulator at 1 kHz: period error, 99th percentile', off[1], bare[1],
                  target=1.2, scale=1e6, peer_name='bare node')
    yield compare('recording and picture at 1 kHz: processor time', on[0], off[0], target=1.5,
                  unit='s/s', peer_name='without')


def _measure(command: list[str], topic: str, watched: float, processor: set[int]
             ) -> tuple[float, float]:
    """Return the processors that a process keeps busy [s/s], and the error of its period [s]."""
    with heard(command, Float64, topic, raw=True, processor=processor) as process:
        process.listen(_SETTLED)
        process.arrivals.clear()
        start, used = time.perf_counter(), process.processor_time
        process.listen(watched)
        busy = (process.processor_time - used) / (time.perf_counter() - start)
        errors = np.abs(np.diff(process.arrivals) - bare_node.PERIOD)
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
