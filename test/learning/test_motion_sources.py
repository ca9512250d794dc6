# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions as robots give them: what is bad is left out, told, and never learned from."""

from collections.abc import Sequence
from pathlib import Path

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.arrays import ArraysData, read_arrays
from hnn_vi_ros.learning.data.bags import BagMotions, read_bag_motions
from hnn_vi_ros.learning.data.sources import guessed, read_motions
from hnn_vi_ros.learning.data.text import LogMotions, read_log_motions
from hnn_vi_ros.learning.fit.config import MachineConfig
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from test_bag_data import array, JOINTS, Message, write

OMEGA = 2.0
T = 0.01 * np.arange(1, 401)
Q = np.stack([np.sin(OMEGA * T), np.cos(3.0 * T)], axis=-1)
V = np.stack([OMEGA * np.cos(OMEGA * T), -3.0 * np.sin(3.0 * T)], axis=-1)
TAU = np.stack([0.1 * T, np.ones_like(T)], axis=-1)


def state(time: float, names: Sequence[str], q: Sequence[float], v: Sequence[float] = (),
          tau: Sequence[float] = ()) -> Message:
    message = JointState(name=list(names), position=list(q), velocity=list(v), effort=list(tau))
    message.header.stamp.sec, nanoseconds = divmod(round(time * 1e9), 10**9)
    message.header.stamp.nanosec = nanoseconds
    return '/joint_states', JOINTS, time, serialize_message(message)


def driver(rows: Sequence[int] = range(len(T))) -> list[Message]:
    """Return what a driver publishes, with another joint and in another order."""
    return [state(T[i], ['b', 'gripper', 'a'], [Q[i, 1], 7.0, Q[i, 0]], [V[i, 1], 0.0, V[i, 0]],
                  [TAU[i, 1], 0.0, TAU[i, 0]]) for i in rows]


def read(path: Path, **changes) -> tuple:
    return read_bag_motions([path], BagMotions(**changes), ['a', 'b'])


def test_joints_of_a_bag_are_found_by_name_in_any_order(tmp_path):
    (motion,), description = read(write(tmp_path / 'a.mcap', driver()))
    assert np.abs(motion.q - Q).max() < 1e-9  # stamps are whole nanoseconds
    assert np.abs(motion.v - V).max() < 1e-7
    assert np.abs(motion.tau - TAU).max() < 1e-7
    assert 'left out' not in description and '400 samples' in description


def test_bad_messages_are_left_out_counted_and_bridged(tmp_path):
    messages = driver()
    messages[50] = state(T[50], ['a'], [Q[50, 0]], [V[50, 0]], [TAU[50, 0]])
    messages[60] = state(T[60], ['a', 'b'], [np.nan, 0.0], V[60], TAU[60])
    messages[70] = state(T[70], ['a', 'b'], Q[70], [], TAU[70])
    twice = state(T[79], ['a', 'b'], Q[79], V[79], TAU[79])
    messages[80] = (*twice[:2], T[80], twice[3])
    late = state(T[20], ['a', 'b'], Q[20], V[20], TAU[20])
    messages[90] = (*late[:2], T[90], late[3])
    del messages[100:104]
    messages.insert(200, state(1.0, ['gripper'], [1.0]))
    path = write(tmp_path / 'a.mcap', messages)
    (motion,), description = read(path)
    assert '3 that lack a number and 2 that are late or come twice' in description
    # Cubics through q and dq over intervals of at most 0.05 s: h^4 / 384 times 3^4.
    assert np.abs(motion.q - Q).max() < 0.05**4 / 384.0 * 3.0**4 + 1e-9
    parts, description = read(path, on_bad='split')
    # Of the pieces two are long enough.
    assert len(parts) == 2 and 'cut at' in description
    assert all(np.abs(np.diff(part.t) - 0.01).max() < 1e-9 for part in parts)
    with pytest.raises(DataError, match='sample 51 lacks a number'):
        read(path, on_bad='fail')


def test_gap_begins_a_new_motion(tmp_path):
    path = write(tmp_path / 'a.mcap', driver([*range(150), *range(200, 400)]))
    first, second = read(path)[0]
    assert (len(first.t), len(second.t)) == (150, 200)
    assert [motion.name for motion in (first, second)] == ['a#0', 'a#1']
    with pytest.raises(DataError, match='0.51 s without a sample'):
        read(path, on_bad='fail')


