# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The mechanism of a scene as markers, for RViz and whoever else shows them."""

from collections.abc import Callable
import time

from geometry_msgs.msg import Point
from hnn_vi_ros.mechanisms.parts import Ball, Box, Line, Mechanism, Part, Trail
from hnn_vi_ros.simulation.sample import Sample
import numpy as np
from visualization_msgs.msg import Marker, MarkerArray

# Wall time from one message to the next [s].
_PERIOD = 1.0 / 30.0
# Points of a trail.
_LONGEST = 1000


class MarkerEncoder:
    """
    Make markers of a mechanism while somebody subscribes; otherwise build nothing.

    Each part is one marker whose namespace is its name: a line strip, a cube or a sphere. A trail
    is the line of the places at which it was published.

    Parameters
    ----------
    subscribers : callable
        Returns their number.
    mechanism : callable
        What to draw for q; see :mod:`hnn_vi_ros.mechanisms`.
    reach : float
        Largest coordinate that the drawing leaves room for.
    frame_id : str
        Frame that the markers are drawn in.

    """

    def __init__(self, subscribers: Callable[[], int], mechanism: Mechanism, reach: float,
                 frame_id: str):
        self._subscribers, self._mechanism, self._reach = subscribers, mechanism, reach
        self._frame_id = frame_id
        self._due, self._newest = 0.0, 0
        self._markers: dict[str, Marker] = {}

    def encode(self, sample: Sample) -> list[MarkerArray]:
        """Return the message of a sample, if it is time to and somebody listens."""
        now = time.monotonic()
        if now < self._due:
            return []
        self._due = now + _PERIOD
        return [self._message(sample)] if self._subscribers() else []

    def _message(self, sample: Sample) -> MarkerArray:
        parts = self._mechanism(sample.q[None], self._reach)
        if not self._markers or sample.stamp < self._newest:
            # A trail does not lead from one run to another.
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
    """Return the marker of a part at its place."""
    marker = Marker(ns=name, id=0, action=Marker.ADD)
    marker.header.frame_id = frame_id
    marker.pose.orientation.w = 1.0
    color = marker.color
    color.r, color.g, color.b = (channel / 255.0 for channel in part.color)
    color.a = 1.0
    if isinstance(part, Line):
        marker.type = Marker.LINE_STRIP
        marker.scale.x = 2.0 * part.radius
        marker.points = [Point() for _ in range(part.points.shape[-2])]
    elif isinstance(part, Trail):
        marker.type = Marker.LINE_STRIP
        marker.scale.x = 2.0 * part.radius
    else:
        marker.type = Marker.SPHERE if isinstance(part, Ball) else Marker.CUBE
        half_sizes = 3 * (part.radius,) if isinstance(part, Ball) else part.half_size
        scale = marker.scale
        scale.x, scale.y, scale.z = (2.0 * float(half) for half in half_sizes)
    _place(marker, part)
    return marker


def _place(marker: Marker, part: Part) -> None:
    if isinstance(part, (Ball, Box)):
        _set(marker.pose.position, part.center.reshape(3))
        return
    if isinstance(part, Trail):
        marker.points = [*marker.points[-_LONGEST:], Point()]
        _set(marker.points[-1], part.point.reshape(3))
        return
    for point, place in zip(marker.points, part.points.reshape(-1, 3), strict=True):
        _set(point, place)


def _set(point: Point, place: np.ndarray) -> None:
    point.x, point.y, point.z = place.tolist()
