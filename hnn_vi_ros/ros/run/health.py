# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Health of a run: its guards, the publication of their alarms, and its status."""

from collections import Counter
from collections.abc import Callable, Sequence
import math
import time

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.recording import RunRecording
from hnn_vi_ros.ros.topics.diagnostics import DiagnosticsPublisher, ERROR, OK, Status, WARN
from hnn_vi_ros.run import Monitor, OverrunGuard, Pacer, Sampler
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Alarm, EnergyGuard, Guard, PathReport, Simulation

STEP_FAILED = 'step failed'
# Samples per burst above which to warn: a controller acts on the last sample of a burst only.
_MAX_BURST = 2.5
# Wall time between two log lines of the same kind [s].
_LOG_PERIOD = 10.0


class Health:
    """
    Store of the alarms of a run; reports each on /diagnostics, in the bag, log and picture.

    Parameters
    ----------
    stamp_at : callable
        Returns the stamp of a step [ns].
    guards : sequence of Guard
        Guards that watch the run.
    diagnostics : DiagnosticsPublisher
        Publisher on /diagnostics.
    recording : Recording
        The open files.
    log : callable
        Logs a line with a level, INFO, WARN or ERROR.
    errors : sequence of str
        Kinds of alarms that are errors; all others are warnings.

    """

    def __init__(self, stamp_at: Callable[[int], int], guards: Sequence[Guard],
                 diagnostics: DiagnosticsPublisher, recording: RunRecording,
                 log: Callable[[str, str], None],
                 errors: Sequence[str] = (EnergyGuard.kind, STEP_FAILED)):
        self._stamp_at, self._guards, self.errors = stamp_at, guards, errors
        self._diagnostics, self._recording, self._log = diagnostics, recording, log
        # Newest alarm of each kind in its current form, the step that raised it, number of alarms,
        # and time of the next permitted log line.
        self._alarms: dict[str, Alarm] = {}
        self._raised: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._due: dict[str, float] = {}

    def add(self, alarm: Alarm, stamp: int) -> None:
        """Publish an alarm of the newest sample, whose stamp is given [ns]."""
        self._alarms.pop(alarm.kind, None)
        self._alarms[alarm.kind] = alarm
        self._raised[alarm.kind] = alarm.step
        self._counts[alarm.kind] += 1
        level = self._level(alarm)
        self._diagnostics.publish([Status('health', level, alarm.message, {
            'alarm': alarm.kind, **self._figures(alarm)})], stamp)
        word = 'ERROR' if level == ERROR else 'WARN'
        self._recording.event(f'{alarm.kind}: {alarm.message}', word)
        if time.monotonic() >= self._due.get(alarm.kind, -math.inf):
            self._due[alarm.kind] = time.monotonic() + _LOG_PERIOD
            # The troubleshooting page lists remedies by kind.
            self._log(f'{alarm.kind}: t = {self._time(alarm.step)} s: {alarm.message}', word)

    def add_failure(self, failure: StepFailure, step: int, stamp: int) -> None:
        """Publish that the step after `step` failed, after the sample of this stamp [ns]."""
        self.add(Alarm(STEP_FAILED, step, failure.relative_residual, math.nan, str(failure), '1'),
                 stamp)

    def find(self, kind: str) -> Alarm | None:
        """Return the newest alarm of a kind, None if there is none."""
        return self._alarms.get(kind)

    def status(self, sample: Sample | None = None) -> Status:
        """
        Return the status of the worst alarm so far, with the values of each kind of alarm.

        Parameters
        ----------
        sample : Sample, optional
            The newest sample, with which the alarms are updated.

        """
        if sample is not None:
            self._renew(sample)
        # Among equal levels, the newest alarm is reported.
        worst = max(reversed(self._alarms.values()), key=self._level, default=None)
        level, message = OK, 'no alarm'
        if worst is not None:
            level, message = self._level(worst), worst.message
        figures = {f'{alarm.kind}: {key}': value for alarm in self._alarms.values()
                   for key, value in self._figures(alarm).items()}
        # Reported once only, because an overrun does not affect later results.
        self._alarms.pop(OverrunGuard.kind, None)
        return Status('health', level, message, {
            'watched': ', '.join([STEP_FAILED, *(guard.kind for guard in self._guards)]),
            **figures})

    def _renew(self, sample: Sample) -> None:
        """Update each alarm with the current value of its guard."""
        for guard in self._guards:
            if guard.kind in self._alarms and (alarm := guard.renew(sample)) is not None:
                self._alarms[guard.kind] = alarm

    def _time(self, step: int) -> str:
        """Return the time stamp of a step [s]."""
        return f'{self._stamp_at(step) / 1e9:.9g}'

    def _level(self, alarm: Alarm) -> bytes:
        return ERROR if alarm.kind in self.errors else WARN

    def _figures(self, alarm: Alarm) -> dict[str, object]:
        return {'step [1]': alarm.step, 't [s]': self._time(alarm.step),
                'since [s]': self._time(self._raised[alarm.kind]),
                f'value [{alarm.unit}]': alarm.value, f'limit [{alarm.unit}]': alarm.limit,
                'times [1]': self._counts[alarm.kind]}


