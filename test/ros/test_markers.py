# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The mechanism as markers: nothing without a subscriber, every part with one."""

from collections.abc import Iterator
import time

from hnn_vi_ros.hamiltonians import Ball, Cuboid, MECHANISMS, Trail
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.topics.poses import MarkerEncoder
import numpy as np
from peer import nodes_of
import pytest
from rclpy.executors import SingleThreadedExecutor
from visualization_msgs.msg import Marker, MarkerArray

STATES = {'bouncing_mass': [0.3], 'cartesian_pendulum': [0.6, -0.8],
          'charged_particle': [0.2, 0.1], 'double_pendulum': [1.0, -2.0],
          'henon_heiles': [0.1, 0.2], 'kepler': [0.5, 0.5], 'mass_spring': [-0.4],
          'pendulum': [2.0], 'spring_chain': [0.3, -0.2, 0.1, 0.05],
          'turning_body': [0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5]}


def sample_of(q: list[float], stamp: int = 0) -> Sample:
    array = np.array(q)
    return Sample(0, stamp, array, array, array, array, 0.0, 0.0, 0.0)


def test_markers_are_not_built_without_a_subscriber():
    def mechanism(q: np.ndarray, reach: float) -> dict:
        raise AssertionError('the mechanism was drawn')
    markers = MarkerEncoder(lambda: 0, mechanism, 1.0, 'world')
    for stamp in range(100):
        assert not markers.encode(sample_of([0.0], stamp))
        markers._due = 0.0


def test_markers_come_at_most_30_times_a_second():
    markers, count = MarkerEncoder(lambda: 1, MECHANISMS['pendulum'], 1.0, 'world'), 0
    begin = time.monotonic()
    while time.monotonic() < begin + 0.5:
        count += len(markers.encode(sample_of([0.0])))
    # Half a second has room for 15 after the first, what a busy machine adds for more.
    assert 1 < count <= 1 + 30.0 * (time.monotonic() - begin)


@pytest.fixture
def executor() -> Iterator[SingleThreadedExecutor]:
    with nodes_of('markers_test') as (_, executor):
        yield executor


def check_geometry(marker: Marker, part) -> None:
    color = marker.color
    # Colours are float32 in the message.
    np.testing.assert_allclose([color.r, color.g, color.b, color.a],
                               [*np.array(part.color) / 255.0, 1.0], rtol=1e-7)
    if isinstance(part, (Cuboid, Ball)):
        kind, halves = (Marker.CUBE, part.half_size) if isinstance(part, Cuboid) else (
            Marker.SPHERE, [part.radius] * 3)
        place, scale = marker.pose.position, marker.scale
        assert (marker.type, [place.x, place.y, place.z]) == (kind, part.center.tolist())
        assert [scale.x, scale.y, scale.z] == [2.0 * half for half in halves]
    else:
        assert marker.type == Marker.LINE_STRIP
        assert marker.scale.x == 2.0 * part.radius
        points = [[p.x, p.y, p.z] for p in marker.points]
        if isinstance(part, Trail):
            assert len(points) >= 2 and points[-1] == part.point.tolist()
        else:
            assert points == part.points.tolist()
        assert marker.pose.position.x == marker.pose.position.z == 0.0
    assert (marker.pose.orientation.w, marker.id, marker.action) == (1.0, 0, Marker.ADD)


@pytest.mark.parametrize('name', MECHANISMS)
def test_markers_reach_a_subscriber_with_the_geometry_of_every_part(name: str, executor):
    node, = executor.get_nodes()
    received: list[MarkerArray] = []
    publisher = node.create_publisher(MarkerArray, 'markers', 1)
    node.create_subscription(MarkerArray, 'markers', received.append, 10)
    markers = MarkerEncoder(publisher.get_subscription_count, MECHANISMS[name], 0.7, 'map')
    # The second message is made of the first, with the moving parts at other places.
    for second, q in enumerate([np.array(STATES[name]), -0.5 * np.array(STATES[name])]):
        deadline = time.monotonic() + 60.0
        while not received or received[-1].markers[0].header.stamp.sec != second:
            assert time.monotonic() < deadline, 'no markers came'
            for message in markers.encode(sample_of(q, second * 10**9 + 5)):
                publisher.publish(message)
            executor.spin_once(timeout_sec=0.04)
        message = received[-1]
        parts = MECHANISMS[name](q, 0.7)
        assert [marker.ns for marker in message.markers] == list(parts)
        for marker in message.markers:
            assert marker.header.frame_id == 'map'
            stamp = marker.header.stamp
            assert (stamp.sec, stamp.nanosec) == (second, 5)
            check_geometry(marker, parts[marker.ns])


def test_trail_grows_to_its_length_and_begins_anew_with_the_run():
    markers = MarkerEncoder(lambda: 1, MECHANISMS['turning_body'], 1.0, 'map')

    def trail(x: float, stamp: int) -> list[float]:
        markers._due = 0.0
        message, = markers.encode(sample_of([x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], stamp))
        found, = (marker for marker in message.markers if marker.ns == 'path')
        return [point.x for point in found.points]
    assert [trail(float(i), i + 1) for i in range(3)] == [
        [0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 2.0]]
    for i in range(3, 1005):
        newest = trail(float(i), i + 1)
    assert len(newest) == 1001 and newest[-2:] == [1003.0, 1004.0]
    assert trail(7.0, 1) == [7.0, 7.0]
