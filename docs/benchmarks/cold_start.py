# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 5: from starting the simulator to its first message, over a bare rclpy publisher."""

from collections.abc import Iterator
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from benchmarks import bare_publisher
from benchmarks.measurement import Row, Settings
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64MultiArray

_TARGET = 2.5
_FEW = 3
_TOPICS = {'simulator': '/hnn_simulator/q', 'bare': '/bare'}
_PARAMETERS = ('scene:=harmonic_oscillator', 'rerun_sink:=none', 'record:=false')
_MISS = ("Numba compiles the method's loop and the Hamiltonian separately. Later starts load both "
         'from disk, and `make build` compiles all shipped scenes.')
# A user's simulator and publisher are not kept to one thread.
OURS_ALONE = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure with the compiled kernel found on disk, and compiled again."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    commands = {
        'simulator': [str(simulator()), '--ros-args', *[
            word for parameter in _PARAMETERS for word in ('-p', parameter)]],
        'bare': [sys.executable, bare_publisher.__file__],
    }
    with _Listener() as listener:
        for name, command in commands.items():
            listener.seconds(name, command)
        settings.say('compiled kernel on disk')
        warm = np.array([[listener.seconds(name, command) for name, command in commands.items()]
                         for _ in range(settings.repetitions)])
        yield _row('cold start, kernel on disk', warm, '')
        settings.say('kernel compiled again')
        cold = []
        for _ in range(min(_FEW, settings.repetitions)):
            with tempfile.TemporaryDirectory() as folder:
                cold.append([listener.seconds(name, command, NUMBA_CACHE_DIR=folder)
                             for name, command in commands.items()])
        yield _row('cold start, kernel compiled again', np.array(cold), _MISS)


def _row(name: str, seconds: np.ndarray, miss: str) -> Row:
    low, median, high = np.quantile(seconds[:, 0] - seconds[:, 1], [0.25, 0.5, 0.75])
    ours, bare = np.median(seconds, axis=0)
    return Row(f'{name}: seconds more', f'{ours:.2f} s', f'bare rclpy publisher {bare:.2f} s',
               float(median), (float(low), float(high)), _TARGET, len(seconds), unit='s more',
               miss=miss)


def simulator() -> Path:
    """Return the executable that was built."""
    path = Path('install/hnn_vi_ros/lib/hnn_vi_ros/simulator')
    if not path.is_file():
        raise SystemExit(f'error: there is no {path} here; run: make bench')
    return path.resolve()


class _Listener:
    """A node that starts publishers and waits for the first message of each."""

    def __enter__(self) -> '_Listener':
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node('bench_listener', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._heard: set[str] = set()
        for name, topic in _TOPICS.items():
            self._node.create_subscription(
                Float64MultiArray, topic, lambda message, name=name: self._heard.add(name), 10)
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def seconds(self, name: str, command: list[str], **environment: str) -> float:
        """Return the time from starting a command to its first message here [s]."""
        inherited = {key: value for key, value in os.environ.items() if key not in OURS_ALONE}
        start = time.perf_counter()
        process = subprocess.Popen(
            command, env={**inherited, **environment}, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)
        try:
            while name not in self._heard:
                if process.poll() is not None or time.perf_counter() - start > 120.0:
                    raise RuntimeError(f'no message from {" ".join(command)}')
                self._executor.spin_once(timeout_sec=0.1)
            return time.perf_counter() - start
        finally:
            process.terminate()
            process.wait()
            # What was still on its way is not the next one's first message.
            until = time.perf_counter() + 0.2
            while time.perf_counter() < until:
                self._executor.spin_once(timeout_sec=0.05)
            self._heard.clear()
