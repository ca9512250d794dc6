# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the time stamps of incoming messages: validity and order."""

from collections.abc import Callable

# The latest time that a stamp can hold [ns].
LATEST = 2**31 * 10**9 - 1


class Stamps:
    """
    A check that the times of the messages of one source increase.

    A stamp of zero means time 0 in the first message, and the time of arrival in later ones.

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
        Relax the check after a long time without an accepted message: clocks may go back.

        The next time must then be later than that of the newest message. After a pause without any
        message it must only differ from it.
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
            raise ValueError('it has no stamp, and the ROS clock does not advance from '
                             f'{stamp / 1e9:.9g} s: publish /clock, or set use_sim_time to false')
        if stamp <= last:
            raise ValueError(f'its stamp, {stamp / 1e9:.9g} s, is not later than that of an '
                             f'earlier message, {last / 1e9:.9g} s: stamp each message with its '
                             'time, or with zero')
        self._accepted = stamp
        return stamp
