# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions as robots give them: bad samples cost no more than themselves."""

from collections.abc import Sequence
from pathlib import Path

from bag_files import array, Message, state, write
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning import ArraysData, read_motions, source_of, steps_between
from hnn_vi_ros.learning.data.bags import BagMotions
from hnn_vi_ros.learning.data.motions import (
    even_motions, Motion, MotionData, of_positions, part_of, Recording)
from hnn_vi_ros.learning.data.sampling import (
    increasing_samples, interleaved, is_noise, unexplained_share, unwrap_turns)
from hnn_vi_ros.learning.data.sources import configuration_of
from hnn_vi_ros.learning.data.text import LogMotions
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.machine import scales_of
from machines import from_file
from messages import misfit, refused
import numpy as np
import pytest

OMEGA = 2.0
T = 0.01 * np.arange(1, 401)
Q = np.stack([np.sin(OMEGA * T), np.cos(3.0 * T)], axis=-1)
V = np.stack([OMEGA * np.cos(OMEGA * T), -3.0 * np.sin(3.0 * T)], axis=-1)
TAU = np.stack([0.1 * T, np.ones_like(T)], axis=-1)


def driver(rows: Sequence[int] = range(len(T))) -> list[Message]:
    """Return what a driver publishes, with another joint and in another order."""
    return [state(T[i], ['b', 'gripper', 'a'], [Q[i, 1], 7.0, Q[i, 0]], [V[i, 1], 0.0, V[i, 0]],
                  [TAU[i, 1], 0.0, TAU[i, 0]]) for i in rows]


def read(path: Path, **changes) -> tuple:
    return read_motions(Path(), BagMotions(**changes), ['a', 'b'], [path])


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
    assert '3 that lack a number and 2 that are late or duplicated' in description
    # Cubics through q and dq over intervals of at most 0.05 s: h^4 / 384 times 3^4.
    assert np.abs(motion.q - Q).max() < 0.05**4 / 384.0 * 3.0**4 + 1e-9
    parts, description = read(path, on_bad='split')
    # Of the pieces two are long enough.
    assert len(parts) == 2 and 'cut at' in description
    assert all(np.abs(np.diff(part.t) - 0.01).max() < 1e-9 for part in parts)
    with refused(DataError):
        read(path, on_bad='fail')


def test_gap_begins_a_new_motion(tmp_path):
    path = write(tmp_path / 'a.mcap', driver([*range(150), *range(200, 400)]))
    first, second = read(path)[0]
    assert (len(first.t), len(second.t)) == (150, 200)
    assert [motion.name for motion in (first, second)] == ['a#0', 'a#1']
    with refused(DataError):
        read(path, on_bad='fail')


@pytest.mark.parametrize('known', [False, True])
def test_velocities_that_a_joint_never_has_are_estimated_and_efforts_are_none(tmp_path, known):
    messages = [state(T[i], ['a', 'b'], Q[i], [V[i, 0] if known else np.nan, np.nan])
                for i in range(len(T))]
    (motion,), description = read(write(tmp_path / 'a.mcap', messages))
    assert 'velocities estimated' in description
    assert not motion.tau.any()
    # Of the filter, flat to (f / 40 Hz)^4 at 0.5 Hz, and central differences: h^2 / 6 times 3^3.
    inner = slice(40, -40)
    assert motion.v is None
    assert np.abs(motion.v_smooth - V)[inner].max() < 0.01**2 / 6.0 * 27.0 + 1e-5


