# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of logs before a fit: ten good logs, and ten that are useless in different ways."""

from pathlib import Path
import shutil

from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.identify.check import check, main
from hnn_vi_ros.learning.data.log_warnings import warnings_of
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import simulate
from messages import refused
import numpy as np
from pandas import DataFrame, read_csv
import pytest
from test_commanded import write_log

Q = ['shoulder position [rad]', 'elbow position [rad]']
R = ['shoulder command [deg]', 'elbow command [deg]']


@pytest.fixture(scope='module')
def logged(tmp_path_factory):
    """Return the folder of a log of an arm of two servos, and its true numbers."""
    folder = tmp_path_factory.mktemp('check')
    return folder, write_log(folder, 2, 5)


def torques(folder: Path, seed: int = 3) -> DataFrame:
    """Return a log of an arm with measured torques, by Newton's law along sums of sines."""
    robot, rng = RigidBodyTree(str(folder / 'arm.urdf')), np.random.default_rng(seed)
    t, h = 0.01 * np.arange(1500), 1e-5
    rate, size, phase = rng.uniform(1.0, 6.0, (5, 2)), rng.uniform(0.2, 0.4, (5, 2)), rng.uniform(
        0.0, 6.0, (5, 2))

    def at(t):
        x = rate * np.asarray(t)[:, None, None] + phase
        q, v = (size * np.sin(x)).sum(1), (size * rate * np.cos(x)).sum(1)
        return q, v, np.einsum('nij,nj->ni', robot.masses(q), v)
    q, v, p = at(t)
    tau = (at(t + h)[2] - at(t - h)[2]) / (2.0 * h) + robot.gradient(q, p)[0]
    tau += [0.05, 0.03] * v + [0.2, 0.1] * np.tanh(v / 0.05) + 0.02 * rng.normal(size=q.shape)
    q = q + 1e-4 * rng.normal(size=q.shape)
    return DataFrame({'t [s]': t, Q[0]: q[:, 0], Q[1]: q[:, 1],
                      'shoulder torque [N m]': tau[:, 0], 'elbow torque [N m]': tau[:, 1]})


def frame(folder: Path) -> DataFrame:
    return read_csv(folder / 'log.csv')


def jittered(log: DataFrame) -> DataFrame:
    log['t [s]'] += 0.001 * np.random.default_rng(1).normal(size=len(log))
    return log.sort_values('t [s]')


def with_values(log: DataFrame, names, values) -> DataFrame:
    log[names] = values
    return log


GOOD = {
    'as logged': lambda log: log,
    'jitter': jittered,
    'a gap': lambda log: log.drop(index=range(200, 230)),
    'half the rate': lambda log: log.iloc[::2],
    'rounded': lambda log: with_values(log, Q, log[Q].round(3)),
    'glitches': lambda log: with_values(log, Q[0], log[Q[0]].where(
        np.arange(len(log)) % 97 != 50, 9.0)),
    'another order of columns': lambda log: log[['t [s]', R[1], Q[1], R[0], Q[0]]],
    'dates': lambda log: with_values(log, 't [s]', log['t [s]'] + 1.7e9),
}
USELESS = {
    'noise': lambda log: with_values(log, Q, np.random.default_rng(0).normal(size=(len(log), 2))),
    'at rest': lambda log: with_values(log, Q, 0.1 + 1e-4 * np.random.default_rng(0).normal(
        size=(len(log), 2))),
    'short': lambda log: log.iloc[:100],
    'times that go back': lambda log: with_values(log, 't [s]', log['t [s]'].to_numpy()[::-1]),
    'no command changes': lambda log: with_values(log, R, 20.0),
    'radians called degrees': lambda log: with_values(log, R, np.radians(log[R])),
    'joints swapped': lambda log: with_values(log, R, log[R[::-1]].to_numpy()),
    'wrong sign': lambda log: with_values(log, R, -log[R]),
    'stops': lambda log: with_values(log, Q, log[Q].clip(-0.25, 0.25)),
    'too slow': lambda log: log.iloc[::30],
}


