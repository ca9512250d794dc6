# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Processes measured from outside: start, subscribe, interrupt at the end."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import tempfile
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

# A user's simulator and publisher are not kept to one thread, as we and the peers are.
OURS_ALONE = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
_TICKS = os.sysconf('SC_CLK_TCK')
# Time until the first message [s]: the simulator may compile before it.
_LIMIT = 180.0


def simulator(**parameters: object) -> list[str]:
    """Return the command of the simulator that was built."""
    path = Path('install/hnn_vi_ros/lib/hnn_vi_ros/simulator')
    if not path.is_file():
        raise SystemExit(f'error: there is no {path} here; run: make bench')
    return [str(path.resolve()), *given(**parameters)]


def given(**parameters: object) -> list[str]:
    """Return parameters as arguments of a node."""
    return ['--ros-args', *(
        word for name, value in parameters.items() for word in ('-p', f'{name}:={value}'))]


@contextmanager
def own_node(name: str) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Make a node in a context of its own, and its executor."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node(name, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@contextmanager
def running(command: list[str], folder: str | Path, output: Any = subprocess.DEVNULL,
            environment: Mapping[str, str] | None = None) -> Iterator[subprocess.Popen]:
    """Run a command as a user does, in a folder; interrupt it at the end."""
    inherited = {key: value for key, value in os.environ.items() if key not in OURS_ALONE}
    process = subprocess.Popen(command, cwd=folder, env=inherited | dict(environment or {}),
                               stdout=output, stderr=output)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


class Heard:
    """
    A process and its received messages.

    Attributes
    ----------
    process : subprocess.Popen
        As it was started, at ``start`` on the clock of ``time.perf_counter`` [s].
    arrivals : list of float
        When its messages came, by the same clock.
    newest : object
        The last of them.

    """

    def __init__(self, node: Node, executor: SingleThreadedExecutor, kind: type, topic: str,
                 depth: int, raw: bool):
        self.node, self.executor = node, executor
        self.arrivals: list[float] = []
        self.newest: Any = None
        node.create_subscription(kind, topic, self._hear, depth, raw=raw)

    def begin(self, process: subprocess.Popen, start: float) -> None:
        """Wait for the first message."""
        self.process, self.start = process, start
        while not self.arrivals:
            if time.perf_counter() - start > _LIMIT:
                raise RuntimeError(f'no message from {process.args}')
            self._spin()

    def listen(self, seconds: float) -> None:
        """Listen so long."""
        deadline = time.perf_counter() + seconds
        while time.perf_counter() < deadline:
            self._spin()

    @property
    def processor_time(self) -> float:
        """Return the processor time that the process has used so far [s]."""
        fields = Path(f'/proc/{self.process.pid}/stat').read_text().rpartition(')')[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def _hear(self, message: Any) -> None:
        self.arrivals.append(time.perf_counter())
        self.newest = message

    def _spin(self) -> None:
        if self.process.poll() is not None:
            raise RuntimeError(f'{self.process.args} ended')
        self.executor.spin_once(timeout_sec=0.1)


@contextmanager
def heard(command: list[str], kind: type, topic: str, *, depth: int = 1000, raw: bool = False,
          processor: set[int] | None = None, **environment: str) -> Iterator[Heard]:
    """Start a command in a temporary folder, on some processors; wait for its first message."""
    with own_node('bench_listener') as (node, executor), tempfile.TemporaryDirectory() as folder:
        hearing = Heard(node, executor, kind, topic, depth, raw)
        start = time.perf_counter()
        with running(command, folder, environment=environment) as process:
            if processor is not None:
                os.sched_setaffinity(process.pid, processor)
            hearing.begin(process, start)
            yield hearing