def test_commands_are_the_forces_where_they_are_named(tmp_path):
    commands = array(np.array([1.005, 2.005]), np.array([[1.0, 2.0], [3.0, 4.0]]), '/forces')
    path = write(tmp_path / 'a.mcap', sorted([*driver(), *commands], key=lambda item: item[2]))
    (motion,), _ = read(path, forces='forces')
    t = motion.t + T[0]
    assert not motion.tau[t < 0.995].any()
    assert (motion.tau[(t > 1.015) & (t < 1.995)] == [1.0, 2.0]).all()
    assert (motion.tau[t > 2.015] == [3.0, 4.0]).all()
    assert np.array_equal(motion.forces, motion.tau[:-1])
    (motion,), _ = read(path, forces='forces', inputs='linear')
    assert np.array_equal(motion.forces, 0.5 * (motion.tau[:-1] + motion.tau[1:]))
    # Of one motor that moves both joints.
    one = array(np.array([1.005]), np.array([[1.0]]), '/motor')
    path = write(tmp_path / 'one.mcap', sorted([*driver(), *one], key=lambda item: item[2]))
    (motion,), _ = read(path, forces='motor')
    assert motion.tau.shape == (len(motion.t), 1)
    assert (motion.tau[motion.t + T[0] > 1.015] == 1.0).all()
    wide = array(np.array([1.0]), np.array([[1.0, 2.0, 3.0]]), '/forces')
    with refused(DataError):
        read(write(tmp_path / 'b.mcap', [*driver(), *wide]), forces='forces')


def test_arrays_that_lack_numbers_are_read_without_them(tmp_path):
    q, dq = Q.copy(), np.full_like(V, np.nan)
    q[10], q[200, 1] = np.nan, np.inf
    np.savez(tmp_path / 'a.npz', t=T, q=q, dq=dq, tau=TAU)
    (motion,), description = from_file(tmp_path / 'a.npz', ArraysData())
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
    motions, description = from_file(tmp_path / 'log.csv', LogMotions(**LOG))
    assert [motion.name for motion in motions] == ['1', '2']
    assert '1 that lack a number' in description and 'velocities estimated' in description
    assert np.abs(motions[0].q - Q).max() < 1e-6
    assert np.abs(motions[1].tau - TAU).max() < 1e-9


@pytest.mark.parametrize('suffix', ['csv', 'npz'])
def test_several_files_are_runs_of_one_machine(tmp_path, suffix):
    files, q = [tmp_path / f'{name}.{suffix}' for name in ('slow', 'fast', 'far')], Q[:, :1]
    for k, file in enumerate(files):
        if suffix == 'npz':
            np.savez(file, t=T, q=(k + 1.0) * q)
        else:
            np.savetxt(file, np.hstack([T[:, None], (k + 1.0) * q]), '%.9f', ',',
                       header='t,q [rad]', comments='')
    given, reading = [*map(str, files)], source_of(str(files[0])).model_copy(update={
        'v': None, 'tau': None})
    found, _ = read_motions(tmp_path, reading, ['q'], given)
    assert [motion.name for motion in found] == ['slow', 'fast', 'far']
    assert all(np.abs(one.q - (k + 1.0) * q).max() < 1e-8 for k, one in enumerate(found))
    (tmp_path / 'more').mkdir()
    given.append(str(files[0].rename(tmp_path / 'more' / files[1].name)))
    found, _ = read_motions(tmp_path, reading, ['q'], given[1:])
    assert [motion.name for motion in found] == given[1:]


def test_several_logs_are_read_with_one_header_and_turn_if_one_of_them_does(tmp_path):
    for name, size, head in (('a', 1.0, 'theta'), ('b', 3.5, 'theta'), ('c', 1.0, 'phi')):
        np.savetxt(tmp_path / name, np.stack([T, size * np.sin(9.0 * T)], 1), '%.9f', ',',
                   header=f't,{head} [rad]', comments='')
    paths = [str(tmp_path / name) for name in 'abc']
    with refused(DataError):
        configuration_of(paths)
    (coordinate,) = configuration_of(paths[:2])['coordinates']
    assert coordinate['kind'] == 'continuous'
    assert configuration_of(paths[:1])['coordinates'][0]['kind'] == 'revolute'


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
    assert isinstance(source_of('a.npz:run1'), ArraysData)
    assert isinstance(source_of(str(tmp_path)), BagMotions)
    assert isinstance(source_of('a.mcap'), BagMotions)
    with refused(DataError):
        source_of(str(tmp_path / 'a.txt'))
    (tmp_path / 'a.txt').touch()
    with refused(DataError):
        source_of(str(tmp_path / 'a.txt'))


