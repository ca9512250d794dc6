# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Picture of a bag in rerun, for ``replay --rerun``."""

import math
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.errors import prefixed, RecordingError
from hnn_vi_ros.hamiltonians import MECHANISMS
from hnn_vi_ros.recording import RerunSink, Sample, StateMessage
from hnn_vi_ros.ros.topics.diagnostics import ERROR, EVENT
from hnn_vi_ros.run import nanoseconds, preview_bounds, RecordedRun
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build
import numpy as np
from rclpy.serialization import deserialize_message

# Simulated time that fits into the picture [s].
_PREVIEW_TIME = 30.0
# Largest step number that the viewer accepts.
_MAX_STEP_NUMBER = 2.0**63


class Picture:
    """
    Display of a recorded run in the viewer.

    Parameters
    ----------
    scene : Scene
        Scene of the run.
    path : Path
        The .rrd file to write.
    name : str
        Name of the recording.
    simulator : str
        Full name of the simulator.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, for example because its model is missing, or the file cannot be
        written.

    """

    def __init__(self, scene: Scene, path: Path, name: str, simulator: str):
        # The simulation stays in its initial state.
        self._simulation = simulation = build(scene)
        self._simulator = simulator.removeprefix('/')
        self._energy0, self._modified = simulation.energy, simulation.modified_energy is not None
        self._sink = RerunSink(
            name, path, simulation.hamiltonian, simulation.q.copy(), simulation.p.copy(),
            box=simulation.hamiltonian.box or preview_bounds(simulation, _PREVIEW_TIME),
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=simulation.step_size,
            conservative=simulation.conservative, modified=self._modified)

    def show(self, state: StateMessage) -> None:
        """Display a sample; ValueError if it does not fit the scene."""
        simulation, hamiltonian = self._simulation, self._simulation.hamiltonian
        h, energy0 = simulation.step_size, self._energy0
        dH_dp = np.asarray(hamiltonian.gradient(state.q, state.p, state.stamp * 1e-9)[1])
        modified: Any = math.nan
        if self._modified:
            modified = simulation.integrator.modified_energy(
                hamiltonian, h, state.q, state.p, state.energy, -state.dp_dt, dH_dp)
        step = state.stamp * 1e-9 / h
        if not step < _MAX_STEP_NUMBER:
            raise ValueError(f'its scene has steps of {h:g} s, so its stamps exceed the '
                             'countable number of steps; check its step_size')
        balance = state.energy - energy0 - state.work
        self._sink.write(Sample(
            step=round(step), stamp=state.stamp, q=state.q,
            p=state.p, dH_dq=-state.dp_dt, dH_dp=dH_dp, energy=state.energy,
            modified_energy=modified, work=state.work,
            energy_error=balance / abs(energy0) if energy0 else balance))

    def tell(self, message: DiagnosticArray) -> None:
        """Display alarms and the cost of steps at the newest sample, events at their own times."""
        for status in message.status:
            values = {item.key.partition(' ')[0]: item.value for item in status.values}
            if status.name == f'{self._simulator}: health' and 'alarm' in values:
                self._sink.event(f'{values["alarm"]}: {status.message}',
                                 'ERROR' if status.level == ERROR else 'WARN')
            elif status.name == f'{self._simulator}: {EVENT}':
                stamp = nanoseconds(message.header.stamp)
                self._sink.event(status.message, 'INFO', (
                    stamp, math.floor(stamp * 1e-9 / self._simulation.step_size)))
            elif status.name == f'{self._simulator}: timing':
                median, p99, pace = (float(values.get(name, math.nan)) for name in (
                    'microseconds_per_step_median', 'microseconds_per_step_p99',
                    'real_time_factor'))
                self._sink.timing((median, p99), pace)

    def close(self) -> None:
        """Write the remaining data; RecordingError if that fails."""
        self._sink.close()


def write_picture(bag: Path, path: Path, trust_code: bool = False, node: str = ''
                  ) -> tuple[int, str]:
    """
    Write a bag to a recording of rerun; return the number of samples, and the bag's damage.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file.
    path : Path
        The .rrd file, which must not exist.
    trust_code, node : bool and str, optional
        See RecordedRun.

    """
    run = RecordedRun(bag, trust_code, node)
    picture, samples = Picture(run.scene, path, bag.resolve().name, run.node), 0
    told = {number for number, name in run.names.items() if name in ('diagnostics', 'events')}
    try:
        with prefixed(str(bag), RecordingError):
            for message, state in run.in_order({run.channel, *told}):
                if state is not None:
                    picture.show(state)
                    samples += 1
                elif message.channel in told:
                    picture.tell(deserialize_message(message.data, DiagnosticArray))
    except RuntimeError as problem:
        raise RecordingError(f'{run.reader.path}: the message of '
                             f'{run.reader.channels[message.channel].topic} at {message.time} ns '
                             'cannot be read: it is not a DiagnosticArray') from problem
    finally:
        picture.close()
    return samples, run.reader.damage
