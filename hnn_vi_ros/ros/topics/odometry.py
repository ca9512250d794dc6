# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The poses and velocities of bodies that turn, as odometry."""

from collections.abc import Sequence

from hnn_vi_ros.phase_space import columns, Coordinate
from hnn_vi_ros.run.serialization import Template
from hnn_vi_ros.simulation.sample import Sample
from nav_msgs.msg import Odometry
import numpy as np


class OdometryEncoder:
    """
    Serialise one message for each body: its pose in space, its velocities in its own frame.

    As the definition of the message says: the pose is in ``header.frame_id``, the twist, linear
    and angular, in ``child_frame_id``, which is the name of the coordinate. Axes follow REP 103
    and REP 105. A body that turns about a point is in the origin. The state is exact: all
    covariances are zero.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        In the order of q.
    frame_id : str
        Frame of space.

    """

    def __init__(self, coordinates: Sequence[Coordinate], frame_id: str):
        q, p = columns(coordinates)
        # Message, first column of the place in q and in p or None, of the attitude in q and in p.
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
            # Behind the seven numbers of the pose stands its covariance.
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
    components: list[float] = (turn @ np.array(vector)).tolist()
    return components