class RunStatus:
    """
    Statuses of timing, integrator, energy, recorder, model and health.

    Parameters
    ----------
    scene : Scene
        The simulated scene, resolved.
    simulation : Simulation
        Simulation of the scene.
    sampler : Sampler
        Sampler, which gives samples and their stamps.
    monitor : Monitor
        Monitor of energy and timing.
    recording : Recording
        The open files.
    health : Health
        Store of the alarms.
    path_error : PathReport
        Report of the path error.

    Attributes
    ----------
    paused : bool
        True while the run is paused.

    """

    def __init__(self, scene: Scene, simulation: Simulation, sampler: Sampler,
                 monitor: Monitor, recording: RunRecording, health: Health,
                 path_error: PathReport):
        self._scene, self._simulation, self._sampler = scene, simulation, sampler
        self._monitor, self._recording, self._health = monitor, recording, health
        self.paused, self._path_error = False, path_error
        self._model = _model(scene, simulation)
        # Counts at the time of the last statuses.
        self._overruns, self._rescued, self._steps = 0, 0, 0

    def statuses(self, pacer: Pacer) -> list[Status]:
        """Return a status of each component."""
        return [self._timing(pacer), self._integrator(), self._energy(), self._recorder(),
                self._model, self._health.status(self._monitor.newest)]

    def _timing(self, pacer: Pacer) -> Status:
        figures, asked, overruns = self._monitor.timing.figures, pacer.asked, pacer.overruns
        of = '/clock' if pacer.led else 'real time'
        late, self._overruns = overruns - self._overruns, overruns
        steps, self._steps = self._simulation.steps - self._steps, self._simulation.steps
        level, message = OK, f'runs at {asked:g} x {of}' if asked else 'as fast as possible'
        if self.paused:
            message = 'paused'
        elif pacer.led and not steps:
            message = 'waits for /clock, which does not advance or is not published'
        elif late:
            level, message = WARN, (
                f'{late} overruns since the last report: slower than {asked:g} x {of}'
                + (', which may have jumped' if pacer.led else ''))
        elif pacer.led and pacer.burst > _MAX_BURST:
            level, message = WARN, (
                f'/clock advances {pacer.burst:.3g} samples at a time, so samples come in bursts; '
                'reduce publish_rate, or publish /clock more often')
        elif asked and not pacer.led and figures.largest_real_time_factor < asked:
            level, message = WARN, (
                f'cannot run at {asked:g} x real time, at most '
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
            level, message = WARN, (f'{rescued} steps since the last report had to be rescued; '
                                    'reduce step_size')
        return Status('integrator', level, message, {
            'integrator': scene.integrator.kind, 'step_size [s]': simulation.step_size,
            'path_error': self._path_error,
            'steps [1]': simulation.steps, 'simulated_time [s]': f'{self._sampler.time:.9g}',
            'gradients_per_step [1]': self._monitor.timing.figures.gradients_per_step,
            'gradients_of_the_costliest_step [1]': simulation.costliest[0],
            'residual [1]': simulation.residual, 'rescued_steps [1]': simulation.rescued,
            'rejected_internal_steps [1]': int(simulation.internal_steps[1])})

    def _energy(self) -> Status:
        record, sample, tolerance = (
            self._monitor.energy, self._monitor.newest, self._monitor.energy.tolerance)
        unit = record.energy_unit
        level, message, allowed = OK, 'conservative', {}
        if not self._simulation.conservative:
            message = 'not conservative: the error is the energy change minus the work'
        if tolerance is not None:
            allowed = {f'tolerance_of_{tolerance.kind}': tolerance.error,
                       f'largest_{tolerance.kind}': record.largest}
            message = f'{tolerance.kind} within its tolerance'
            if record.largest > tolerance.error:
                level, message = WARN, self._monitor.over_tolerance()
        return Status('energy', level, message, {
            f'H [{unit}]': _field(sample, 'energy'),
            f'modified_H [{unit}]': _field(sample, 'modified_energy'),
            f'work [{unit}]': _field(sample, 'work'),
            f'energy_scale [{unit}]': self._monitor.energy_scale,
            f'energy_error [{record.unit}]': _field(sample, 'energy_error'),
            f'modified_energy_band [{unit}]': record.band,
            f'drift_per_hour [{record.unit}/h]': record.drift_per_hour, **allowed})

    def _recorder(self) -> Status:
        recording = self._recording
        level, message = OK, (
            'recording' if recording.targets else 'nothing is recorded, as requested')
        if recording.problem:
            level, message = ERROR, recording.problem
        elif slow := recording.slow_disk():
            level, message = WARN, f'{slow}; a killed process loses as much'
        return Status('recorder', level, message, {
            **recording.targets, 'samples [1]': recording.samples})


def _field(sample: Sample | None, field: str) -> float:
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
