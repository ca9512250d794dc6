# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The rerun picture of a run, made of its messages alone."""

from collections.abc import Mapping
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.accuracy import ENTRIES
from hnn_vi_ros.ros.diagnostics_publisher import ERROR
from hnn_vi_ros.ros.look_ahead import look_ahead
from hnn_vi_ros.ros.recorded_run import described_scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.rerun_sink import RerunSink
from hnn_vi_ros.sinks.rerun_stream import Target
from hnn_vi_ros.sinks.sample import Sample
import numpy as np

# Simulated time of which the picture leaves room [s].
_SEEN = 30.0
# Without these there is no sample.
NEEDED = frozenset(('q', 'p', 'energy', 'joint_states'))


class BridgePicture:
    """
    Show samples that are put together from the messages of their tick.

    Parameters
    ----------
    described : mapping
        The scene as ~/scene and the log's scene.yaml have it.
    where : str
        What describes it, for errors.
    target : Path, str or int
        See RerunSink.
    name : str
        Of the recording.

    Raises
    ------
    HnnViRosError
        It is no scene, its model is not there, or the target cannot be opened.

    """

    def __init__(self, described: Mapping[str, Any], where: str, target: Target, name: str):
        scene = described_scene(dict(described), where)
        simulation = Simulation.from_scene(scene)
        hamiltonian = simulation.hamiltonian
        box = hamiltonian.box or look_ahead(simulation, _SEEN).box
        self._step_size, self._energy0 = simulation.step_size, simulation.energy
        self._conservative = simulation.conservative
        self._integrator = None if simulation.modified_energy is None else simulation.integrator
        self.samples = 0
        self._sink = RerunSink(
            name, target, hamiltonian, simulation.q.copy(), simulation.p.copy(), box=box,
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            conservative=simulation.conservative, modified=self._integrator is not None)

    def show(self, messages: Mapping[str, Any]) -> None:
        """Show the messages of a tick, by the last part of their topics' names."""
        stamp = messages['joint_states'].header.stamp
        self._sink.write(self._sample(stamp.sec * 10**9 + stamp.nanosec, messages))
        self.samples += 1

    def tell(self, message: DiagnosticArray, simulator: str) -> None:
        """
        Show alarms as events, and what steps cost, at the newest sample.

        Parameters
        ----------
        message : DiagnosticArray
            Of any node.
        simulator : str
            Full name of the one that is shown.

        """
        for status in message.status:
            values = {item.key.partition(' ')[0]: item.value for item in status.values}
            if status.name == f'{simulator[1:]}: health' and 'alarm' in values:
                self._sink.event(f'{values["alarm"]}: {status.message}',
                                 'ERROR' if status.level == ERROR else 'WARN')
            elif status.name == f'{simulator[1:]}: timing':
                median, p99, pace = (float(values.get(name, math.nan)) for name in (
                    'microseconds_per_step_median', 'microseconds_per_step_p99',
                    'real_time_factor'))
                self._sink.timing((median, p99), pace)

    def close(self) -> None:
        """Send what is left; RecordingError if it is not taken."""
        self._sink.close()

    def _sample(self, stamp: int, messages: Mapping[str, Any]) -> Sample:
        joints, energy = messages['joint_states'], messages['energy'].data
        dH_dq, dH_dp = -np.array(joints.effort), np.array(joints.velocity)
        modified = math.nan
        if self._integrator is not None:
            modified = self._integrator.modified_energy(self._step_size, energy, dH_dq, dH_dp)
        error, work = energy - self._energy0, 0.0
        if self._energy0:
            error /= abs(self._energy0)
        if 'accuracy' in messages:
            told = dict(zip(ENTRIES, messages['accuracy'].data))
            error, work = told['energy_error'], told['work']
        elif not self._conservative:
            # Only ~/accuracy tells of the work.
            error = work = math.nan
        return Sample(
            step=round(stamp * 1e-9 / self._step_size), stamp=stamp,
            q=np.array(messages['q'].data), p=np.array(messages['p'].data), dH_dq=dH_dq,
            dH_dp=dH_dp, energy=energy, modified_energy=modified, energy_error=error, work=work)
