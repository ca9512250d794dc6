# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of bodies: odometry of rotating bodies, and markers of a mechanism."""

from collections.abc import Callable, Sequence
import time

from geometry_msgs.msg import Point
from hnn_vi_ros.hamiltonians import Ball, Cuboid, Line, Mechanism, Part, Trail
from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.recording import Sample, Template
from nav_msgs.msg import Odometry
import numpy as np
from visualization_msgs.msg import Marker, MarkerArray


class OdometryEncoder:
    """
    Encoder of odometry: for each body its pose in space and its velocities in its own frame.

    As the message definition requires, the pose is in ``header.frame_id``, and the twist, linear
    and angular, is in ``child_frame_id``, the name of the coordinate. Axes follow REP 103 and
    REP 105. A body that rotates about a fixed point is placed at the origin. All covariances are
    zero, because the state is exact.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Coordinates in the order of q.
    frame_id : str
        Fixed frame of space.

    """

    def __init__(self, coordinates: Sequence[Coordinate], frame_id: str):
        q, p = columns(coordinates)
        # Message; first columns of the position in q and p, or None, and of the attitude.
        self._bodies: list[tuple[Template, tuple[int, int] | None, int, int]] = []
        for coordinate in coordinates:
            if coordinate.kind == 'scalar':
                continue
            name, message = coordinate.name, Odometry(child_frame_id=coordinate.name)
            message.header.frame_id = frame_id
            message.pose.pose.orientation.w = 1.0
            place = (q.index(f'{name}_x'), p.index(f'{name}_x')) \
                if coordinate.kind == 'pose' else None
            self._bodies.append((Template(message), place, q.index(f'{name}_qx'),
                                 p.index(f'{name}_rx')))

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the serialised messages of a sample, in the order of the bodies."""
        payloads, velocities = [], sample.dH_dp.tolist()
        for template, place, turned, turning in self._bodies:
            quaternion = sample.q[turned:turned + 4].tolist()
            position, linear = [0.0] * 3, [0.0] * 3
            if place is not None:
                position = sample.q[place[0]:place[0] + 3].tolist()
                linear = _to_body(quaternion, velocities[place[1]:place[1] + 3])
            numbers = template.numbers
            # The covariance of the pose follows its seven numbers.
            for target, value in zip((*numbers[:7], *numbers[8:14]), (
                    *position, *quaternion, *linear, *velocities[turning:turning + 3]),
                    strict=True):
                target[0] = value
            template.set_stamp(sample.stamp)
            payloads.append(template.serialized())
        return payloads


def _to_body(quaternion: Sequence[float], vector: Sequence[float]) -> list[float]:
    """Return the components of a vector of space in the frame of a body."""
    x, y, z, w = quaternion
    turn = np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]])
    return (turn @ np.array(vector)).tolist()


# Wall time between two messages [s].
_MARKER_PERIOD = 1.0 / 30.0
# Maximum number of points of a trail.
_MAX_TRAIL_POINTS = 1000


class MarkerEncoder:
    """
    Encoder of the markers of a mechanism, active only while the topic has subscribers.

    Each part is one marker whose namespace is its name: a line strip, a cube or a sphere. A trail
    is the polyline of the positions at which it was published.

    Parameters
    ----------
    subscribers : callable
        Returns the number of subscribers.
    mechanism : callable
        Returns the parts to draw for q; see :mod:`hnn_vi_ros.hamiltonians.mechanisms`.
    reach : float
        Largest coordinate that fits into the drawing.
    frame_id : str
        Frame of the markers.

    """

    def __init__(self, subscribers: Callable[[], int], mechanism: Mechanism, reach: float,
                 frame_id: str):
        self._subscribers, self._mechanism, self._reach = subscribers, mechanism, reach
        self._frame_id = frame_id
        self._due, self._newest = 0.0, 0
        self._markers: dict[str, Marker] = {}

    def encode(self, sample: Sample) -> list[MarkerArray]:
        """Return the message of a sample if it is due and the topic has subscribers."""
        now = time.monotonic()
        if now < self._due:
            return []
        self._due = now + _MARKER_PERIOD
        return [self._message(sample)] if self._subscribers() else []

    def _message(self, sample: Sample) -> MarkerArray:
        parts = self._mechanism(sample.q[None], self._reach)
        if not self._markers or sample.stamp < self._newest:
            # A trail must not connect one run to the next.
            self._markers = {name: _marker(name, self._frame_id, part)
                             for name, part in parts.items()}
        self._newest = sample.stamp
        sec, nanosec = divmod(sample.stamp, 10**9)
        for name, part in parts.items():
            marker = self._markers[name]
            marker.header.stamp.sec, marker.header.stamp.nanosec = sec, nanosec
            if part.moves:
                _place(marker, part)
        return MarkerArray(markers=list(self._markers.values()))


def _marker(name: str, frame_id: str, part: Part) -> Marker:
    """Return the marker of a part at its current place."""
    marker = Marker(ns=name, id=0, action=Marker.ADD)
    marker.header.frame_id = frame_id
    marker.pose.orientation.w = 1.0
    color = marker.color
    color.r, color.g, color.b = (channel / 255.0 for channel in part.color)
    color.a = 1.0
    if isinstance(part, (Line, Trail)):
        marker.type = Marker.LINE_STRIP
        marker.scale.x = 2.0 * part.radius
        if isinstance(part, Line):
            marker.points = [Point() for _ in range(part.points.shape[-2])]
    else:
        marker.type = Marker.SPHERE if isinstance(part, Ball) else Marker.CUBE
        half_sizes = 3 * (part.radius,) if isinstance(part, Ball) else part.half_size
        scale = marker.scale
        scale.x, scale.y, scale.z = (2.0 * float(half) for half in half_sizes)
    _place(marker, part)
    return marker


def _place(marker: Marker, part: Part) -> None:
    if isinstance(part, (Ball, Cuboid)):
        _set(marker.pose.position, part.center.reshape(3))
        return
    if isinstance(part, Trail):
        marker.points = [*marker.points[-_MAX_TRAIL_POINTS:], Point()]
        _set(marker.points[-1], part.point.reshape(3))
        return
    for point, place in zip(marker.points, part.points.reshape(-1, 3), strict=True):
        _set(point, place)


def _set(point: Point, place: np.ndarray) -> None:
    point.x, point.y, point.z = place.tolist()