def test_velocities_that_are_not_published_are_estimated_and_efforts_are_none(tmp_path):
    messages = [state(T[i], ['a', 'b'], Q[i], [np.nan, np.nan]) for i in range(len(T))]
    (motion,), description = read(write(tmp_path / 'a.mcap', messages))
    assert 'velocities estimated' in description
    assert not motion.tau.any()
    # Of the filter, flat to (f / 40 Hz)^4 at 0.5 Hz, and central differences: h^2 / 6 times 3^3.
    inner = slice(40, -40)
    assert np.abs(motion.v - V)[inner].max() < 0.01**2 / 6.0 * 27.0 + 1e-5


def test_commands_are_the_forces_where_they_are_named(tmp_path):
    commands = array(np.array([1.005, 2.005]), np.array([[1.0, 2.0], [3.0, 4.0]]), '/forces')
    path = write(tmp_path / 'a.mcap', sorted([*driver(), *commands], key=lambda item: item[2]))
    (motion,), _ = read(path, forces='forces')
    t = motion.t + T[0]
    assert not motion.tau[t < 0.995].any()
    assert (motion.tau[(t > 1.015) & (t < 1.995)] == [1.0, 2.0]).all()
    assert (motion.tau[t > 2.015] == [3.0, 4.0]).all()
    assert np.array_equal(motion.forces, motion.tau[:-1])
    (motion,), _ = read(path, forces='forces', inputs='interpolated')
    assert np.array_equal(motion.forces, 0.5 * (motion.tau[:-1] + motion.tau[1:]))
    # Of one motor that moves both joints.
    one = array(np.array([1.005]), np.array([[1.0]]), '/motor')
    path = write(tmp_path / 'one.mcap', sorted([*driver(), *one], key=lambda item: item[2]))
    (motion,), _ = read(path, forces='motor')
    assert motion.tau.shape == (len(motion.t), 1)
    assert (motion.tau[motion.t + T[0] > 1.015] == 1.0).all()
    wide = array(np.array([1.0]), np.array([[1.0, 2.0, 3.0]]), '/forces')
    with pytest.raises(DataError, match='3 numbers for 2 coordinates'):
        read(write(tmp_path / 'b.mcap', [*driver(), *wide]), forces='forces')


@pytest.mark.parametrize('changes, message', [
    ({'topic': 'nothing'}, 'holds no topic /nothing; it holds: /joint_states'),
    ({'joints': ['a', 'c']}, "no joint 'c'; its joints: a, b, gripper"),
    ({'joints': ['a']}, '1 joints for 2 coordinates'),
    ({'forces': 'nothing'}, 'holds no topic /nothing'),
])
def test_bag_without_what_is_wanted_says_what_it_holds(tmp_path, changes, message):
    with pytest.raises(DataError, match=message) as problem:
        read(write(tmp_path / 'a.mcap', driver()), **changes)
    assert '\n' not in str(problem.value)


def test_bag_in_which_no_message_holds_all_joints_is_refused(tmp_path):
    messages = [state(T[i] + 0.001 * j, ['ab'[j]], [Q[i, j]], [V[i, j]])
                for i in range(len(T)) for j in range(2)]
    with pytest.raises(DataError, match='800 lack a number of q'):
        read(write(tmp_path / 'a.mcap', messages))


def test_arrays_that_lack_numbers_are_read_without_them(tmp_path):
    q, dq = Q.copy(), np.full_like(V, np.nan)
    q[10], q[200, 1] = np.nan, np.inf
    np.savez(tmp_path / 'a.npz', t=T, q=q, dq=dq, tau=TAU)
    (motion,), description = read_arrays(tmp_path / 'a.npz', ArraysData(), 2)
    assert '2 that lack a number' in description and 'velocities estimated' in description
    assert np.abs(motion.q - Q).max() < 1e-6  # cubic splines over 0.02 s: 0.02^4 3^4 5 / 384


LOG = {'delimiter': 'comma', 'columns': ['run', 't', 'a', 'b', 'ta', 'tb'], 'trial': 'run',
       'time': 't', 'q': ['a', 'b'], 'tau': ['ta', 'tb']}


