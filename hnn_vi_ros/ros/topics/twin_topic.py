# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topic ~/prediction_error of a twin, with its part in the bag and in /diagnostics."""

from collections.abc import Callable
import math

from hnn_vi_ros.companions.twin import Report, Twin
from hnn_vi_ros.effects.commands import Command, Observation
from hnn_vi_ros.ros.topics.diagnostics_publisher import OK, Status, WARN
from hnn_vi_ros.ros.topics.messages import named_numbers
from hnn_vi_ros.simulation import Simulation

# Behind the names of the coordinates, and of their predictions.
PREDICTED = 'prediction_'
SCALARS = ('normalised_error', 'running_prediction_time', 'valid_prediction_time')


class TwinTopic:
    """
    Publish the prediction error of each observation, as a companion of the simulation.

    The named positions of ~/prediction_error are: observed less simulated coordinates;
    observed less predicted ones; and the scalars of the prediction. It is stamped with the time
    of the observation.

    Parameters
    ----------
    twin : Twin
        What compares.
    send : callable
        Publishes and records a message: the bytes, and its stamp in the bag [ns].
    ignored : callable
        Returns how many observations could not be used, and why the last one could not.
    stamp : callable
        Returns that of the state [ns].

    """

    def __init__(self, twin: Twin, send: Callable[[bytes, int], None],
                 ignored: Callable[[], tuple[int, str]], stamp: Callable[[], int]):
        self._twin, self._send, self._ignored, self._stamp = twin, send, ignored, stamp
        labels = [*twin.names, *(f'{PREDICTED}{name}' for name in twin.names), *SCALARS]
        self._template = named_numbers(labels)

    def begin(self, simulation: Simulation) -> None:
        """See Companion."""
        self._twin.begin(simulation)

    def advance(self, n: int) -> None:
        """See Companion."""
        self._twin.advance(n)

    def set_command(self, command: Command) -> None:
        """See Companion; publish the errors that an observation shows."""
        self._twin.set_command(command)
        if isinstance(command, Observation) and self._twin.newest is not None:
            self._publish(self._twin.newest)

    def _publish(self, report: Report) -> None:
        self._template.numbers[0][:] = [
            *report.error, *report.prediction_error, report.normalised, report.running,
            self._twin.valid_prediction_time]
        now = self._stamp()
        self._template.set_stamp(max(0, now + round(report.delay * 1e9)))
        self._send(self._template.serialized(), now)

    @property
    def unstable(self) -> str:
        """See Twin."""
        return self._twin.unstable

    def status(self) -> Status:
        """Return how well the machine is followed."""
        twin, report = self._twin, self._twin.newest
        ignored, why = self._ignored()
        level, message = OK, 'no observation yet'
        if report is not None:
            median = twin.valid_prediction_time
            message = 'follows the machine' if math.isnan(median) else (
                f'predicts the machine for {median:.3g} s')
        if ignored or twin.failed:
            level = WARN
            message += f'; {ignored} observations ignored, {twin.failed} predictions failed'
        figures = {} if report is None else {
            **{f'error of {name}': float(value) for name, value in zip(
                twin.names, report.error, strict=True)},
            'normalised_error [1]': report.normalised,
            'running_prediction_time [s]': report.running,
            'valid_prediction_time [s]': twin.valid_prediction_time}
        return Status('twin', level, message, {
            **figures, 'predictions [1]': len(twin.times), 'failed predictions [1]': twin.failed,
            'ignored observations [1]': ignored, 'last ignored': why})
