# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How fast the simulator runs an arm where nothing slows it, over real time."""

import os
import subprocess
import tempfile
import time

from benchmarks.cold_start import OURS_ALONE, simulator
from benchmarks.measurement import Row, Settings
from benchmarks.node_load import processor_time
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

_SCENE, _STEP, _RATE = 'seven_joint_arm', 0.001, 100.0
# Simulated seconds per wall second that are wanted.
_FACTOR = 20.0
# Wall time before and of each turn [s], and how long the node may take to begin.
_SETTLED, _WATCHED, _QUICK, _LIMIT = 3.0, 3.0, 1.0, 180.0
_TURNS = 7


def real_time_row(settings: Settings) -> Row:
    """Measure the wall time of a simulated second, by the stamps of joint_states."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    parameters = {'scene': _SCENE, 'step_size': _STEP, 'publish_rate': _RATE,
                  'real_time_factor': 0.0, 'record': 'false', 'rerun_sink': 'none'}
    command = [str(simulator()), '--ros-args', *[
        word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')]]
    costs, busy = _costs(command, _QUICK if settings.quick else _WATCHED,
                         min(_TURNS, settings.repetitions))
    low, median, high = np.quantile(costs, [0.25, 0.5, 0.75])
    return Row(
        f'{_SCENE} in the node at h = {_STEP:g} s: wall time of a simulated second',
        f'{1e3 * median:.3g} ms', 'real time 1000 ms', float(median), (float(low), float(high)),
        1.0 / _FACTOR, len(costs),
        note=f'a real-time factor of {1.0 / median:.3g}: the simulator with real_time_factor 0, '
             f'its own method, {_RATE:g} samples a simulated second on all of its topics, one '
             'subscriber of joint_states, no bag and no picture; the node had a processor for '
             f'{1e3 * np.median(busy):.3g} ms of them, all that it takes on a machine that does '
             'nothing else',
        miss=f'the goal is a real-time factor of {_FACTOR:g}.')


def _costs(command: list[str], watched: float, turns: int) -> np.ndarray:
    """Return wall and processor time of a simulated second [s/s], shape (2, turns)."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('bench_listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    newest: list[tuple[float, float]] = []

    def hear(message: JointState) -> None:
        stamp = message.header.stamp
        newest[:] = [(time.perf_counter(), stamp.sec + 1e-9 * stamp.nanosec)]

    node.create_subscription(JointState, '/joint_states', hear, 1)
    environment = {key: value for key, value in os.environ.items() if key not in OURS_ALONE}
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(command, cwd=folder, env=environment,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        def listen(seconds: float) -> tuple[float, float, float]:
            deadline = time.perf_counter() + seconds
            while time.perf_counter() < deadline:
                if process.poll() is not None:
                    raise RuntimeError(f'{" ".join(command)} ended')
                executor.spin_once(timeout_sec=0.1)
            wall, simulated = newest[-1]
            return wall, processor_time(process.pid), simulated

        try:
            deadline = time.perf_counter() + _LIMIT
            while not newest:
                if process.poll() is not None or time.perf_counter() > deadline:
                    raise RuntimeError(f'no message from {" ".join(command)}')
                executor.spin_once(timeout_sec=0.1)
            seen = [listen(_SETTLED), *(listen(watched) for _ in range(turns))]
        finally:
            process.terminate()
            process.wait()
            node.destroy_node()
            rclpy.try_shutdown(context=context)
    wall, processor, simulated = np.diff(np.array(seen), axis=0).T
    return np.array([wall, processor]) / simulated
