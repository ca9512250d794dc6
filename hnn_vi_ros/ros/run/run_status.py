# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Status of a run, component by component, in plain words and figures."""

import math

from hnn_vi_ros.ros.run.health import Health, STEP_FAILED
from hnn_vi_ros.ros.sinks.recording import Recording
from hnn_vi_ros.ros.topics.diagnostics_publisher import ERROR, OK, Status, WARN
from hnn_vi_ros.run.monitor import Monitor
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample


class RunStatus:
    """
    Statuses of timing, integrator, energy, recorder, model and health.

    Parameters
    ----------
    scene : Scene
        The simulated scene, resolved.
    simulation : Simulation
        Made of it.
    sampler : Sampler
        Of its samples and their stamps.
    monitor : Monitor
        Its measurements.
    recording : Recording
        The files.
    health : Health
        The alarms.
    real_time_factor : float
        The pace that is asked for; 0 for as fast as possible.

    Attributes
    ----------
    asked : float
        The pace that is asked for now.
    paused : bool
        Whether the run stands still.

    """

    def __init__(self, scene: Scene, simulation: Simulation, sampler: Sampler,
                 monitor: Monitor, recording: Recording, health: Health,
                 real_time_factor: float):
        self._scene, self._simulation, self._sampler = scene, simulation, sampler
        self._monitor, self._recording, self._health = monitor, recording, health
        self.asked, self.paused = real_time_factor, False
        self._model = _model(scene, simulation)
        # When the last statuses were published.
        self._overruns, self._rescued = 0, 0

    def statuses(self, overruns: int) -> list[Status]:
        """Return a status of each component."""
        return [self._timing(overruns), self._integrator(), self._energy(), self._recorder(),
                self._model, self._health.status(self._monitor.newest)]

    def _timing(self, overruns: int) -> Status:
        figures, asked = self._monitor.timing.figures, self.asked
        late, self._overruns = overruns - self._overruns, overruns
        level, message = OK, f'holds {asked:g} x real time' if asked else 'as fast as possible'
        if self.paused:
            message = 'paused'
        elif late:
            level, message = WARN, (
                f'{late} overruns since the last report: slower than {asked:g} x real time')
        elif asked and figures.largest_real_time_factor < asked:
            level, message = WARN, (
                f'cannot hold {asked:g} x real time, at most '
                f'{figures.largest_real_time_factor:.3g}; use a larger step_size, a cheaper '
                'integrator or a lower publish_rate')
        return Status('timing', level, message, {
            'microseconds_per_step_median [us]': figures.microseconds_per_step_median,
            'microseconds_per_step_p99 [us]': figures.microseconds_per_step_p99,
            'microseconds_per_sample [us]': figures.microseconds_per_sample,
            'real_time_factor [1]': figures.real_time_factor,
            'real_time_factor_asked_for [1]': asked,
            'largest_real_time_factor [1]': figures.largest_real_time_factor,
            'overruns [1]': overruns})

    def _integrator(self) -> Status:
        scene, simulation = self._scene, self._simulation
        rescued, self._rescued = simulation.rescued - self._rescued, simulation.rescued
        level, message = OK, f'{scene.integrator.kind}: no step failed'
        failure = self._health.find(STEP_FAILED)
        if failure is not None:
            level, message = ERROR, failure.message
        elif rescued:
            level, message = WARN, (f'{rescued} steps since the last report converged only in '
                                    'parts; use a smaller step_size')
        return Status('integrator', level, message, {
            'integrator': scene.integrator.kind, 'step_size [s]': simulation.step_size,
            'steps [1]': simulation.steps, 'simulated_time [s]': f'{self._sampler.time:.9g}',
            'gradients_per_step [1]': self._monitor.timing.figures.gradients_per_step,
            'gradients_of_the_costliest_step [1]': simulation.costliest[0],
            'residual [1]': simulation.residual, 'rescued_steps [1]': simulation.rescued})

    def _energy(self) -> Status:
        record, sample, tolerance = (
            self._monitor.energy, self._monitor.newest, self._monitor.energy.tolerance)
        level, message, allowed = OK, 'conservative', {}
        if not self._simulation.conservative:
            message = 'not conservative: the error is what the work does not account for'
        if tolerance is not None:
            allowed = {f'tolerance_of_{tolerance.kind}': tolerance.error,
                       f'largest_{tolerance.kind}': record.largest}
            message = f'{tolerance.kind} within its tolerance'
            if record.largest > tolerance.error:
                level, message = WARN, self._monitor.over_tolerance()
        return Status('energy', level, message, {
            **_energies(sample), 'energy_scale [J]': self._monitor.energy_scale,
            f'energy_error [{record.unit}]': _of(sample, 'energy_error'),
            'modified_energy_band [J]': record.band,
            f'drift_per_hour [{record.unit}/h]': record.drift_per_hour, **allowed})

    def _recorder(self) -> Status:
        recording = self._recording
        level, message = OK, 'recording' if recording.targets else 'nothing is recorded, as asked'
        if recording.problem:
            level, message = ERROR, recording.problem
        return Status('recorder', level, message, {
            **recording.targets, 'samples [1]': recording.samples})


def _energies(sample: Sample | None) -> dict[str, float]:
    return {'H [J]': _of(sample, 'energy'), 'modified_H [J]': _of(sample, 'modified_energy'),
            'work [J]': _of(sample, 'work')}


def _of(sample: Sample | None, field: str) -> float:
    return math.nan if sample is None else getattr(sample, field)


def _model(scene: Scene, simulation: Simulation) -> Status:
    hamiltonian = simulation.hamiltonian
    learned = getattr(scene.hamiltonian, 'model', '')
    message = f'learned: {learned}' if learned else f'exact: {scene.hamiltonian.kind}'
    return Status('model', OK, message, {
        'hamiltonian': scene.hamiltonian.kind,
        'coordinates': ','.join(c.name for c in hamiltonian.coordinates),
        'effects': ','.join(effect.kind for effect in scene.effects) or 'none',
        **hamiltonian.provenance})