@pytest.mark.parametrize('key', ['dq', 'v', None])
def test_velocities_of_arrays_are_called_dq_or_v_and_without_any_the_remedy_is_named(
        tmp_path, key):
    path = tmp_path / 'a.npz'
    np.savez(path, t=T, q=Q, tau=TAU, **({} if key is None else {key: V}))
    if key is None:
        with refused(DataError):
            from_file(path, ArraysData())
    (motion,), _ = from_file(path, ArraysData(v=key))
    assert np.abs(motion.v_smooth - V).max() < (1e-3 if key else 0.1)
    if key:
        (motion,), _ = from_file(path, ArraysData())
        assert np.abs(motion.v - V).max() < 1e-12


def test_columns_of_a_log_are_those_of_its_header(tmp_path):
    path = tmp_path / 'log.csv'
    rows = [f'{t:.17g},note,{q[0]:.17g},{v[0]:.17g}' for t, q, v in zip(T, Q, V, strict=True)]
    path.write_text('\n'.join(['# by hand', 'time,"remark",angle,rate', *rows]))
    data = LogMotions(delimiter='comma', time='time', q=['angle'], v=['rate'])
    (motion,), _ = from_file(path, data)
    assert np.abs(motion.q[:, 0] - Q[:, 0]).max() < 1e-12
    with refused(DataError):
        from_file(path, data.model_copy(update={'q': ['angel']}))
    with refused(DataError):
        from_file(path, data.model_copy(update={'delimiter': 'tab'}))
    # Spaces in names do not hide the commas, where one name is misspelt.
    path.write_text('Time (s),Pole angle (rad),Pole rate (rad/s)\n0,1,2\n1,2,3\n')
    with refused(DataError):
        from_file(path, LogMotions(time='Time', q=['Pole angle (rad)']))


def test_column_that_stands_twice_is_named_with_its_places(tmp_path):
    path = tmp_path / 'log.csv'
    path.write_text('t,V_C,x,V_C\n0,1,2,3\n1,2,3,4\n')
    with refused(DataError):
        from_file(path, LogMotions(time='t', q=['x'], tau=['V_C']))


def test_comment_that_names_some_columns_is_no_header(tmp_path):
    path = tmp_path / 'log.txt'
    np.savetxt(path, np.column_stack([np.zeros_like(T), T, Q]), header='a b', comments='% ')
    (motion,), _ = from_file(path, LogMotions(
        columns=['run', 't', 'a', 'b'], comment='%', trial='run', time='t', q=['a', 'b']))
    assert np.abs(motion.q - Q).max() < 1e-12


def test_columns_in_degrees_become_radians(tmp_path):
    path, named = tmp_path / 'log.csv', ['Angle [deg]', 'rate_deg_s']
    rows = [f'{t:.17g},{q:.17g},{v:.17g}' for t, q, v in zip(
        T, np.degrees(Q[:, 0]), np.degrees(V[:, 0]), strict=True)]
    path.write_text('\n'.join([','.join(['t', *named]), *rows]))
    data = {'time': 't', 'q': named[:1], 'v': named[1:]}
    for degrees in (named, None):
        (motion,), _ = from_file(path, LogMotions(**data, degrees=degrees))
        assert np.abs(motion.q[:, 0] - Q[:, 0]).max() < 1e-12
        assert np.abs(motion.v[:, 0] - V[:, 0]).max() < 1e-12
    (motion,), _ = from_file(path, LogMotions(**data, degrees=[]))
    assert np.abs(motion.q[:, 0] - np.degrees(Q[:, 0])).max() < 1e-10


def machine(coordinates: list[dict], data: dict) -> MachineConfig:
    return MachineConfig.model_validate({
        'coordinates': coordinates, 'data': data, 'family': {'kind': 'mechanical'}})


@pytest.mark.parametrize('data', [
    {'kind': 'bag', 'joints': ['a', 'b'], 'test_runs': ['run8']}, {'kind': 'log', **LOG}])
def test_configuration_takes_bags_and_logs(data):
    assert machine([{'name': 'a'}, {'name': 'b'}], data).data.kind == data['kind']


@pytest.mark.parametrize('coordinate', [
    {'q_unit': 'deg'}, {'q_unit': 'm'}, {'q_unit': 'rad', 'kind': 'prismatic'}])