def test_log_of_positions_and_torques_is_read_run_by_run(tmp_path):
    lines = ['run,t,a,b,ta,tb']
    for number in (1, 2):
        for i in range(len(T)):
            a = '' if (number, i) == (1, 30) else f'{Q[i, 0]:.12f}'
            lines.append(f'{number},{T[i]:.6f},{a},{Q[i, 1]:.12f},{TAU[i, 0]},{TAU[i, 1]}')
    (tmp_path / 'log.csv').write_text('\n'.join(lines))
    motions, description = read_log_motions(tmp_path / 'log.csv', LogMotions(**LOG))
    assert [motion.name for motion in motions] == ['1', '2']
    assert '1 that lack a number' in description and 'velocities estimated' in description
    assert np.abs(motions[0].q - Q).max() < 1e-6
    assert np.abs(motions[1].tau - TAU).max() < 1e-9


@pytest.mark.parametrize('changes, message', [
    ({'v': ['a']}, 'must stand once|v has 1 columns'),
    ({'time': 'z'}, 'column z must stand once'),
])
def test_contradictory_log_description_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        LogMotions(**(LOG | changes))


def test_runs_whose_clocks_jitter_share_one_interval(tmp_path):
    # Each by itself, runs of 60 samples with such jitter differ by some percent of an interval.
    rng, runs = np.random.default_rng(0), {}
    for name in 'uvwxyz':
        t = T[:60] + 0.002 * rng.uniform(-1.0, 1.0, 60)
        runs |= {f'{name}/t': t, f'{name}/q': np.sin(t)[:, None], f'{name}/dq': np.cos(t)[:, None],
                 f'{name}/tau': np.zeros((60, 1))}
    medians = [np.median(np.diff(values)) for key, values in runs.items() if key[-1] == 't']
    assert np.ptp(medians) > 0.01 * np.median(medians)
    np.savez(tmp_path / 'a.npz', **runs)
    motions, _ = read_motions(tmp_path, ArraysData(), ['a'], [str(tmp_path / 'a.npz')])
    assert np.ptp([motion.spacing for motion in motions]) <= 1e-12
    assert max(np.abs(motion.q[:, 0] - np.sin(motion.t)).max() for motion in motions) <= 1e-8


def test_files_say_by_themselves_how_they_are_read(tmp_path):
    assert isinstance(guessed('a.npz:run1'), ArraysData)
    assert isinstance(guessed(str(tmp_path)), BagMotions)
    assert isinstance(guessed('a.mcap'), BagMotions)
    with pytest.raises(DataError, match='a.txt: no such file'):
        guessed(str(tmp_path / 'a.txt'))
    (tmp_path / 'a.txt').touch()
    with pytest.raises(DataError, match='--config'):
        guessed(str(tmp_path / 'a.txt'))


@pytest.mark.parametrize('data', [
    {'kind': 'bag', 'joints': ['a', 'b'], 'test_runs': ['run8']}, {'kind': 'log', **LOG}])
def test_configuration_takes_bags_and_logs(data):
    config = MachineConfig.model_validate({
        'coordinates': [{'name': 'a'}, {'name': 'b'}], 'data': data,
        'family': {'kind': 'mechanical', 'prior': 'none'}})
    assert config.data.kind == data['kind']


@pytest.mark.parametrize('key', ['dq', 'v', None])
def test_velocities_of_arrays_are_called_dq_or_v_and_without_any_the_remedy_is_named(
        tmp_path, key):
    path = tmp_path / 'a.npz'
    np.savez(path, t=T, q=Q, tau=TAU, **({} if key is None else {key: V}))
    if key is None:
        with pytest.raises(DataError, match='no key dq or v; it has .*; name the key of the '
                                            'velocities in data, or have them estimated'):
            read_arrays(path, ArraysData(), 2)
    (motion,), _ = read_arrays(path, ArraysData(v=key), 2)
    assert np.abs(motion.v_smooth - V).max() < (1e-3 if key else 0.1)
    if key:
        (motion,), _ = read_arrays(path, ArraysData(), 2)
        assert np.abs(motion.v - V).max() < 1e-12