@pytest.mark.parametrize('kind', GOOD)
def test_good_logs_are_usable(logged, tmp_path, kind, capsys):
    folder, truth = logged
    GOOD[kind](frame(folder)).to_csv(tmp_path / 'log.csv', index=False)
    found = check([str(tmp_path / 'log.csv')], folder / 'arm.urdf')
    assert not found.useless, found.warnings
    told = {one.name: one for one in found.numbers}
    # A least squares of filtered accelerations only estimates: its order of size is right.
    for k, name in enumerate(('shoulder', 'elbow')):
        one = told[f'stiffness of {name}']
        assert one.known and 0.5 < one.value / truth[f'servo.stiffness.{k}'] < 2.0
    assert found.delay == pytest.approx(truth['servo.delay'], abs=0.03)


def test_good_log_of_torques_and_of_free_motion_are_usable(logged, tmp_path, capsys):
    folder, _ = logged
    torques(folder).to_csv(tmp_path / 'log.csv', index=False)
    found = check([str(tmp_path / 'log.csv')], folder / 'arm.urdf')
    assert not found.useless, found.warnings
    told = {one.name: one for one in found.numbers}
    for name, friction in (('shoulder', 0.2), ('elbow', 0.1)):
        scale, own = told[f'scale of masses of {name}'], told[f'friction of {name}']
        assert abs(scale.value - 1.0) < max(2.0 * scale.half_width, 0.05)
        assert abs(own.value - friction) < max(2.0 * own.half_width, 0.05)
        assert not told[f'offset of {name}'].known
    path = simulate(load_scene('exact_double_pendulum'), 20.0, every=2)
    DataFrame({'t [s]': path.t, 'q1 [rad]': path.q[:, 0], 'q2 [rad]': path.q[:, 1]}).to_csv(
        tmp_path / 'free.csv', index=False)
    free = check([str(tmp_path / 'free.csv')])
    assert not free.useless and not free.numbers, free.warnings


def test_advice_names_no_motion_that_the_log_has(logged, tmp_path, capsys):
    folder, _ = logged
    torques(folder).to_csv(tmp_path / 'log.csv', index=False)
    main([str(tmp_path / 'log.csv'), '--robot', str(folder / 'arm.urdf')])
    text = capsys.readouterr().out
    # There is no offset, and no rotor: both are told.
    small, _, lacking = text.partition('Too small to matter')[2].partition('It does not tell')
    assert 'offset of elbow' in small and 'offset of elbow' not in lacking
    assert 'rotor inertia of shoulder' not in lacking


def test_motion_of_ten_samples_a_period_moves():
    t = 0.1 * np.arange(300)
    q = np.sin(2.0 * np.pi * t)[:, None] + 1e-3 * np.random.default_rng(0).normal(size=(300, 1))
    assert not warnings_of([smoothed('run', t, q, None, 0.0 * q, 4.0)], ['a'], ['rad'])
    noise = smoothed('run', t, 1e-3 * (q - q.mean() + 1e3 * np.random.default_rng(1).normal(
        size=q.shape)), None, 0.0 * q, 4.0)
    assert next(iter(warnings_of([noise], ['a'], ['rad']))).text == 'a does not move'


def test_degrees_that_are_called_radians_are_told(tmp_path):
    t = 0.02 * np.arange(500)
    path = tmp_path / 'log.csv'
    for unit, told in (('deg', False), ('rad', True)):
        DataFrame({'t': t, f'theta [{unit}]': 57.0 * np.cos(3.6 * t)}).to_csv(path, index=False)
        texts = ' '.join(one.text for one in check([str(path)]).warnings)
        assert ('theta turns by up to 4.1 rad between samples' in texts) == told


def test_noise_at_irregular_times_is_no_fast_motion(tmp_path):
    random = np.random.default_rng(1)
    t = np.sort(random.uniform(0.0, 25.0, 1200))
    q = 0.8 * np.cos(3.6 * t) * np.exp(-0.02 * t) + 5e-3 * random.normal(size=len(t))
    DataFrame({'t': t, 'angle [rad]': q}).to_csv(tmp_path / 'log.csv', index=False)
    found = check([str(tmp_path / 'log.csv')])
    assert not found.useless and 'tenth of the intervals' in found.warnings[-1].text


@pytest.mark.parametrize('frequency, fast', [(0.5, False), (18.0, True)])
def test_slow_motion_without_noise_is_not_too_fast_for_its_samples(tmp_path, frequency, fast):
    t = 0.02 * np.arange(250)
    path = tmp_path / 'log.csv'
    DataFrame({'t': t, 'angle [rad]': np.cos(2.0 * np.pi * frequency * t)}).to_csv(path)
    assert any('record more of them' in one.text for one in check([str(path)]).warnings) == fast