def test_coordinate_of_another_unit_is_refused(coordinate):
    with misfit():
        machine([{'name': 'a'} | coordinate], {'kind': 'log', 'time': 't', 'q': ['a']})


@pytest.mark.parametrize('changes', [{'v': ['a']}, {'time': 'z'}, {'degrees': ['angle']}])
def test_contradictory_log_description_is_refused(changes):
    with misfit():
        LogMotions(**(LOG | changes))


@pytest.mark.parametrize('head, sizes, unit', [
    ('Time [ms],x [mm]', (1e3, 1e3), 'm'), ('stamp_ns,x_cm', (1e9, 1e2), 'm'),
    ('t / min,x (m)', (1.0 / 60.0, 1e-3), 'mm'), ('t,tau_m', (1.0, 1.0), 'rad')])
def test_columns_are_converted_to_seconds_and_the_unit_of_the_coordinate(
        tmp_path, head, sizes, unit):
    path, names = tmp_path / 'log.csv', head.split(',')
    rows = [f'{sizes[0] * t:.17g},{sizes[1] * q:.17g}' for t, q in zip(T, Q[:, 0], strict=True)]
    path.write_text('\n'.join([head, *rows]))
    data = LogMotions(time=names[0], q=names[1:])
    (motion,), _ = read_motions(Path(), data, ['x'], [str(path)], [unit])
    assert np.abs(motion.t - T).max() < 1e-8
    assert np.abs(motion.q[:, 0] - Q[:, 0]).max() < 1e-8


@pytest.mark.parametrize('head, unit', [('t,x [mm]', 'rad'), ('t,x [px]', 'm'), ('t [m],x', 'm')])
def test_unit_of_something_else_is_refused(tmp_path, head, unit):
    path, (time, x) = tmp_path / 'log.csv', head.split(',')
    path.write_text(f'{head}\n0,1\n1,2')
    with refused(DataError):
        read_motions(Path(), LogMotions(time=time, q=[x]), ['x'], [str(path)], [unit])


@pytest.mark.parametrize('name, times', [
    ('time', [f'{1.7e12 + 1e3 * t:.3f}' for t in T]),
    ('time', [f'2026-13-01 10:00:{t:05.2f}' for t in T]),
    ('time', [f'10 h {t:05.2f}' for t in T])])
def test_times_that_are_no_numbers_or_too_large_are_refused(tmp_path, name, times):
    path = tmp_path / 'log.csv'
    path.write_text('\n'.join([f'{name},angle', *(
        f'{t},{q:.17g}' for t, q in zip(times, Q[:, 0], strict=True))]))
    with refused(DataError):
        from_file(path, LogMotions(time=name, q=['angle']))


def test_none_leaves_out_the_forces_or_the_velocities_of_every_kind(tmp_path):
    np.savez(tmp_path / 'a.npz', t=T, q=Q, dq=V, tau=TAU)
    np.savetxt(tmp_path / 'log.csv', np.column_stack([T, Q, V, TAU]), '%.9f', ',')
    bag = write(tmp_path / 'a.mcap', driver())
    columns = {'columns': ['t', 'a', 'b', 'va', 'vb', 'ta', 'tb'], 'time': 't', 'q': ['a', 'b'],
               'v': ['va', 'vb'], 'tau': ['ta', 'tb']}
    for data in ({'kind': 'log', 'path': str(tmp_path / 'log.csv'), **columns},
                 {'kind': 'arrays', 'path': str(tmp_path / 'a.npz')},
                 {'kind': 'bag', 'paths': [str(bag)]}):
        for left_out in ({}, {'forces': 'none'}, {'velocities': 'none'}):
            config = machine([{'name': 'a'}, {'name': 'b'}], data | left_out)
            (motion,), _ = config.motions(tmp_path, ['a', 'b'], [])
            assert motion.tau.any() != ('forces' in left_out)
            assert (motion.v is None) == ('velocities' in left_out)


def test_samples_that_lie_a_thousand_steps_apart_are_refused():
    assert steps_between(1.0, 0.01) == 100
    with refused(DataError):
        steps_between(10.0, 0.01)