def test_columns_of_a_log_are_those_of_its_header(tmp_path):
    path = tmp_path / 'log.csv'
    rows = [f'{t:.17g},note,{q[0]:.17g},{v[0]:.17g}' for t, q, v in zip(T, Q, V, strict=True)]
    path.write_text('\n'.join(['# by hand', 'time,"remark",angle,rate', *rows]))
    data = LogMotions(delimiter='comma', time='time', q=['angle'], v=['rate'])
    (motion,), _ = read_log_motions(path, data)
    assert np.abs(motion.q[:, 0] - Q[:, 0]).max() < 1e-12
    with pytest.raises(DataError, match=r"log.csv:2: no column 'angel'; did you mean angle\?"):
        read_log_motions(path, data.model_copy(update={'q': ['angel']}))
    with pytest.raises(DataError, match='set data.delimiter'):
        read_log_motions(path, data.model_copy(update={'delimiter': 'tab'}))
    # Spaces in names do not hide the commas, where one name is misspelt.
    path.write_text('Time (s),Pole angle (rad),Pole rate (rad/s)\n0,1,2\n1,2,3\n')
    with pytest.raises(DataError, match=r"no column 'Time' in the header: Time \(s\), Pole angle"):
        read_log_motions(path, LogMotions(time='Time', q=['Pole angle (rad)']))


def test_columns_in_degrees_become_radians_and_are_not_taken_for_them(tmp_path):
    path, named = tmp_path / 'log.csv', ['Angle [deg]', 'rate_deg_s']
    rows = [f'{t:.17g},{q:.17g},{v:.17g}' for t, q, v in zip(
        T, np.degrees(Q[:, 0]), np.degrees(V[:, 0]), strict=True)]
    path.write_text('\n'.join([','.join(['t', *named]), *rows]))
    data = {'time': 't', 'q': named[:1], 'v': named[1:]}
    (motion,), _ = read_log_motions(path, LogMotions(**data, degrees=named))
    assert np.abs(motion.q[:, 0] - Q[:, 0]).max() < 1e-12
    assert np.abs(motion.v[:, 0] - V[:, 0]).max() < 1e-12
    with pytest.raises(DataError, match=r"add data.degrees: \['Angle \[deg\]', 'rate_deg_s'\]"):
        read_log_motions(path, LogMotions(**data))
    (motion,), _ = read_log_motions(path, LogMotions(**data, degrees=[]))
    assert np.abs(motion.q[:, 0] - np.degrees(Q[:, 0])).max() < 1e-10
    with pytest.raises(ValueError, match='degrees: column angle is not used'):
        LogMotions(**data, degrees=['angle'])


def test_degrees_are_no_unit_of_a_coordinate():
    with pytest.raises(ValueError, match='a has q_unit: deg; angles are in rad'):
        MachineConfig.model_validate({
            'coordinates': [{'name': 'a', 'q_unit': 'deg'}], 'data': {
                'kind': 'log', 'time': 't', 'q': ['a']}, 'family': {'kind': 'mechanical'}})


@pytest.mark.parametrize('name, times, said', [
    ('Time [ms]', [f'{1e3 * t:.6f}' for t in T], 'times must be in seconds'),
    ('stamp_ns', [f'{1e9 * t:.0f}' for t in T], 'times must be in seconds'),
    ('time', [f'2026-01-01 10:00:{t:05.2f}' for t in T], 'write times as seconds'),
    ('time', [f'10:00:{t:05.2f}' for t in T], 'write times as seconds')])
def test_times_that_are_no_seconds_are_refused(tmp_path, name, times, said):
    path = tmp_path / 'log.csv'
    path.write_text('\n'.join([f'{name},angle', *(
        f'{t},{q:.17g}' for t, q in zip(times, Q[:, 0], strict=True))]))
    with pytest.raises(DataError, match=said) as problem:
        read_log_motions(path, LogMotions(time=name, q=['angle']))
    assert '\n' not in str(problem.value)


@pytest.mark.parametrize('unit, kind, said', [
    ('m', 'revolute', 'write kind: prismatic'), ('rad', 'prismatic', 'write kind: revolute')])
def test_length_is_no_angle_of_a_machine(unit, kind, said):
    coordinate = {'name': 'cart', 'q_unit': unit}
    with pytest.raises(ValueError, match=f'cart: q_unit: {unit} and kind: {kind} differ; {said}'):
        MachineConfig.model_validate({
            'coordinates': [coordinate | ({} if kind == 'revolute' else {'kind': kind})],
            'data': {'kind': 'log', 'time': 't', 'q': ['a']}, 'family': {'kind': 'mechanical'}})
