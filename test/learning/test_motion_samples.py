# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Samples whose times or numbers are wrong cost no more than themselves, and all are told of."""

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.arrays import ArraysData
from hnn_vi_ros.learning.data.bags import BagMotions, read_bag_motions
from hnn_vi_ros.learning.data.runs import (
    even_runs, increasing, MeasuredRun, RunData, unexplained, unwound)
from hnn_vi_ros.learning.data.sources import read_motions
from hnn_vi_ros.learning.data.text import LogMotions, read_log_motions
from hnn_vi_ros.learning.fit.machine import scales_of
import numpy as np
import pytest
from test_bag_data import array, write
from test_motion_sources import driver, LOG, Q, read, state, T, TAU, V


def motions(t=T, q=Q, v=V, tau=TAU, a=None, **changes) -> tuple:
    run = MeasuredRun('run', 'log: run', t, q, v, tau, a=a)
    return even_runs([run], RunData(**changes), 'log', 'digest')


def test_most_samples_are_kept_whose_times_increase():
    assert increasing(np.array([1.0, 2.0, 9.0, 3.0, 3.0, 4.0])).tolist()[-1] == 5
    assert len(increasing(np.array([1.0, 2.0, 9.0, 3.0, 3.0, 4.0]))) == 4
    assert len(increasing(np.zeros(5))) == 1 and not len(increasing(np.empty(0)))


@pytest.mark.parametrize('at', [100, 300])
def test_stamp_that_is_far_ahead_costs_one_sample(at):
    t = T.copy()
    t[at] += 1e6
    (motion,), described = motions(t)
    assert '1 that are late or come twice' in described
    assert len(motion.t) == len(T) and np.abs(motion.q - Q).max() < 1e-6


@pytest.mark.parametrize('back', [1.0, 1e9])
def test_clock_that_is_set_back_begins_a_new_motion(back):
    t = np.where(np.arange(len(T)) < 250, T, T - back)
    (first, second), described = motions(t)
    assert (len(first.t), len(second.t)) == (250, 150) and 'left out' not in described
    assert 'cut at 1 places' in described
    assert np.abs(second.q - Q[250:]).max() < 1e-6
    with pytest.raises(DataError, match='sample 251 is not after'):
        motions(t, on_bad='fail')


def test_angle_that_is_kept_within_a_turn_is_unwound():
    turning = np.stack([9.0 * T, Q[:, 1]], axis=-1)
    wrapped = np.stack([np.angle(np.exp(1j * turning[:, 0])), Q[:, 1]], axis=-1)
    v = np.stack([np.full_like(T, 9.0), V[:, 1]], axis=-1)
    (motion,), described = motions(q=wrapped, v=v)
    assert 'turns of coordinate 1 counted' in described
    assert np.abs(motion.q - turning).max() < 1e-6
    (motion,), _ = motions(q=wrapped, v=None)
    assert np.abs(motion.v[40:-40, 0] - 9.0).max() < 0.01
    # Rates tell the turns between two samples that are far apart: 1.5 of them.
    few = slice(None, None, 105)
    assert np.abs(np.diff(unwound(T[few], wrapped[few], v[few])[0][:, 0])
                  - 9.0 * 1.05).max() < 1e-9
    assert unwound(T, Q, V)[1] == []


@pytest.mark.parametrize('wrong', [0.0, np.pi / 180.0, 180.0 / np.pi, -1.0])
def test_velocities_that_are_not_those_of_the_positions_are_refused(wrong):
    v = V * [1.0, wrong]
    with pytest.raises(DataError, match='velocities of coordinate 2 are not the rates') as problem:
        motions(v=v)
    assert '\n' not in str(problem.value) and 'estimate_velocity' in str(problem.value)
    with pytest.raises(DataError, match='accelerations of coordinate 2 are not the rates'):
        motions(a=np.stack([-4.0 * Q[:, 0], -9.0 * wrong * Q[:, 1]], axis=-1))


def test_noise_quanta_and_joints_at_rest_are_no_wrong_velocities():
    rng = np.random.default_rng(3)
    quantum = 4e-4
    q = quantum * np.round(Q * [1.0, 0.0] / quantum + 0.4 * rng.normal(size=Q.shape))
    share = unexplained(T, q, V * [1.0, 0.0] + 0.05 * rng.normal(size=V.shape))
    # 0.05 rad/s in 0.01 s, of amplitudes of 1 rad; the joint at rest is not judged.
    assert share[0] < 1e-3 and np.isnan(share[1])
    motions(q=q, v=0.9 * V * [1.0, 0.0])


