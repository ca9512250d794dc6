# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with commanded positions beside joint states: arrays, joint states and trajectories."""

from bag_files import array, Message, state, write
from builtin_interfaces.msg import Duration
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning import read_motions, source_of
from hnn_vi_ros.phase_space import Coordinate
from messages import refused
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

NAMES = ['shoulder', 'elbow']
COORDINATES = [Coordinate(name, 'rad', 'kg m2/s') for name in NAMES]
T = 100.0 + 0.01 * np.arange(500)
# Steps every half second, which the joints follow late.
STEPS = T[30::50]
GOALS = 0.3 * np.random.default_rng(0).normal(size=(len(STEPS), 2))


def states() -> list[Message]:
    q, rows = np.zeros(2), []
    for time in T:
        at = np.searchsorted(STEPS, time, side='right') - 1
        q = q + 0.1 * ((GOALS[at] if at >= 0 else 0.0) - q)
        # In another order than the coordinates.
        rows.append(state(time, NAMES[::-1], q[::-1]))
    return rows


def trajectory(time: float, points: list[tuple], names=NAMES) -> Message:
    message = JointTrajectory(joint_names=names)
    for start, positions, velocities in points:
        seconds, rest = divmod(round(start * 1e9), 10**9)
        message.points.append(JointTrajectoryPoint(
            positions=[*positions], velocities=[*velocities],
            time_from_start=Duration(sec=seconds, nanosec=rest)))
    return ('/arm_controller/joint_trajectory', 'trajectory_msgs/msg/JointTrajectory', time,
            serialize_message(message))


def read(path):
    data = source_of(str(path), COORDINATES, commanded=True)
    motions, _ = read_motions(path, data, NAMES, [str(path)], ['rad', 'rad'], True)
    assert all(motion.commanded and motion.held for motion in motions)
    return motions[0]


def held(t: np.ndarray) -> np.ndarray:
    return GOALS[np.searchsorted(STEPS - T[0], t + 1e-6, side='right') - 1]


@pytest.mark.parametrize('kind', ['array', 'joint states', 'trajectory'])
def test_positions_commanded_beside_joint_states_are_read(tmp_path, kind):
    commands = {
        'array': array(STEPS, GOALS, '/position_controller/commands'),
        'joint states': [state(time, NAMES[::-1], row[::-1], topic='/leader/joint_commands')
                         for time, row in zip(STEPS, GOALS, strict=True)],
        'trajectory': [trajectory(time, [(0.0, row, [])]) for time, row in zip(
            STEPS, GOALS, strict=True)]}[kind]
    motion = read(write(tmp_path / 'bag.mcap', sorted(states() + commands, key=lambda m: m[2])))
    # Samples before the first command are left out.
    assert motion.t[0] == pytest.approx(STEPS[0] - T[0], abs=0.011)
    np.testing.assert_allclose(motion.tau, held(motion.t), atol=1e-12)


def test_trajectory_is_followed_along_its_splines_until_the_next(tmp_path):
    paths = [trajectory(STEPS[0], [(0.0, [0.0, 0.0], []), (1.0, [0.5, -0.5], [])]),
             trajectory(STEPS[0] + 0.5, [(1.0, [0.0, 1.0], [0.0, 0.0])])]
    motion = read(write(tmp_path / 'bag.mcap', sorted(states() + paths, key=lambda m: m[2])))
    t = motion.t - (STEPS[0] - T[0])
    first, second = (t > 0.0) & (t < 0.49), (t > 0.51) & (t < 1.49)
    # Each sample is held for at most 10 ms, in which the paths move by their slopes.
    np.testing.assert_allclose(motion.tau[first, 0], 0.5 * t[first], atol=0.011 * 0.5)
    x = t[second] - 0.5
    spline = 0.25 + (0.0 - 0.25) * (3.0 * x**2 - 2.0 * x**3)
    np.testing.assert_allclose(motion.tau[second, 0], spline, atol=0.011 * 0.5)
    np.testing.assert_allclose(motion.tau[t > 1.52], np.tile([0.0, 1.0], ((t > 1.52).sum(), 1)))


def test_topics_of_efforts_are_no_commands_and_two_of_positions_are_refused(tmp_path):
    efforts = array(STEPS, GOALS, '/forward_effort_controller/commands')
    path = write(tmp_path / 'a.mcap', sorted(states() + efforts, key=lambda m: m[2]))
    assert source_of(str(path), COORDINATES, commanded=True).command is None
    two = [*array(STEPS, GOALS, '/left/commands'), *array(STEPS, GOALS, '/right/commands')]
    path = write(tmp_path / 'b.mcap', sorted(states() + two, key=lambda m: m[2]))
    with refused(DataError):
        source_of(str(path), COORDINATES, commanded=True)
