# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of companions: ~/uncertainty of an ensemble, ~/prediction_error of a twin."""

from collections.abc import Callable
import math
import time

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.recording import MOMENTUM, Template
from hnn_vi_ros.ros.topics.diagnostics import OK, Status, WARN
from hnn_vi_ros.ros.topics.inputs import OBSERVATIONS
from hnn_vi_ros.ros.topics.messages import encode_numbers, named_numbers
from hnn_vi_ros.run import Members, Report, Twin
from hnn_vi_ros.simulation import SpreadGuard


class SpreadTopic:
    """
    Topic that publishes the spread of the members of an ensemble.

    The positions of ~/uncertainty are the half-widths of the bands around q and p, with the same
    names as in ~/state.

    Parameters
    ----------
    members : Members
        The ensemble.
    hamiltonian : Hamiltonian
        The mean Hamiltonian, with the box of its training data.
    limit : float
        Largest allowed spread, in half-widths of the box.

    """

    def __init__(self, members: Members, hamiltonian: Hamiltonian, limit: float):
        self._members = members
        names, momenta = columns(hamiltonian.coordinates)
        self._labels = [*names, *(f'{MOMENTUM}{name}' for name in momenta)]
        # Encodes samples that have a spread; others give no message.
        self.encode = encode_numbers(
            named_numbers(self._labels),
            lambda sample: None if sample.spread is None else [sample.spread], stamped=True)
        assert hamiltonian.box is not None, 'of a learned Hamiltonian there is one'
        self._box, self._limit = hamiltonian.box, limit
        self.make_guard()

    def make_guard(self) -> SpreadGuard:
        """Create and return the guard that watches a run from its start."""
        self.guard = SpreadGuard(lambda: self._members.spread, self._box, self._limit)
        return self.guard

    def status(self) -> Status:
        """Return the diagnostic status of the spread."""
        members, value = self._members, self.guard.value
        level, message = OK, 'the members of the ensemble agree'
        if value > self._limit:
            level, message = WARN, 'the members of the ensemble have diverged'
        if members.factors is None:
            message += '; the spread is not calibrated'
        return Status('uncertainty', level, message, {
            'spread [half-widths]': value, 'limit [half-widths]': self._limit,
            **{f'spread of {name}': float(one) for name, one in zip(
                self._labels, members.spread, strict=True)},
            'members [1]': members.count, 'failed members [1]': members.failed,
            'factors [1]': 'none' if members.factors is None else ' '.join(
                f'{factor:.4g}' for factor in members.factors),
            'covered by the band [1]': 'unknown' if members.level is None else members.level})


# Prefix of the names of prediction errors.
PREDICTED = 'prediction_'
# Wall time without an observation that is reported even while simulated time is paused [s].
_MAX_SILENCE = 5.0
SCALARS = ('normalised_error', 'running_prediction_time', 'valid_prediction_time')


class TwinTopic:
    """
    Topic that publishes the prediction error of each observation.

    The named positions of ~/prediction_error are the observed minus the simulated coordinates, the
    observed minus the predicted coordinates, and the scalars of the prediction. The message is
    stamped with the time of the observation.

    Parameters
    ----------
    twin : Twin
        Twin that compares observations with the simulation.
    send : callable
        Publishes and records a message, given its bytes and its stamp in the bag [ns].
    ignored : callable
        Returns the number of ignored observations and the reason for the last one.
    stamp : callable
        Returns the stamp of the state [ns].
    warn : callable
        Logs a warning.

    """

    def __init__(self, twin: Twin, send: Callable[[bytes, int], None],
                 ignored: Callable[[], tuple[int, str]], stamp: Callable[[], int],
                 warn: Callable[[str], None]):
        self._twin, self._send, self._ignored, self._stamp = twin, send, ignored, stamp
        self._warn, self._newest, self._silent = warn, (0, -math.inf), False
        labels = [*twin.names, *(f'{PREDICTED}{name}' for name in twin.names), *SCALARS]
        self._template = Template(named_numbers(labels))
        twin.heard = self._publish

    def _publish(self, report: Report) -> None:
        self._template.numbers[0][:] = [
            *report.error, *report.prediction_error, report.normalised, report.running,
            self._twin.valid_prediction_time]
        now = self._stamp()
        self._template.set_stamp(max(0, now + round(report.delay * 1e9)))
        self._send(self._template.serialized(), now)
        self._newest, self._silent = (now, time.monotonic()), False

    def status(self) -> Status:
        """Return the diagnostic status of the twin: how closely it follows the machine."""
        twin, report = self._twin, self._twin.newest
        ignored, why = self._ignored()
        stamp, wall = self._newest
        age, quiet = 1e-9 * (self._stamp() - stamp), time.monotonic() - wall
        level, message = OK, ''
        if report is None:
            level, message = WARN, 'no observation yet'
        elif age > twin.timeout or quiet > max(twin.timeout, _MAX_SILENCE):
            level, message = WARN, f'no observation for {max(age, quiet):.3g} s'
            if not self._silent:
                self._silent = True
                self._warn(f'{OBSERVATIONS.topic}: {message}: the simulation continues without '
                           'observations')
        else:
            median = twin.valid_prediction_time
            message = 'follows the machine' if math.isnan(median) else (
                f'predicts the machine for {median:.3g} s')
        if twin.outside > 0.0:
            level = WARN
            message += (f'; {100.0 * twin.outside:.3g} % of the observations are outside the '
                        f'training domain of the model: {twin.beyond}')
        if ignored or twin.failed:
            level = WARN
            message += f'; {ignored} observations ignored, {twin.failed} predictions failed'
        figures = {} if report is None else {
            **{f'error of {name}': float(value) for name, value in zip(
                twin.names, report.error, strict=True)},
            'normalised_error [1]': report.normalised,
            'running_prediction_time [s]': report.running,
            'valid_prediction_time [s]': twin.valid_prediction_time,
            'valid_prediction_time inside [s]': twin.valid_time(False),
            'valid_prediction_time outside [s]': twin.valid_time(True),
            'share outside [1]': twin.outside}
        return Status('twin', level, message, {
            **figures, 'predictions [1]': len(twin.times), 'failed predictions [1]': twin.failed,
            'ignored observations [1]': ignored, 'last ignored': why})