@pytest.mark.parametrize(('spacing', 'step', 'told'), [
    (0.01, 0.0, ''), (0.01, 0.1, 'position of a has a coarse resolution of 0.1'),
    (10.0, 0.0, 'a sample every 10 s: check the unit of the times')])
def test_coarse_positions_and_times_of_another_unit_are_told(spacing, step, told):
    """Between few samples, coarse values are many of all; they are not those of a stop."""
    t = spacing * np.arange(250)
    q = np.sin(0.16 * np.arange(250))[:, None]
    q = step * np.round(q / step) if step else q
    (text,) = [one.text for one in warnings_of([smoothed(
        'run', t, q, None, 0.0 * q, 0.4 / spacing)], ['a'], ['rad'])] or ['']
    assert told in text and bool(told) == bool(text)


@pytest.mark.parametrize('kind', USELESS)
def test_useless_logs_are_told(logged, tmp_path, kind):
    folder, _ = logged
    USELESS[kind](frame(folder)).to_csv(tmp_path / 'log.csv', index=False)
    try:
        found = check([str(tmp_path / 'log.csv')], folder / 'arm.urdf')
    except DataError as problem:
        print(f'{kind}: {problem}')
        return
    print(f'{kind}: {found.useless}')
    assert found.useless


def test_log_given_twice_is_a_warning(logged, tmp_path, capsys):
    folder, _ = logged
    copy, log = str(tmp_path / 'copy.csv'), str(folder / 'log.csv')
    frame(folder).to_csv(copy, index=False)
    for other in (log, copy):
        (text,) = [one.text for one in check([log, other]).warnings]
        assert text == 'a run has the samples of another: give each log once'
    assert main([log]) == 0
    text = capsys.readouterr().out
    assert '\n1 run, 600 samples' in text and '--robot URDF' in text


def test_good_log_beside_others_is_usable(logged, tmp_path):
    folder, _ = logged
    good, poor = str(folder / 'log.csv'), str(tmp_path / 'poor.csv')
    with_values(frame(folder), R, -frame(folder)[R]).to_csv(poor, index=False)
    assert check([poor], folder / 'arm.urdf').useless
    found = check([good, poor], folder / 'arm.urdf')
    assert not found.useless and 'all runs together: ' in found.warnings[0].text
    assert {one.name: one.value for one in found.numbers} == pytest.approx(
        {one.name: one.value for one in check([good], folder / 'arm.urdf').numbers}, rel=0.1)


def test_missing_log_is_no_verdict(logged, tmp_path):
    with refused(ParameterError):
        main([str(logged[0] / 'log.csv'), str(tmp_path / 'other.csv')])


def test_constant_force_is_named(logged, tmp_path):
    folder, _ = logged
    log = with_values(torques(folder), 'elbow torque [N m]', 0.5)
    log.to_csv(tmp_path / 'log.csv', index=False)
    assert 'elbow torque [N m] is constant or without numbers, and left out' in [
        one.text for one in check([str(tmp_path / 'log.csv')]).warnings]


def with_motors(log: DataFrame, enabled) -> DataFrame:
    return log.assign(enabled=enabled)


@pytest.mark.parametrize('change', [
    lambda log: with_values(log, Q, 0.3), lambda log: with_values(log, Q[0], np.nan),
    lambda log: with_values(log, R, np.nan), lambda log: with_motors(log, np.nan)],
    ids=['constant', 'one without numbers', 'commands without numbers', 'unknown motors'])
def test_columns_without_numbers_are_named(logged, tmp_path, change):
    folder, _ = logged
    change(frame(folder)).to_csv(tmp_path / 'log.csv', index=False)
    with refused(DataError):
        check([str(tmp_path / 'log.csv')], folder / 'arm.urdf')


def test_motors_that_are_off_for_the_whole_log_are_not_overlooked(logged, tmp_path):
    folder, _ = logged
    with_motors(frame(folder), 0).to_csv(tmp_path / 'log.csv', index=False)
    assert check([str(tmp_path / 'log.csv')]).useless == ['the motors are off in all samples']


def test_log_with_one_of_two_commands_is_useless(logged, tmp_path):
    folder, _ = logged
    frame(folder).drop(columns=R[1]).to_csv(tmp_path / 'log.csv', index=False)
    assert check([str(tmp_path / 'log.csv')], folder / 'arm.urdf').useless == [
        '1 command for 2 joints: give one for each']


