# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The rerun picture of a run, made of its messages alone."""

from collections.abc import Mapping
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.bags.cdr import State
from hnn_vi_ros.errors import ParameterError, RecordingError
from hnn_vi_ros.files.resources import expand_user
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.phase_space import momentum_rates
from hnn_vi_ros.ros.parameters.settings import BridgeSettings
from hnn_vi_ros.ros.sinks.picture_output import SERVER_PORT, VIEWER_URL
from hnn_vi_ros.ros.topics.accuracy import ENTRIES
from hnn_vi_ros.ros.topics.diagnostics_publisher import ERROR
from hnn_vi_ros.ros.topics.event_topic import COMPONENT
from hnn_vi_ros.run.look_ahead import look_ahead
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation.build import build
from hnn_vi_ros.simulation.sample import Sample
from hnn_vi_ros.viewer.rerun_sink import RerunSink
from hnn_vi_ros.viewer.rerun_stream import Target
import numpy as np

# The picture leaves room for this much simulated time [s].
_SEEN = 30.0
# The viewer counts no farther.
_MOST_STEPS = 2.0**63
# Where there is no ~/state, a sample is made of these: their topics by the last part of the name.
NEEDED = frozenset(('q', 'p', 'energy', 'joint_states'))


class BridgePicture:
    """
    Show the samples of ~/state, or put them together from the messages of their tick.

    Parameters
    ----------
    scene : Scene
        As ~/scene or a log describes it.
    target : Path, str or int
        See RerunSink.
    name : str
        Of the recording.

    Raises
    ------
    HnnViRosError
        The scene's model is not there, or the target cannot be opened.

    """

    def __init__(self, scene: Scene, target: Target, name: str):
        simulation = build(scene)
        hamiltonian = simulation.hamiltonian
        box = hamiltonian.box or look_ahead(simulation, _SEEN).box
        self._step_size, self._energy0 = simulation.step_size, simulation.energy
        self._conservative, self._hamiltonian = simulation.conservative, hamiltonian
        self._integrator = None if simulation.modified_energy is None else simulation.integrator
        self.samples = 0
        self._sink = RerunSink(
            name, target, hamiltonian, simulation.q.copy(), simulation.p.copy(), box=box,
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=simulation.step_size,
            conservative=simulation.conservative, modified=self._integrator is not None)

    def show(self, state: State) -> None:
        """Show a sample."""
        _, dH_dp = self._hamiltonian.gradient(state.q, state.p)
        self._write(state, np.asarray(dH_dp), self._error(state.energy, state.work))

    def show_tick(self, messages: Mapping[str, Any]) -> None:
        """Show the messages of a tick, by the last part of their topics' names."""
        joints, energy = messages['joint_states'], messages['energy'].data
        stamp = joints.header.stamp
        # Only ~/accuracy tells of the work.
        error = work = math.nan
        if 'accuracy' in messages:
            accuracy = dict(zip(ENTRIES, messages['accuracy'].data, strict=False))
            error, work = accuracy['energy_error'], accuracy['work']
        elif self._conservative:
            error, work = self._error(energy, 0.0), 0.0
        q, p = np.array(messages['q'].data), np.array(messages['p'].data)
        # The effort is that of motors, or in earlier bags p'.
        rates = momentum_rates(
            self._hamiltonian.rotations, q, p, *self._hamiltonian.gradient(q, p))
        self._write(State(stamp.sec * 10**9 + stamp.nanosec, q, p, rates, energy, work),
                    np.array(joints.velocity), error)

    def tell(self, message: DiagnosticArray, simulator: str) -> None:
        """
        Show alarms, and what steps cost, at the newest sample, and events at their own times.

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
            elif status.name == f'{simulator[1:]}: {COMPONENT}':
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                self._sink.event(status.message, 'INFO', (
                    stamp, math.floor(stamp * 1e-9 / self._step_size)))
            elif status.name == f'{simulator[1:]}: timing':
                median, p99, pace = (float(values.get(name, math.nan)) for name in (
                    'microseconds_per_step_median', 'microseconds_per_step_p99',
                    'real_time_factor'))
                self._sink.timing((median, p99), pace)

    def close(self) -> None:
        """Send what is left; RecordingError if it is not taken."""
        self._sink.close()

    def _error(self, energy: float, work: float) -> float:
        balance = energy - self._energy0 - work
        return balance / abs(self._energy0) if self._energy0 else balance

    def _write(self, state: State, dH_dp: np.ndarray, error: float) -> None:
        modified = math.nan
        if self._integrator is not None:
            modified = self._integrator.modified_energy(
                self._hamiltonian, self._step_size, state.q, state.p, state.energy,
                -state.dp_dt, dH_dp)
        step = state.stamp * 1e-9 / self._step_size
        if not step < _MOST_STEPS:
            raise RecordingError(f'its scene has steps of {self._step_size:g} s, of which its '
                                 'stamps are more than can be counted; is its step_size right?')
        self._sink.write(Sample(
            step=round(step), stamp=state.stamp, q=state.q,
            p=state.p, dH_dq=-state.dp_dt, dH_dp=dH_dp, energy=state.energy,
            modified_energy=modified, energy_error=error, work=state.work))
        self.samples += 1


def target_of(settings: BridgeSettings) -> Target:
    """Return where parameters say that the picture goes, or raise ParameterError."""
    path = settings.rerun_path
    if settings.rerun_sink == 'connect':
        return path or VIEWER_URL
    if settings.rerun_sink == 'serve':
        port = path or str(SERVER_PORT)
        if not (port.isdecimal() and 0 < int(port) < 65536):
            raise ParameterError(f'parameter rerun_path = {path!r}: expected a port, 1 to 65535')
        return int(port)
    if not path:
        raise ParameterError('parameter rerun_path: expected the .rrd file to write')
    return expand_user(path)