def motions(t=T, q=Q, v=V, tau=TAU, a=None, **changes) -> tuple:
    motion = Motion('run', 'log: run', t, q, v, tau, a)
    return even_motions(Recording([motion], 'log', 'digest'), MotionData(**changes))


def test_most_samples_are_kept_whose_times_increase():
    assert increasing_samples(np.array([1.0, 2.0, 9.0, 3.0, 3.0, 4.0])).tolist()[-1] == 5
    assert len(increasing_samples(np.array([1.0, 2.0, 9.0, 3.0, 3.0, 4.0]))) == 4
    assert len(increasing_samples(np.zeros(5))) == 1 and not len(increasing_samples(np.empty(0)))


def test_noise_and_two_bodies_in_turn_are_told_from_motions_of_few_samples_a_period():
    k, noise = np.arange(200), np.random.default_rng(5).normal(size=200)
    assert is_noise(noise) and not interleaved(noise)
    # Each by itself is smooth: their third differences are at most 0.1^3 of their size.
    assert interleaved(np.where(k % 2, np.sin(0.05 * k), np.cos(0.03 * k)) + 1e-3 * noise)
    for period in (2.6, 3.0, 4.0, 10.0, 100.0):
        x = np.sin(2.0 * np.pi / period * k) + 0.1 * noise
        assert not is_noise(x) and not interleaved(x)


@pytest.mark.parametrize('at', [100, 300])
def test_stamp_that_is_far_ahead_costs_one_sample(at):
    t = T.copy()
    t[at] += 1e6
    (motion,), described = motions(t)
    assert '1 that are late or duplicated' in described
    assert len(motion.t) == len(T) and np.abs(motion.q - Q).max() < 1e-6


@pytest.mark.parametrize('back', [1.0, 1e9])
def test_clock_that_is_set_back_begins_a_new_motion(back):
    t = np.where(np.arange(len(T)) < 250, T, T - back)
    (first, second), described = motions(t)
    assert (len(first.t), len(second.t)) == (250, 150) and 'left out' not in described
    assert 'cut at 1 place' in described
    assert np.abs(second.q - Q[250:]).max() < 1e-6
    with refused(DataError):
        motions(t, on_bad='fail')


def test_angle_that_is_kept_within_a_turn_is_unwound():
    turning = np.stack([9.0 * T, Q[:, 1]], axis=-1)
    wrapped = np.stack([np.angle(np.exp(1j * turning[:, 0])), Q[:, 1]], axis=-1)
    v = np.stack([np.full_like(T, 9.0), V[:, 1]], axis=-1)
    (motion,), described = motions(q=wrapped, v=v)
    assert 'coordinate 1 unwrapped' in described
    assert np.abs(motion.q - turning).max() < 1e-6
    (motion,), _ = motions(q=wrapped, v=None)
    assert np.abs(motion.v_smooth[40:-40, 0] - 9.0).max() < 0.01
    # Rates tell the turns between two samples that are far apart: 1.5 of them.
    few = slice(None, None, 105)
    assert np.abs(np.diff(unwrap_turns(T[few], wrapped[few], v[few])[0][:, 0])
                  - 9.0 * 1.05).max() < 1e-9
    assert unwrap_turns(T, Q, V)[1] == []


@pytest.mark.parametrize('wrong', [0.0, np.pi / 180.0, 180.0 / np.pi, -1.0])
def test_velocities_that_are_not_those_of_the_positions_are_refused(wrong):
    v = V * [1.0, wrong]
    with refused(DataError):
        motions(v=v)
    with refused(DataError):
        motions(a=np.stack([-4.0 * Q[:, 0], -9.0 * wrong * Q[:, 1]], axis=-1))


@pytest.mark.parametrize('part', [slice(1, None), slice(None, -1)], ids=['behind', 'ahead'])
def test_velocities_that_are_differences_of_positions_are_not_used(part):
    v = V.copy()
    v[part] = np.diff(Q, axis=0) / 0.01
    (motion,), told = motions(v=v)
    assert motion.v is None and 'differences of the positions' in told
    (motion,), told = motions()
    assert motion.v is not None and 'differences' not in told


