# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulator tells of an ensemble and a machine, and makes of bad observations."""

from collections.abc import Iterator
from pathlib import Path
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from ensembles import ensemble
from hnn_vi_ros.models import save_checkpoint
from hnn_vi_ros.run.recorded_run import RecordedRun
from hnn_vi_ros.ros.topics import companions
from hnn_vi_ros.ros.topics.companions import TwinTopic
from hnn_vi_ros.ros.topics.diagnostics import OK, WARN
from hnn_vi_ros.run import read_observation
from hnn_vi_ros.ros.topics.joining import ObservationJoiner
from hnn_vi_ros.run import Report
from messages import refused
import numpy as np
from peer import simulating, SIMULATOR, stamp
from processes import read_bag, standard_error
import pytest
from rclpy.qos import qos_profile_sensor_data
from recorded import assert_agrees
from scene_files import write_scene
from sensor_msgs.msg import JointState

NAN = float('nan')


def observation(position: list[float], names: tuple[str, ...] = ('x0',), at: int = 0,
                **lists: list[float]) -> JointState:
    message = JointState(name=list(names), position=position, **lists)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, 10**9)
    return message


def test_observation_of_a_message_is_now_or_at_its_stamp():
    found = read_observation(observation([1.0, 2.0], ('a', 'b'), at=3 * 10**9), 4 * 10**9)
    assert (found.names, found.delay) == (('a', 'b'), -1.0)
    assert found.position.tolist() == [1.0, 2.0] and np.isnan(found.velocity).all()
    assert read_observation(observation([1.0], velocity=[0.5]), 4 * 10**9).delay == 0.0
    with refused(ValueError):
        read_observation(observation([1.0, 2.0]), 0)


SECOND = 10**9


@pytest.mark.parametrize(('ros', 'at', 'expected'), [
    (1_700_000_000.0, 1_699_999_999.98, 4.98), (105.0, 104.98, 4.98), (1_700_000_000.0, 4.9, 4.9),
    (105.0, 4.9, 4.9), (105.0, 0.0, 0.0), (1_700_000_000.0, 1_699_999_990.0, 1e-9)],
    ids=['epoch', 'clock that began before', 'simulated', 'simulated beside a clock', 'now',
         'long ago'])
def test_observation_is_stamped_by_simulated_time_or_by_that_of_ros(
        ros: float, at: float, expected: float):
    join = ObservationJoiner(['x0'], 0.5, lambda: 5 * SECOND, lambda: round(ros * SECOND))
    # A float of seconds since the epoch has 0.24 us.
    assert stamp(join(observation([1.0], at=round(at * SECOND)))) / SECOND == pytest.approx(
        expected, abs=5e-7)


def test_parts_of_an_observation_are_joined_by_name_within_a_tolerance():
    now = [5 * SECOND]
    join = ObservationJoiner(['a', 'b'], 0.5, lambda: now[0], lambda: 0)
    whole = observation([1.0, 2.0], ('b', 'a'), at=SECOND)
    assert join(whole) is whole and not join.joins
    assert join(observation([1.0, 9.0], ('a', 'grip'), velocity=[0.5, 0.0], at=4 * SECOND)) is None
    # One of other joints, which whoever reads it refuses, is none of the parts.
    assert join(other := observation([7.0], ('grip',), at=4 * SECOND)) is other
    found = join(observation([2.0], ('b',), at=4 * SECOND + 20_000_000))
    assert join.joins
    assert (found.name, stamp(found)) == (['a', 'b'], 4 * SECOND + 20_000_000)
    # What is older has moved on since.
    assert found.position.tolist() == [1.0 + 0.5 * 0.02, 2.0]
    assert found.velocity[0] == 0.5 and np.isnan(found.velocity[1])
    twice = observation([1.0, 2.0], ('a', 'a'))
    assert join(twice) is twice
    # Without stamps, by their arrival; each part counts once.
    assert join(observation([1.0], ('a',))) is None and join(observation([1.5], ('a',))) is None
    assert join(observation([2.0], ('b',))).position.tolist() == [1.5, 2.0]
    assert join(observation([1.0], ('a',))) is None
    now[0] += SECOND
    with refused(ValueError):
        join(observation([1.0], ('a',)))
    with refused(ValueError):
        join(observation([2.0], ('b',), at=5 * SECOND + 600_000_000))