def test_numbers_that_are_none_are_lacking():
    q = Q.copy()
    q[7] = 1e200
    assert '1 that lack a number' in motions(q=q)[1]


def test_no_remedy_is_named_that_is_taken_already():
    with pytest.raises(DataError, match='in a row without a gap; record for longer$'):
        motions(t=T + 10.0 * (np.arange(len(T)) // 15))


def test_runs_of_other_rates_are_put_on_that_of_most_samples(tmp_path):
    np.savez(tmp_path / 'a.npz', **{f'{name}/{key}': values for name, step in (('x', 1), ('y', 2))
                                    for key, values in (('t', T[::step]), ('q', Q[::step]),
                                                        ('dq', V[::step]), ('tau', TAU[::step]))})
    (first, second), described = read_motions(
        tmp_path, ArraysData(), ['a', 'b'], [str(tmp_path / 'a.npz')])
    assert 'y put from every 0.02 s on every 0.01 s' in described
    assert abs(first.spacing - second.spacing) < 1e-12
    # Cubics through q and dq over 0.02 s: h^4 / 384 times 3^4.
    assert np.abs(second.q - Q[:len(second.q)]).max() < 0.02**4 / 384.0 * 3.0**4 + 1e-12


def test_efforts_that_some_messages_lack_are_no_reason_to_take_none(tmp_path):
    messages = driver()
    for i in (0, 1, 50):
        messages[i] = state(T[i], ['a', 'b'], Q[i], V[i])
    (motion,), described = read(write(tmp_path / 'a.mcap', messages))
    assert motion.tau[:, 1].all() and '3 that lack a number' in described


def test_efforts_of_joints_without_a_motor_are_zero_and_told(tmp_path):
    # As ros2_control publishes what a joint has no interface of.
    def published(tau):
        return [state(T[i], ['a', 'b'], Q[i], V[i], tau(i)) for i in range(len(T))]
    (motion,), described = read(
        write(tmp_path / 'a.mcap', published(lambda i: [np.nan, TAU[i, 1]])))
    assert 'no effort of a, which counts as no motor' in described
    assert not motion.tau[:, 0].any() and motion.tau[:, 1].all()
    path = write(tmp_path / 'b.mcap', published(lambda i: [np.nan, np.nan]))
    (motion,), described = read(path)
    assert 'no efforts published' in described and not motion.tau.any()
    with pytest.raises(DataError, match='has no efforts, and data.forces is effort'):
        read(path, forces='effort')


def test_forces_are_left_out_where_there_are_to_be_none(tmp_path):
    (motion,), described = read(write(tmp_path / 'a.mcap', driver()), forces='none')
    assert not motion.tau.any() and 'effort' not in described


def test_velocities_that_one_joint_never_has_are_estimated(tmp_path):
    messages = [state(T[i], ['a', 'b'], Q[i], [V[i, 0], np.nan], TAU[i]) for i in range(len(T))]
    assert 'velocities estimated' in read(write(tmp_path / 'a.mcap', messages))[1]


def commands(rows, stamp=lambda i: T[i] + 0.005, names=('b', 'a'), tau=lambda i: TAU[i, ::-1]):
    """Return commands as joint states, recorded in this order."""
    return [('/motors', 'sensor_msgs/msg/JointState', T[i] + 0.005, state(
        stamp(i), names, [], [], tau(i))[3]) for i in rows]


def with_commands(path, given):
    return write(path, sorted([*driver(), *given], key=lambda message: message[2]))


def test_commands_are_bridged_counted_or_refused_as_states_are(tmp_path):
    path = with_commands(tmp_path / 'a.mcap', commands(
        range(0, 400, 2), tau=lambda i: [1.0, np.nan] if i == 200 else TAU[i, ::-1],
        stamp=lambda i: T[i if i != 300 else 298] + 0.005))
    (motion,), described = read(path, forces='motors')
    assert '1 commands that lack a number' in described
    assert 'no force for 1 samples before the first command' in described
    after = motion.t > 0.02
    # Each holds for 0.02 s, or 0.04 s; the first joint's is 0.1 N m/s times time.
    assert np.abs(motion.tau - TAU[:len(motion.t)])[after, 0].max() < 0.1 * 0.045
    assert len(read(path, forces='motors', on_bad='split')[0]) == 2
    with pytest.raises(DataError, match='message 101 lacks a number'):
        read(path, forces='motors', on_bad='fail')


def test_motor_that_commands_never_name_is_none(tmp_path):
    path = with_commands(tmp_path / 'a.mcap', commands(
        range(400), names=['b'], tau=lambda i: TAU[i, 1:]))
    (motion,), described = read(path, forces='motors')
    assert 'no effort of a' in described
    assert not motion.tau[:, 0].any() and motion.tau[2:, 1].all()


def test_motor_of_an_array_that_is_never_commanded_is_told(tmp_path):
    given = array(T, np.stack([TAU[:, 1], np.full(len(T), np.nan)], axis=-1), '/motors')
    messages = [(*message[:3], state(T[i], ['a', 'b', 'c'], [*Q[i], Q[i, 0]],
                                     [*V[i], V[i, 0]])[3]) for i, message in enumerate(driver())]
    path = write(tmp_path / 'a.mcap', sorted([*messages, *given], key=lambda item: item[2]))
    (motion,), described = read_bag_motions(
        [path], BagMotions(forces='motors'), ['a', 'b', 'c'])
    assert 'no effort of motor 2' in described
    assert motion.tau.shape[1] == 2 and not motion.tau[:, 1].any()


@pytest.mark.parametrize('given, message', [
    (commands(range(400), stamp=lambda i: 0.0), 'all its stamps are 0 ns; take data.stamps: log'),
    (commands(range(400), stamp=lambda i: T[i] + 99.0), 'comes before the last state'),
    (commands(range(400), tau=lambda i: []), 'targets of positions are none'),
    (array(T, np.ones((400, 7)), '/motors'), '7 numbers for 2 coordinates; say in data.columns'),
])
def test_commands_that_say_nothing_are_refused(tmp_path, given, message):
    with pytest.raises(DataError, match=message) as problem:
        read(with_commands(tmp_path / 'a.mcap', given), forces='motors')
    assert '\n' not in str(problem.value)


def test_columns_choose_the_forces_of_the_joints(tmp_path):
    path = with_commands(tmp_path / 'a.mcap', array(
        T, np.tile(np.arange(7.0), (400, 1)), '/motors'))
    (motion,), _ = read(path, forces='motors', columns=[5, 3])
    assert (motion.tau[1:] == [5.0, 3.0]).all()
    with pytest.raises(DataError, match='names number 7, counted from 0'):
        read(path, forces='motors', columns=[7, 3])


def test_stamps_that_are_all_alike_name_their_remedy(tmp_path):
    messages = [(*message[:2], T[i], state(0.0, ['a', 'b'], Q[i], V[i], TAU[i])[3])
                for i, message in enumerate(driver())]
    path = write(tmp_path / 'a.mcap', messages)
    with pytest.raises(DataError, match='all its stamps are 0 ns; take data.stamps: log'):
        read(path)
    assert np.abs(read(path, stamps='log')[0][0].q - Q).max() < 1e-9
    assert BagMotions(stamps='log').columns == []


@pytest.mark.parametrize('fields, message', [
    ('1;0,01;0.1;0.2;0;0', 'write decimals with a point'),
    (';0.01;0.1;0.2;0;0', ':1: column run: no number, which tells the run'),
    ('1;zero;0.1;0.2;0;0', 'name the columns in data.columns'),
])
def test_rows_of_a_log_that_cannot_be_read_name_line_and_remedy(tmp_path, fields, message):
    (tmp_path / 'log.csv').write_text(f'{fields}\n1;0.02;0.1;0.2;0;0\n')
    with pytest.raises(DataError, match=message):
        read_log_motions(tmp_path / 'log.csv', LogMotions(**(LOG | {'delimiter': 'semicolon'})))


def test_runs_of_large_numbers_keep_their_names(tmp_path):
    (tmp_path / 'log.csv').write_text('\n'.join(
        f'{number},{T[i]},{Q[i, 0]},{Q[i, 1]},0,0' for number in (20240101, 20240102)
        for i in range(40)))
    found, _ = read_log_motions(tmp_path / 'log.csv', LogMotions(**LOG))
    assert [motion.name for motion in found] == ['20240101', '20240102']


@pytest.mark.parametrize('v', [None, V * [1.0, 0.0]])
def test_coordinate_that_never_moves_is_named(v):
    (motion,), _ = motions(q=Q * [1.0, 0.0] + 0.3, v=v)
    with pytest.raises(DataError, match='coordinate 2 never moves in the data'):
        scales_of([motion])
