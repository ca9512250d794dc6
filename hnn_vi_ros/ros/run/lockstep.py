# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep with a controller: a run waits after its samples for the commands that answer them."""

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.settings import Settings

# Wall time after which the awaited state is published again for late subscribers [s].
REPEAT_PERIOD = 1.0


class Lockstep:
    """
    State of the wait for the command that answers a sample.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    every, step_size : int, float
        Number of steps between two samples, and the step size [s].

    Attributes
    ----------
    awaited : int or None
        Stamp of the sample whose answer is awaited [ns]; None while the run goes on.
    since : float
        Wall time at which the wait began [s].
    begun : bool
        True from the first answer on, before which the wait has no limit.
    repeated : int or None
        Stamp of the last sample that was published again, and may be answered again [ns].

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
        self.timeout = settings.lockstep_timeout
        self.holds = settings.on_lockstep_timeout == 'hold'
        self.awaited: int | None = None
        self.repeated: int | None = None
        self.since, self.begun = 0.0, False

    def wait(self, step: int, stamp: int, now: float) -> None:
        """Wait for the answer to a sample if a period ends with it."""
        if step % self._interval == 0:
            self.awaited, self.since = stamp, now

    def takes(self, stamp: int) -> bool:
        """
        Return whether a command with this stamp [ns] is the awaited answer.

        Another answer to a repeated sample is ignored; any other stamp raises ValueError.
        """
        if stamp not in (self.awaited, self.repeated):
            wanted = 'none is awaited' if self.awaited is None else (
                f'that of {self.awaited / 1e9:.9g} s is awaited')
            raise ValueError(f'lockstep: answers the state of {stamp / 1e9:.9g} s, but {wanted}; '
                             'stamp each command with the stamp of the state that it answers')
        self.begun = True
        return stamp == self.awaited

    def release(self) -> None:
        """Let the run go on."""
        self.awaited = None
