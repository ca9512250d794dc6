# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of observations from machines: stamped by the ROS clock, and split by driver."""

from collections.abc import Callable, Sequence

from hnn_vi_ros.errors import listed
from hnn_vi_ros.run import nanoseconds, read_observation
import numpy as np
from sensor_msgs.msg import JointState

# Maximum time between the parts of one observation [ns].
_MAX_APART = 50_000_000


class ObservationJoiner:
    """
    Converter of a machine's messages to observations of all joints, stamped by one clock.

    If that clock is simulated, a stamp is read as simulated or as ROS time, whichever is nearer to
    it. A message with some of the joints is kept until other drivers have sent the others; older
    positions are then extrapolated with their velocities.

    Parameters
    ----------
    names : sequence of str
        Names of the observed joints.
    timeout : float
        Time after which missing joints raise ValueError [s].
    now : callable
        Returns the time of arrival on the simulated or the ROS clock [ns].
    ros : callable, optional
        Returns the ROS time [ns]; given only if `now` is simulated time.

    Attributes
    ----------
    joins : bool
        True if the last message with any of these joints lacked others: several drivers publish.

    """

    def __init__(self, names: Sequence[str], timeout: float, now: Callable[[], int],
                 ros: Callable[[], int] | None = None):
        self._names, self._timeout = names, round(timeout * 1e9)
        self._now, self._ros = now, ros
        # Time [ns], position and velocity by joint, received since the last complete observation.
        self._parts: dict[str, tuple[int, float, float]] = {}
        self._since, self.joins = 0, False

    def __call__(self, message: JointState) -> JointState | None:
        """Return the observation that a message completes; ValueError if a joint is missing."""
        stamp, now = nanoseconds(message.header.stamp), self._now()
        if self._ros and stamp and abs(stamp - (ros := self._ros())) < abs(stamp - now):
            # A stamp of zero would mean now.
            stamp = max(1, stamp - ros + now)
        there = [name for name in self._names if name in message.name]
        if not there:
            # A message of other joints only: its reader reports the missing ones.
            return _with_stamp(message, stamp)
        self.joins = len(there) < len(self._names)
        if not self.joins or len({*message.name}) < len(message.name):
            self._parts.clear()
            return _with_stamp(message, stamp)
        stamp, seen = stamp or now, read_observation(message, 0)
        if not self._parts or stamp < self._since:
            self._since = stamp
        for name in there:
            k = seen.names.index(name)
            self._parts[name] = stamp, seen.position[k], seen.velocity[k]
        stamps = [stamp for stamp, _, _ in self._parts.values()]
        apart = max(stamps) - min(stamps)
        if len(self._parts) < len(self._names) or apart > _MAX_APART:
            if stamp - self._since > self._timeout:
                missing = [name for name in self._names if name not in self._parts]
                raise ValueError(
                    f'joints {listed(there)} are observed without {listed(missing)}' if missing
                    else f'the parts of an observation are {apart / 1e9:.3g} s apart, but at most '
                         f'{_MAX_APART / 1e9:g} s can be joined; send all joints in one message, '
                         'or more often')
            return None
        times, positions, velocities = map(np.array, zip(
            *(self._parts[name] for name in self._names), strict=True))
        self._parts.clear()
        # An unknown velocity is NaN and counts as zero.
        positions += np.nan_to_num(velocities) * (times.max() - times) / 1e9
        return _with_stamp(JointState(
            name=[*self._names], position=positions, velocity=velocities), max(stamps))


def _with_stamp(message: JointState, stamp: int) -> JointState:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message