def test_runs_of_which_some_have_velocities_share_their_channels_and_keep_their_states():
    runs = [Motion(name, f'log: {name}', T, Q, v, TAU) for name, v in (
        ('good', V), ('driver', np.gradient(Q, T, axis=0)), ('none', None),
        ('differences', np.vstack([V[:1], np.diff(Q, axis=0) / 0.01])))]
    found, told = even_motions(Recording(runs, 'log', ''), MotionData())
    (alone,), _ = even_motions(Recording(runs[:1], 'log', ''), MotionData())
    assert all(motion.v is None and motion.measured.shape == Q.shape for motion in found)
    np.testing.assert_array_equal(found[0].v_smooth, alone.v_smooth)
    assert 'velocities of differences are differences of the positions' in told
    assert 'positions alone, since not all runs have velocities' in told


def test_velocities_left_out_later_do_not_interpolate_the_positions():
    t = T + 2e-3 * np.random.default_rng(4).uniform(-1.0, 1.0, len(T))
    q, late = np.sin(9.0 * t)[:, None], 9.0 * np.cos(9.0 * (t - 0.03))[:, None]
    run = Recording([Motion('run', 'run', t, q, late)], '', '')
    (with_v,), (alone,) = (even_motions(run, data)[0] for data in (
        MotionData(), MotionData(velocities='none')))
    assert np.abs(with_v.q - alone.q).max() > 1e-3
    (left_out,) = of_positions([with_v])
    np.testing.assert_array_equal(left_out.q, alone.q)


def test_parts_of_motions_are_filtered_as_the_whole_is():
    t = 0.01 * np.arange(2000)
    phase = np.where(t < 10.0, 30.0 * t, 300.0 + 2.0 * (t - 10.0))
    q = np.sin(phase)[:, None] + 1e-3 * np.random.default_rng(4).normal(size=(2000, 1))
    v = (np.where(t < 10.0, 30.0, 2.0) * np.cos(phase))[:, None]
    run = Recording([Motion('run', 'run', t, q, v)], '', '')
    (measured,), (alone,) = (even_motions(run, data)[0] for data in (
        MotionData(), MotionData(velocities='none')))
    (slow,) = of_positions([part_of(measured, slice(1200, None))])
    assert slow.cutoff == alone.cutoff


def test_noise_quanta_and_joints_at_rest_are_no_wrong_velocities():
    rng = np.random.default_rng(3)
    quantum = 4e-4
    q = quantum * np.round(Q * [1.0, 0.0] / quantum + 0.4 * rng.normal(size=Q.shape))
    share = unexplained_share(T, q, V * [1.0, 0.0] + 0.05 * rng.normal(size=V.shape))
    # 0.05 rad/s in 0.01 s, of amplitudes of 1 rad; the joint at rest is not judged.
    assert share[0] < 1e-3 and np.isnan(share[1])
    motions(q=q, v=0.9 * V * [1.0, 0.0])


def test_numbers_that_are_none_are_lacking():
    q = Q.copy()
    q[7] = 1e200
    assert '1 that lack a number' in motions(q=q)[1]


