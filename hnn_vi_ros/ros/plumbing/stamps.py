# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Time stamps of messages from outside: checked once, and in the order in which they count."""

from collections.abc import Callable
from typing import Any

# The last time that a stamp can hold [ns].
LATEST = 2**31 * 10**9 - 1


def nanoseconds(time: Any) -> int:
    """Return a time or a duration of ROS [ns]; ValueError if it is negative or not normalised."""
    if time.sec < 0 or time.nanosec >= 10**9:
        raise ValueError(f'a time of {time.sec} s and {time.nanosec} ns: expected at least 0 s '
                         'and less than 10^9 ns')
    return int(time.sec * 10**9 + time.nanosec)


class Stamps:
    """
    Times of the messages of one source, which rise.

    A zero stamp is time 0 if it comes first; after any other message it means the time of arrival.

    Parameters
    ----------
    now : callable
        Returns the time of arrival [ns].

    """

    def __init__(self, now: Callable[[], int]):
        self._now = now
        self.reset()

    def reset(self) -> None:
        """Accept any time next."""
        self._newest, self._accepted = -1, -1

    def settle(self, paused: bool) -> None:
        """
        Go on without an accepted message for long: clocks may have been set back.

        The next time must be later than that of the newest message, or only differ from it after
        a pause in which no message has come.
        """
        self._accepted = -1 if paused else self._newest

    def accept(self, stamp: int) -> int:
        """Return the time of a message [ns]; ValueError unless it is later than the last one."""
        arrived = stamp == 0 and self._newest >= 0
        if arrived:
            stamp = self._now()
        last = max(self._accepted, self._newest if stamp == self._newest else -1)
        self._newest = stamp
        if stamp <= last and arrived:
            raise ValueError(f'it has no stamp, and the clock of ROS stands at {stamp / 1e9:.9g} '
                             's: publish /clock, or set use_sim_time to false')
        if stamp <= last:
            raise ValueError(f'its stamp, {stamp / 1e9:.9g} s, is not later than that of an '
                             f'earlier message, {last / 1e9:.9g} s: stamp each message with its '
                             'time, or with zero')
        self._accepted = stamp
        return stamp