def test_twin_without_observations_for_its_time_out_is_a_warning_once(
        monkeypatch: pytest.MonkeyPatch):
    now, warned, wall = [SECOND], [], [0.0]
    monkeypatch.setattr(companions, 'time', SimpleNamespace(monotonic=lambda: wall[0]))
    twin = SimpleNamespace(names=['x0'], newest=None, timeout=0.5, times=[], failed=0, outside=0.0,
                           valid_prediction_time=np.nan, valid_time=lambda outside: np.nan)
    topic = TwinTopic(twin, lambda *message: None, lambda: (0, ''), lambda: now[0], warned.append)
    assert topic.status()[1:3] == (WARN, 'no observation yet')
    twin.newest = Report(0.0, np.zeros(1), np.zeros(1), 0.0, 0.0)
    for _ in range(2):
        twin.heard(twin.newest)
        assert topic.status()[1:3] == (OK, 'follows the machine')
        now[0] += SECOND
        for _ in range(2):
            assert topic.status()[1:3] == (WARN, 'no observation for 1 s')
    assert warned == ['~/observations: no observation for 1 s: the simulation continues without '
                      'observations'] * 2
    # The clock that paces it may stand still as well.
    twin.heard(twin.newest)
    wall[0] += 6.0
    assert topic.status()[1:3] == (WARN, 'no observation for 6 s')


def test_simulator_tells_its_spread_and_how_it_follows_and_survives_bad_observations(
        tmp_path: Path):
    save_checkpoint(tmp_path / 'several.safetensors', ensemble(3))
    write_scene(tmp_path / 'scene.yaml', 'learned, model: several.safetensors', (
        '{kind: observer, coordinates: [x0], gain: 5.0, damping: 4.0, deviations: [0.1]}'),
        'implicit_midpoint', q=[0.3], p=[-0.2], more='uncertainty: {limit: 1.0e-6}\n')
    with simulating(tmp_path, scene='scene.yaml', record_path='bag', rerun_path='run.rrd') as (
            other, process):
        node = other.node
        machine = other.publisher(JointState, '~/observations', qos_profile_sensor_data)
        second = other.publisher(JointState, '~/observations')
        spreads = other.hear(JointState, '~/uncertainty')
        errors = other.hear(JointState, '~/prediction_error')
        told = other.hear(DiagnosticArray, '/diagnostics')
        other.spin_until(lambda: other.states and spreads and machine.get_subscription_count()
                         and node.count_publishers(f'{SIMULATOR}/prediction_error'))
        for k in range(20):
            count = len(errors)
            machine.publish(observation([0.2 + 0.001 * k, 7.0], ('x0', 'gripper')))
            other.spin_until(lambda count=count: len(errors) > count)
        for bad in (observation([NAN]), observation([0.1, 0.2]), observation([0.1], ('x1',)),
                    observation([0.1], ('x0',), at=10**18), observation([], ())):
            machine.publish(bad)
            other.spin(0.05)

        def ignored() -> int:
            values = {value.key: value.value for message in told for status in message.status
                      if status.name.endswith(': twin') for value in status.values}
            return int(values.get('ignored observations [1]', 0))
        # Before the flood, which would push them out of the queue of a node that is busy.
        other.spin_until(lambda: ignored() == 5)
        for k in range(500):  # of a flood some are dropped, and none is a reason to stop
            machine.publish(observation([0.2], velocity=[0.0]))
        other.spin_until(lambda: 'observations has 2 publishers' in standard_error(process))
        node.destroy_publisher(second)
        count = len(other.states)
        other.spin_until(lambda: len(other.states) > count + 20)
        assert ignored() == 5
    error = standard_error(process)
    assert '~/observations: message ignored' in error
    assert list(spreads[-1].name) == ['x0', 'p_x0'] and min(spreads[-1].position) > 0.0
    assert list(errors[0].name) == [
        'x0', 'prediction_x0', 'normalised_error', 'running_prediction_time',
        'valid_prediction_time']
    # The first observation: nothing is predicted before it.
    assert np.isnan(errors[0].position[1]) and np.isfinite(errors[-1].position[0])
    names = {status.name.rpartition(': ')[2] for message in told for status in message.status}
    assert {'twin', 'uncertainty'} <= names
    # It comes with the first sample, when nobody need listen yet.
    assert 'the members of the ensemble differ' in error
    assert_agrees(tmp_path / 'bag')
    check_bag(tmp_path / 'bag')


