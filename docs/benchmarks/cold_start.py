# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 5: time from start to first message, compared with a bare rclpy publisher."""

from collections.abc import Iterator
import sys
import tempfile

from benchmarks import bare_publisher
from benchmarks.measurement import Row, Settings, summarise
from benchmarks.processes import heard, simulator
import numpy as np
from std_msgs.msg import Float64MultiArray

_TARGET = 2.5
_FEW = 3
_MISS = ("Numba compiles the method's loop and the Hamiltonian separately. Later starts load both "
         'from disk, and `make build` compiles all shipped scenes.')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure with the compiled kernel found on disk, and compiled again."""
    _starts()
    settings.say('compiled kernel on disk')
    yield _row('cold start, kernel on disk', [_starts() for _ in range(settings.repetitions)], '')
    settings.say('kernel compiled again')
    cold = []
    for _ in range(min(_FEW, settings.repetitions)):
        with tempfile.TemporaryDirectory() as folder:
            cold.append(_starts(NUMBA_CACHE_DIR=folder))
    yield _row('cold start, kernel compiled again', cold, _MISS)


def _starts(**environment: str) -> list[float]:
    """Return the time to the first message of the simulator, and of a bare publisher [s]."""
    times = []
    for command, topic in (
            (simulator(scene='harmonic_oscillator', rerun_sink='none', record='false'),
             '/hnn_simulator/q'),
            ([sys.executable, bare_publisher.__file__], '/bare')):
        with heard(command, Float64MultiArray, topic, **environment) as process:
            times.append(process.arrivals[0] - process.start)
    return times


def _row(name: str, seconds: list[list[float]], miss: str) -> Row:
    ours, bare = np.array(seconds).T
    return summarise(f'{name}: additional time', f'{np.median(ours):.2f} s',
                     f'bare rclpy publisher {np.median(bare):.2f} s', ours - bare, _TARGET,
                     unit='s more', miss=miss)
