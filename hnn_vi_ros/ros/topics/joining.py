# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Observations as machines send them: by the clock of ROS, and in parts."""

from collections.abc import Callable, Sequence

from hnn_vi_ros.errors import listed
from hnn_vi_ros.ros.plumbing.stamps import nanoseconds
from hnn_vi_ros.ros.topics.inputs import read_observation
import numpy as np
from sensor_msgs.msg import JointState

# Parts of an observation are at most so far apart in time [ns].
_APART = 50_000_000


class ObservationJoiner:
    """
    Turn the messages of a machine into observations of all joints, stamped by one clock.

    Where that is simulated, a stamp is its time or that of ROS, whichever is nearer. A message
    with some of the joints waits for the others, of other drivers; what is older then moves on at
    its velocity.

    Parameters
    ----------
    names : sequence of str
        The observed joints.
    timeout : float
        Time after which a joint is missed [s].
    now : callable
        Returns the time of arrival, the simulated one or that of ROS [ns].
    ros : callable, optional
        Returns that of ROS [ns], where the other one is simulated.

    Attributes
    ----------
    joins : bool
        Whether the last message with joints of these had some: several drivers publish them.

    """

    def __init__(self, names: Sequence[str], timeout: float, now: Callable[[], int],
                 ros: Callable[[], int] | None = None):
        self._names, self._timeout = names, round(timeout * 1e9)
        self._now, self._ros = now, ros
        # Time, position and velocity of each joint since the last observation of all.
        self._parts: dict[str, tuple[int, float, float]] = {}
        self._since, self.joins = 0, False

    def __call__(self, message: JointState) -> JointState | None:
        """Return the observation that a message completes; ValueError if a joint is missing."""
        stamp, now = nanoseconds(message.header.stamp), self._now()
        if self._ros and stamp and abs(stamp - (ros := self._ros())) < abs(stamp - now):
            # Zero would mean now.
            stamp = max(1, stamp - ros + now)
        there = [name for name in self._names if name in message.name]
        if not there:
            # Of other joints: whoever reads it says which are missing.
            return _stamped(message, stamp)
        self.joins = len(there) < len(self._names)
        if not self.joins or len({*message.name}) < len(message.name):
            self._parts.clear()
            return _stamped(message, stamp)
        stamp, seen = stamp or now, read_observation(message, 0)
        if not self._parts or stamp < self._since:
            self._since = stamp
        for name in there:
            k = seen.names.index(name)
            self._parts[name] = stamp, seen.position[k], seen.velocity[k]
        stamps = [stamp for stamp, _, _ in self._parts.values()]
        apart = max(stamps) - min(stamps)
        if len(self._parts) < len(self._names) or apart > _APART:
            if stamp - self._since > self._timeout:
                missing = [name for name in self._names if name not in self._parts]
                raise ValueError(
                    f'joints {listed(there)} are observed without {listed(missing)}' if missing
                    else f'parts of an observation are {apart / 1e9:.3g} s apart, at most '
                    f'{_APART / 1e9:g} s are joined; send all joints in one message, or more '
                    'often')
            return None
        times, positions, velocities = map(np.array, zip(
            *(self._parts[name] for name in self._names), strict=True))
        self._parts.clear()
        # An unknown velocity is NaN.
        positions += np.nan_to_num(velocities) * (times.max() - times) / 1e9
        return _stamped(JointState(name=[*self._names], position=positions, velocity=velocities),
                        max(stamps))


def _stamped(message: JointState, stamp: int) -> JointState:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message
