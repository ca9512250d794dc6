# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Real-time factor of the simulator for an arm, without pacing."""

from benchmarks.measurement import Row, Settings, summarise
from benchmarks.processes import heard, simulator
import numpy as np
from sensor_msgs.msg import JointState

_SCENE, _STEP, _RATE = 'seven_joint_arm', 0.001, 100.0
# Simulated seconds per wall second that are wanted.
_FACTOR = 20.0
# Wall time before and of each turn [s].
_SETTLED, _WATCHED, _QUICK = 3.0, 3.0, 1.0
_TURNS = 7


def real_time_row(settings: Settings) -> Row:
    """Measure the wall time per simulated second, by the stamps of joint_states."""
    command = simulator(scene=_SCENE, step_size=_STEP, publish_rate=_RATE, real_time_factor=0.0,
                        record='false', rerun_sink='none')
    watched = _QUICK if settings.quick else _WATCHED
    seen = []
    # Only the newest message in the queue shows the progress of the simulation.
    with heard(command, JointState, '/joint_states', depth=1) as process:
        for seconds in (_SETTLED, *[watched] * min(_TURNS, settings.repetitions)):
            process.listen(seconds)
            stamp = process.newest.header.stamp
            seen.append((process.arrivals[-1], process.processor_time,
                         stamp.sec + 1e-9 * stamp.nanosec))
    wall, processor, simulated = np.diff(np.array(seen), axis=0).T
    costs, busy = wall / simulated, processor / simulated
    return summarise(
        f'{_SCENE} in the node at h = {_STEP:g} s: wall time per simulated second',
        f'{1e3 * np.median(costs):.3g} ms', 'real time 1000 ms', costs, 1.0 / _FACTOR,
        note=f'a real-time factor of {1.0 / np.median(costs):.3g}: the simulator with '
             f'real_time_factor 0, its own method, {_RATE:g} samples per simulated second on all '
             'of its topics, one subscriber of joint_states, no bag and no picture; the node had '
             f'a processor for {1e3 * np.median(busy):.3g} ms of them, all that it takes on a '
             'machine that does nothing else',
        miss=f'the goal is a real-time factor of {_FACTOR:g}.')