def test_no_remedy_is_named_that_is_taken_already():
    with refused(DataError):
        motions(t=T + 10.0 * (np.arange(len(T)) // 15))


def test_runs_of_other_rates_are_put_on_that_of_most_samples(tmp_path):
    np.savez(tmp_path / 'a.npz', **{f'{name}/{key}': values for name, step in (('x', 1), ('y', 2))
                                    for key, values in (('t', T[::step]), ('q', Q[::step]),
                                                        ('dq', V[::step]), ('tau', TAU[::step]))})
    (first, second), described = read_motions(
        tmp_path, ArraysData(), ['a', 'b'], [str(tmp_path / 'a.npz')])
    assert 'y resampled from 0.02 s to 0.01 s' in described
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
    assert 'no effort of a, taken as no motor' in described
    assert not motion.tau[:, 0].any() and motion.tau[:, 1].all()
    path = write(tmp_path / 'b.mcap', published(lambda i: [np.nan, np.nan]))
    (motion,), described = read(path)
    assert 'no efforts published' in described and not motion.tau.any()
    with refused(DataError):
        read(path, forces='effort')


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
    with refused(DataError):
        read(path, forces='motors', on_bad='fail')


def test_motor_that_commands_never_name_is_none(tmp_path):
    path = with_commands(tmp_path / 'a.mcap', commands(
        range(400), names=['b'], tau=lambda i: TAU[i, 1:]))
    (motion,), described = read(path, forces='motors')
    assert 'no effort of a' in described
    assert not motion.tau[:, 0].any() and motion.tau[2:, 1].all()


def test_motor_of_an_array_that_is_never_commanded_is_told(tmp_path):
    given = array(T, np.stack([TAU[:, 1], np.full(len(T), np.nan)], axis=-1), '/motors')
    messages = [(*message[:3], state(T[i], ['a', 'b', 'c'], [*Q[i], -Q[i, 0]],
                                     [*V[i], -V[i, 0]])[3]) for i, message in enumerate(driver())]
    path = write(tmp_path / 'a.mcap', sorted([*messages, *given], key=lambda item: item[2]))
    (motion,), described = read_motions(
        Path(), BagMotions(forces='motors'), ['a', 'b', 'c'], [path])
    assert 'no effort of motor 2' in described
    assert motion.tau.shape[1] == 2 and not motion.tau[:, 1].any()


@pytest.mark.parametrize('given', [
    commands(range(400), stamp=lambda i: 0.0), commands(range(400), stamp=lambda i: T[i] + 99.0),
    commands(range(400), tau=lambda i: []), array(T, np.ones((400, 7)), '/motors')])
def test_commands_that_say_nothing_are_refused(tmp_path, given):
    with refused(DataError):
        read(with_commands(tmp_path / 'a.mcap', given), forces='motors')


def test_columns_choose_the_forces_of_the_joints(tmp_path):
    path = with_commands(tmp_path / 'a.mcap', array(
        T, np.tile(np.arange(7.0), (400, 1)), '/motors'))
    (motion,), _ = read(path, forces='motors', columns=[5, 3])
    assert (motion.tau[1:] == [5.0, 3.0]).all()
    with refused(DataError):
        read(path, forces='motors', columns=[7, 3])


def test_states_in_parts_are_named_as_the_cause(tmp_path):
    messages = [state(T[i], [name], [Q[i, k]]) for i in range(len(T))
                for k, name in enumerate('ab')]
    with refused(DataError):
        read(write(tmp_path / 'a.mcap', messages))


def test_stamps_that_are_all_alike_name_their_remedy(tmp_path):
    messages = [(*message[:2], T[i], state(0.0, ['a', 'b'], Q[i], V[i], TAU[i])[3])
                for i, message in enumerate(driver())]
    path = write(tmp_path / 'a.mcap', messages)
    with refused(DataError):
        read(path)
    assert np.abs(read(path, stamps='log')[0][0].q - Q).max() < 1e-9
    assert BagMotions(stamps='log').columns == []


@pytest.mark.parametrize('fields', [
    '1;0,01;0.1;0.2;0;0', ';0.01;0.1;0.2;0;0', '1;zero;0.1;0.2;0;0'])
def test_rows_of_a_log_that_cannot_be_read_name_line_and_remedy(tmp_path, fields):
    (tmp_path / 'log.csv').write_text(f'{fields}\n1;0.02;0.1;0.2;0;0\n')
    with refused(DataError):
        from_file(tmp_path / 'log.csv', LogMotions(**(LOG | {'delimiter': 'semicolon'})))


def test_runs_of_large_numbers_keep_their_names(tmp_path):
    (tmp_path / 'log.csv').write_text('\n'.join(
        f'{number},{T[i]},{Q[i, 0]},{Q[i, 1]},0,0' for number in (20240101, 20240102)
        for i in range(40)))
    found, _ = from_file(tmp_path / 'log.csv', LogMotions(**LOG))
    assert [motion.name for motion in found] == ['20240101', '20240102']


@pytest.mark.parametrize('v', [None, V * [1.0, 0.0]])
def test_coordinate_that_never_moves_is_named(v):
    (motion,), _ = motions(q=Q * [1.0, 0.0] + 0.3, v=v)
    with refused(DataError):
        scales_of([motion])
