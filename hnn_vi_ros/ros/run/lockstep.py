# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep with a controller: a run waits after its samples for the commands that answer them."""

from collections.abc import Callable
import time

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.inputs import JOINT_COMMANDS

# Wall time after which the awaited state is published again for late subscribers [s].
REPEAT_PERIOD = 1.0
# Wall time without a publisher of commands after which the controller counts as gone [s].
_MAX_ABSENCE = 5.0


class Lockstep:
    """
    Observer of the samples of a run, which waits for the commands that answer them.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    every, step_size : int, float
        Number of steps between two samples, and the step size [s].

    Attributes
    ----------
    awaited : int or None
        Stamp of the sample whose answer is awaited [ns]; None while the run continues.
    repeated : int or None
        Stamp of a sample whose answer changes nothing [ns]: the last one of the run, or the last
        one that was published again.
    on_answer : callable
        Called when the run may continue.

    Raises
    ------
    ParameterError
        The period is not a whole number of samples.

    """

    def __init__(self, settings: Settings, every: int, step_size: float):
        tick = every * step_size
        samples = settings.lockstep_period / tick or 1.0
        if samples < 0.5 or abs(samples - round(samples)) > 1e-6 * samples:
            raise ParameterError(
                f'parameter lockstep_period = {settings.lockstep_period:g} s: expected a whole '
                f'number of sample intervals of {tick:g} s, or 0 for one')
        self._interval = every * round(samples)
        self._timeout = settings.lockstep_timeout
        self._holds = settings.on_lockstep_timeout == 'hold'
        self.awaited: int | None = None
        self.repeated: int | None = None
        self.on_answer: Callable[[], None] = lambda: None
        # Wall times at which the wait began, and at which commands last had a publisher [s]; and
        # whether an answer has come: the first wait has no limit.
        self._since, self._seen, self._begun = 0.0, 0.0, False

    def observe(self, sample: Sample, last: bool) -> None:
        """Wait for the answer to a sample if a period ends with it, but not after the last."""
        if sample.step % self._interval == 0:
            if last:
                # The answer may come before or after the end, and would change nothing.
                self.repeated = sample.stamp
            else:
                self.awaited, self._since = sample.stamp, time.monotonic()

    def take(self, stamp: int) -> Callable[[], None] | None:
        """
        Return the continuation after a command with this stamp [ns], the awaited answer.

        Return None to ignore another answer to a repeated sample; raise ValueError for any other
        stamp.
        """
        if stamp not in (self.awaited, self.repeated):
            wanted = 'none is awaited' if self.awaited is None else (
                f'that of {self.awaited / 1e9:.9g} s is awaited')
            raise ValueError(f'lockstep: answers the state of {stamp / 1e9:.9g} s, but {wanted}; '
                             'stamp each command with the stamp of the state that it answers')
        self._begun, self._seen = True, time.monotonic()
        return self._go_on if stamp == self.awaited else None

    def check(self, going: bool, publishers: int, publish_again: Callable[[], None],
              tell: Callable[[str, str], None]) -> str:
        """
        Publish an awaited state again, and end a wait that is too long or for nobody.

        Parameters
        ----------
        going : bool
            True if the run would continue without the wait.
        publishers : int
            Number of publishers of commands.
        publish_again : callable
            Publishes the last sample once more.
        tell : callable
            Logs a line, given its text and level.

        Returns
        -------
        str
            Reason to stop the run; '' to keep it.

        """
        now = time.monotonic()
        self._seen = now if publishers or not going else self._seen
        gone = now - self._seen > _MAX_ABSENCE
        if self.awaited is None:
            return ''
        publish_again()
        if not self._begun and self.repeated is None:
            tell(f'lockstep: waiting for the first command on {JOINT_COMMANDS.topic}', 'INFO')
        self.repeated = self.awaited
        if not going or not self._begun:
            self._since = now
        elif gone or now - self._since > self._timeout:
            why = ': its publisher is gone' if gone else f' within {self._timeout:g} s'
            text = (f'lockstep: no command on {JOINT_COMMANDS.topic} with the stamp '
                    f'{self.awaited / 1e9:.9g} s{why}')
            if not self._holds:
                return f'stopped: {text}'
            tell(f'{text}; the last command is held', 'WARN')
            self._go_on()
        return ''

    def release(self) -> None:
        """End the wait."""
        self.awaited = None

    def _go_on(self) -> None:
        self.release()
        self.on_answer()