def absurd(rng: np.random.Generator) -> Iterator[JointState]:
    """Yield what no machine sends: far away, fast, of other joints, at other times."""
    names = ('angle1', 'angle2')
    for size in (1e9, -1e9, 1e300, 1e4, 30.0):
        yield observation([size, size], names)
        yield observation(rng.uniform(-abs(size), abs(size), 2).tolist(), names)
        yield observation([0.3, -0.2], names, velocity=[size, -size])
        yield observation([0.3, size], ('angle1', 'angle3'))
        yield observation([0.3, -0.2], names, at=int(rng.integers(2**31)) * 10**9)
        yield observation([0.3, -0.2], names, at=-10**9)


def test_twin_goes_on_after_absurd_observations_and_its_bag_is_verified(tmp_path: Path):
    write_scene(tmp_path / 'scene.yaml', 'double_pendulum', (
        '{kind: observer, coordinates: [angle1, angle2], gain: 300, damping: 20, '
        'velocity_limit: 20}'), 'implicit_midpoint', 0.005, [0.3, -0.2], [0.0, 0.0])
    right, rng = observation([0.3, -0.2], ('angle1', 'angle2')), np.random.default_rng(2)
    with simulating(tmp_path, scene='scene.yaml', record_path='bag') as (other, process):
        machine = other.publisher(JointState, '~/observations', qos_profile_sensor_data)
        told = other.hear(DiagnosticArray, '/diagnostics')
        other.spin_until(lambda: other.states and machine.get_subscription_count())
        for _ in range(3):
            for wrong in absurd(rng):
                machine.publish(wrong)
                other.spin(0.03)
            count = len(other.states)

            def is_back(count: int = count) -> bool:
                # By two drivers, whose clock is that of the machine.
                for part, name in zip(right.position, right.name, strict=True):
                    machine.publish(observation([part], (name,), at=time.time_ns()))
                other.spin(0.02)
                # As far off as gravity, of some 20 N m, takes a spring of 300 N m/rad, and turns.
                return len(other.states) > count + 20 and np.abs(np.angle(np.exp(1j * np.subtract(
                    other.states[-1].position, right.position)))).max() < 0.2
            other.spin_until(is_back)

        def is_told() -> bool:
            # Almost half a turn apart, too fast in whatever direction. Best effort: some are lost.
            for angle in (0.0, 3.0):
                machine.publish(observation([angle, angle], ('angle1', 'angle2')))
            other.spin(0.02)
            return any(
                value.key == 'last ignored' and 'velocity_limit = 20' in value.value
                for message in told for status in message.status for value in status.values)
        other.spin_until(is_told)
    assert 'at the last good state' not in standard_error(process)
    assert_agrees(tmp_path / 'bag')


def check_bag(bag: Path) -> None:
    """Assert that observations, errors and the spread are in the bag as they were."""
    topics = read_bag(bag)
    commands = list(RecordedRun(bag).commands())
    observed = topics[f'{SIMULATOR}/observations']
    assert len(commands) == len(observed) >= 20
    assert len(topics[f'{SIMULATOR}/prediction_error']) == len(observed)
    states = dict(topics[f'{SIMULATOR}/state'])
    time, first = topics[f'{SIMULATOR}/prediction_error'][0]
    if time in states:
        q = states[time].position[0]
        assert first.position[0] == observed[0][1].position[0] - q
    spread = topics[f'{SIMULATOR}/uncertainty']
    assert [time for time, _ in spread] == [*states]
    assert all(stamp(message) == time for time, message in spread)