def test_constant_position_and_large_units_are_warnings(logged, tmp_path):
    folder, _ = logged
    log = with_values(frame(folder), Q[1], 0.3)
    log[Q[0]] *= 180.0 / np.pi
    log.to_csv(tmp_path / 'log.csv', index=False)
    texts = ' '.join(one.text for one in check([str(tmp_path / 'log.csv')]).warnings)
    assert 'elbow position [rad] is constant' in texts and 'more than two turns' in texts


ARRAYS = {
    'one number': {'t': 1.0, 'q': 1.0, 'goal': 2.0},
    'no samples': {'t': np.zeros(0), 'q': np.zeros((0, 2)), 'goal': np.zeros((0, 2))},
    'enabled for three': {'enabled': np.ones((300, 3))}, 'enabled too short': {
        'enabled': np.ones(299)}, 'commands without numbers': {'goal': np.full((300, 2), np.nan)}}


@pytest.mark.parametrize('kind', ARRAYS)
def test_arrays_of_other_shapes_are_one_line(tmp_path, kind):
    t = 0.01 * np.arange(300)
    q = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1)
    np.savez(tmp_path / 'log.npz', **({'t': t, 'q': q, 'goal': q + 0.01} | ARRAYS[kind]))
    with refused(DataError):
        check([str(tmp_path / 'log.npz')])


def test_arrays_without_names_are_angles_with_a_command_for_each(tmp_path):
    t = 0.01 * np.arange(300)
    q = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1)
    for goal, useless in ((q, 0), (q[:, :1], 1)):
        np.savez(tmp_path / 'log.npz', t=t, q=q, goal=goal + 0.01)
        found = check([str(tmp_path / 'log.npz')])
        assert found.names == ['q1', 'q2'] and len(found.useless) == useless


def test_report_is_one_page_with_a_picture_and_an_excitation(logged, tmp_path, capsys):
    folder, _ = logged
    shutil.copy(folder / 'log.csv', tmp_path)
    status = main([str(tmp_path / 'log.csv'), '--robot', str(folder / 'arm.urdf'),
                   '--plot', str(tmp_path / 'log.png'),
                   '--excitation', str(tmp_path / 'move.csv')])
    text = capsys.readouterr().out
    assert status == 0 and 'Verdict: usable' in text and len(text.splitlines()) < 60
    assert (tmp_path / 'log.png').exists()
    moves = read_csv(tmp_path / 'move.csv')
    assert [*moves] == ['time', 'shoulder_command', 'elbow_command']
    assert (np.diff(moves.time) > 0.0).all()
    assert np.abs(moves.shoulder_command).max() == 0.5 == np.abs(moves.elbow_command).max()


@pytest.mark.parametrize('argv', [['--excitation', 'move.csv'], []])
def test_check_without_a_log_or_a_robot_is_refused(argv):
    with refused(ParameterError):
        main(argv)


def test_excitation_says_what_saturates_the_drives_of_the_robot(logged, tmp_path, capsys):
    folder, _ = logged
    text = (folder / 'arm.urdf').read_text().replace('"continuous"', '"revolute"')
    # Masses and centres of arm(), whose shoulder goes to .4 rad.
    weight = 9.81 * (0.6 * 0.125 + 0.4 * 0.35) * np.sin(0.4)
    for effort, said in ((5.0, f'steps of 0.2 rad saturate a drive stiffer than '
                          f'{(5.0 - weight) / 0.2:.3g} N m/rad'), (0.1, 'the drive saturates')):
        (tmp_path / 'arm.urdf').write_text(text.replace(
            '<axis', f'<limit lower="-1" upper="1" effort="{effort}" velocity="5"/><axis'))
        main(['--robot', str(tmp_path / 'arm.urdf'), '--excitation', str(tmp_path / 'move.csv')])
        found = capsys.readouterr().out.splitlines()[0]
        assert found.startswith(f'shoulder: up to {weight:.3g} of {effort:g} N m')
        assert said in found


def test_excitation_needs_no_log(logged, tmp_path):
    folder, _ = logged
    assert main(['--robot', str(folder / 'arm.urdf'),
                 '--excitation', str(tmp_path / 'move.csv')]) == 0
    assert len(read_csv(tmp_path / 'move.csv')) > 100
