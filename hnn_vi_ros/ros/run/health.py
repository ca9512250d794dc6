# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The guards that a run calls for, and what becomes of their alarms."""

from collections import Counter
from collections.abc import Callable, Sequence
import math
import time

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.guards.base import Alarm, Guard
from hnn_vi_ros.guards.energy import EnergyGuard
from hnn_vi_ros.ros.sinks.recording import Recording
from hnn_vi_ros.ros.topics.diagnostics_publisher import (
    DiagnosticsPublisher, ERROR, OK, Status, WARN)
from hnn_vi_ros.run.pacing import OverrunGuard
from hnn_vi_ros.simulation.sample import Sample

STEP_FAILED = 'step failed'
# Wall time between two log lines of the same kind [s].
_REPEATED = 10.0


class Health:
    """
    Keep the alarms of a run; report each on /diagnostics, in the bag, the log and the picture.

    Parameters
    ----------
    stamp_at : callable
        Returns the stamp of a step [ns].
    guards : sequence of Guard
        What watches it.
    diagnostics : DiagnosticsPublisher
        Of /diagnostics.
    recording : Recording
        The files.
    log : callable
        Takes a line for the log and its level, INFO, WARN or ERROR.
    errors : sequence of str
        Kinds of alarms that are errors; the others are warnings.

    """

    def __init__(self, stamp_at: Callable[[int], int], guards: Sequence[Guard],
                 diagnostics: DiagnosticsPublisher, recording: Recording,
                 log: Callable[[str, str], None],
                 errors: Sequence[str] = (EnergyGuard.kind, STEP_FAILED)):
        self._stamp_at, self._guards, self.errors = stamp_at, guards, errors
        self._diagnostics, self._recording, self._log = diagnostics, recording, log
        # The newest alarm of each kind in its current form, the step that raised it, how
        # many there were, and when the log takes the next.
        self._alarms: dict[str, Alarm] = {}
        self._raised: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._due: dict[str, float] = {}

    def add(self, alarm: Alarm, stamp: int) -> None:
        """Publish an alarm that belongs to a sample, the newest one, of that stamp [ns]."""
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
            self._due[alarm.kind] = time.monotonic() + _REPEATED
            self._log(f't = {self._time(alarm.step)} s: {alarm.message}', word)

    def add_failure(self, failure: StepFailure, step: int, stamp: int) -> None:
        """Publish that the step after this one failed, after the sample of that stamp [ns]."""
        self.add(Alarm(STEP_FAILED, step, failure.relative_residual, math.nan, str(failure), '1'),
                 stamp)

    def find(self, kind: str) -> Alarm | None:
        """Return the newest alarm of a kind, None if there was none."""
        return self._alarms.get(kind)

    def status(self, sample: Sample | None = None) -> Status:
        """
        Return the worst that has happened so far, and the figures of each kind of alarm.

        Parameters
        ----------
        sample : Sample, optional
            The newest one, at which the alarms are looked at again.

        """
        if sample is not None:
            self._renew(sample)
        # The newest wins among equals.
        worst = max(reversed(self._alarms.values()), key=self._level, default=None)
        level, message = OK, 'no alarm'
        if worst is not None:
            level, message = self._level(worst), worst.message
        figures = {f'{alarm.kind}: {key}': value for alarm in self._alarms.values()
                   for key, value in self._figures(alarm).items()}
        # Results are as good after an overrun as before: it is reported once.
        self._alarms.pop(OverrunGuard.kind, None)
        return Status('health', level, message, {
            'watched': ', '.join([STEP_FAILED, *(guard.kind for guard in self._guards)]),
            **figures})

    def _renew(self, sample: Sample) -> None:
        """Put in the place of each alarm what its guard says of it now."""
        for guard in self._guards:
            if guard.kind in self._alarms and (alarm := guard.renew(sample)) is not None:
                self._alarms[guard.kind] = alarm

    def _time(self, step: int) -> str:
        """Return the time that a step is stamped with [s]."""
        return f'{self._stamp_at(step) / 1e9:.9g}'

    def _level(self, alarm: Alarm) -> bytes:
        return ERROR if alarm.kind in self.errors else WARN

    def _figures(self, alarm: Alarm) -> dict[str, object]:
        return {'step [1]': alarm.step, 't [s]': self._time(alarm.step),
                'since [s]': self._time(self._raised[alarm.kind]),
                f'value [{alarm.unit}]': alarm.value, f'limit [{alarm.unit}]': alarm.limit,
                'times [1]': self._counts[alarm.kind]}
