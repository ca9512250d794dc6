# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of machines: their measures on motions that are known, and that all is written."""

import json

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.learning.data.motions import EvenMotion, smoothed
from hnn_vi_ros.learning.fit import rigid_body
import numpy as np
import pytest
from studies import machine_tables, published_tables, simulated_arm
from studies.machine_tables import (
    CASES, DEFAULT, dfki_errors, measure_machines, multiarm_errors, NETWORKS, PLAIN, RIGID_BODY,
    rows_of, RUNS, valid_times, WITH_PRIOR)
from studies.published_page import machine_rows


FREE = 'real free double pendulum'


def motion(name: str, n: int = 3000, spacing: float = 0.001) -> EvenMotion:
    t = spacing * np.arange(n)
    q = np.stack([np.sin(t), np.cos(2.0 * t)], axis=-1)
    return smoothed(name, t, q, np.stack([np.cos(t), -2.0 * np.sin(2.0 * t)], axis=-1),
                    np.zeros_like(q), 40.0)


def off_by(error: float, after: int = 0):
    """Return what predicts each motion with an error of both coordinates, from a sample on."""
    def predict(motion, starts, count):
        # Beyond the end of the motion nothing is judged.
        rows = np.minimum(starts[:, None] + np.arange(count + 1), len(motion.t) - 1)
        return motion.q[rows] + error * (np.arange(count + 1) >= after)[:, None]
    return predict


def test_valid_time_is_that_of_the_first_sample_which_is_off(tmp_path):
    letters = [motion(name) for name in ('e', 'q', 'v')]
    found = valid_times(off_by(1.0, after=250), letters, tmp_path)
    assert found == {'valid prediction time [s], e and v': [pytest.approx(0.25)],
                     'valid prediction time [s], e, q and v': [pytest.approx(0.25)]}
    # One that never is counts its full length.
    assert valid_times(off_by(0.0), letters, tmp_path)[
        'valid prediction time [s], e and v'] == [pytest.approx(3.0)]


def test_errors_of_the_free_pendulum_are_means_over_durations_and_then_over_segments(tmp_path):
    rng = np.random.default_rng(0)
    segments = []
    for name in ('val_00', 'val_01'):
        one = motion(name)
        q, v = (part + 0.01 * rng.normal(size=part.shape) for part in (one.q, one.v))
        segments.append(smoothed(name, one.t, q, v, one.tau, 40.0))

    def predict(segment, starts, count):
        # From the first sample as it was recorded, not from what a filter leaves of it.
        assert (segment.q_smooth[0] == segment.q[0]).all()
        assert (segment.v_smooth[0] == segment.v[0]).all()
        return off_by(0.5 * (segment.name == 'val_01'), after=501)(segment, starts, count)
    found = multiarm_errors(predict, segments, tmp_path)
    # Of 500, 1000 and 2000 samples, 0, 500 and 1500 of one segment are off by 0.5.
    expected = 0.5 * 0.5 * np.sqrt([0.0, 0.5, 0.75])
    assert np.allclose([*found.values()], expected[:, None], rtol=1e-12)


def test_later_runs_may_be_sampled_at_rates_of_their_own(tmp_path):
    (tmp_path / 'dfki_double_pendulum').mkdir()
    runs = {}
    for name, spacing in (('acrobot_01', 0.002), ('pendubot_01', 0.0025)):
        one = motion(name, 400, spacing)
        runs |= {f'{name}/t': one.t, f'{name}/q': one.q, f'{name}/dq': one.v,
                 f'{name}/tau': one.tau}
    np.savez(tmp_path / 'dfki_double_pendulum' / 'later.npz', **runs)
    # 0.1 s are 50 samples of one, and 40 of the other.
    found = dfki_errors(off_by(0.5, after=41), [motion('154548')], tmp_path)
    assert np.allclose([found[f'RMS error [rad] after 0.1 s, later {task}'] for task in (
        'acrobot', 'pendubot')], [[0.5], [0.0]], atol=1e-6)


def test_goal_is_met_by_the_mean_of_every_coordinate():
    case = CASES[FREE]
    measure = 'RMS error [rad] over 2 s, validation'
    for ours, met in (([.0050, .0072], True), ([.0030, .0080], False)):
        values = dict.fromkeys(case.references, ours)
        (row,) = (row for row in rows_of(
            'x', case, {model: [values] for model in (NETWORKS, WITH_PRIOR, RIGID_BODY, PLAIN)})
                  if (row['measure'], row['model']) == (measure, NETWORKS))
        assert row['met'] is met and row['ours'] == ours


def test_row_of_a_measure_shows_all_models_and_misses_of_targets_in_bold(tmp_path):
    case = CASES[FREE]
    results = {model: [dict.fromkeys(case.references, [0.001 * k] * 2)] for k, model in enumerate(
        (DEFAULT, NETWORKS, WITH_PRIOR, RIGID_BODY, PLAIN), 2)}
    (tmp_path / 'machines.json').write_text(json.dumps([*rows_of('x', case, results)]))
    first, *others = machine_rows(tmp_path / 'machines.json')
    assert first == ['x', 'RMS error [rad] over 0.5 s, validation', '0.0038, 0.0045',
                     '0.002, 0.002', '0.003, 0.003', '**0.004, 0.004**', '0.005, 0.005',
                     '0.006, 0.006']
    assert len(others) == 2


def test_tables_that_were_stopped_go_on_where_they_were(tmp_path, monkeypatch):
    (tmp_path / 'multiarm_pendulum').mkdir()
    (tmp_path / CASES[FREE].file).touch()
    done, out = [], tmp_path / 'machines.json'

    def run_case(_case, model, _motions, _data, seed, _quick):
        if len(done) == 6:
            done.append('stopped')
            raise KeyboardInterrupt
        done.append((model, seed))
        return dict.fromkeys(CASES[FREE].references, [0.001 * seed] * 2)
    monkeypatch.setattr(machine_tables, 'CASES', {FREE: CASES[FREE]})
    monkeypatch.setattr(machine_tables, 'read_case', lambda case, data: None)
    monkeypatch.setattr(machine_tables, 'run_case', run_case)
    with pytest.raises(KeyboardInterrupt):
        measure_machines(tmp_path, out, range(2), False)
    # As many seeds stand there as were measured.
    assert {row['model']: len(row['seeds']) for row in json.loads(out.read_text())} == {
        DEFAULT: 2, NETWORKS: 1, WITH_PRIOR: 1}
    measure_machines(tmp_path, out, range(2), False)
    # Least squares know no seed.
    expected = [(DEFAULT, 0), (NETWORKS, 0), (WITH_PRIOR, 0), (RIGID_BODY, 0), (PLAIN, 0),
                (DEFAULT, 1), 'stopped', (NETWORKS, 1), (WITH_PRIOR, 1), (PLAIN, 1)]
    assert done == expected
    measure_machines(tmp_path, out, range(2), False)
    assert done == expected
    row = json.loads(out.read_text())[0]
    assert (row['seeds'], row['baseline_seeds']) == ([[0.0, 0.0], [0.001, 0.001]], {PLAIN: 2})
    (tmp_path / RUNS).write_text('[{"case": "x"}]')
    with pytest.raises(ParameterError, match=f'{RUNS}: cannot be read .*move it away'):
        measure_machines(tmp_path, out, range(2), False)


def test_data_that_are_not_there_are_named_and_those_that_are_simulated_are_made(
        tmp_path, monkeypatch, capsys):
    made = []
    monkeypatch.setattr(machine_tables, 'read_case', lambda case, data: None)
    monkeypatch.setattr(machine_tables, 'run_case', lambda case, *_: made.append(
        case.config) or {measure: [1.0] for measure in case.references})
    measure_machines(tmp_path, tmp_path / 'machines.json', range(1), False)
    assert set(made) == {'two_link_arm_chirps'}
    printed = capsys.readouterr().out
    assert all(case.file in printed for case in CASES.values() if isinstance(case.file, str))
    assert 'not there, so not measured' in printed


@pytest.mark.parametrize('cases', [
    {FREE: CASES[FREE]}, pytest.param(CASES, marks=pytest.mark.long)], ids=['one', 'all'])
def test_every_machine_is_measured_and_stands_on_the_page(cases, tmp_path, monkeypatch):
    monkeypatch.setattr(machine_tables, 'CASES', cases)
    # Forces at random fit no rigid body, and its fits would take all that they may.
    for name, value in (('_EVALUATIONS', 1), ('_SAMPLES', 50), ('_WINDOWS', 50)):
        monkeypatch.setattr(rigid_body, name, value)
    monkeypatch.setattr(simulated_arm, '_DURATION', 1.0)
    rng = np.random.default_rng(0)

    def run(name: str, n: int, spacing: float) -> dict[str, np.ndarray]:
        one = motion(name, n, spacing)
        return {f'{name}/t': one.t, f'{name}/q': one.q, f'{name}/dq': one.v,
                f'{name}/tau': rng.normal(size=one.q.shape)}

    (tmp_path / 'lutter_peters_2021').mkdir()
    letter = motion('letters', 60, 0.04)
    np.savez(tmp_path / CASES['two-link arm that writes letters'].file,
             label=['a', 'e', 'q', 'v'], length=[60] * 4, t=np.tile(letter.t, 4),
             **{key: np.tile(values, (4, 1)) for key, values in (
                 ('q', letter.q), ('dq_dt', letter.v), ('ddq_dt2', letter.a_smooth),
                 ('tau', letter.v))})
    (tmp_path / 'dfki_double_pendulum').mkdir()
    for name, runs in (('sysid', ['1', '143524', '143704', '144115', '154548']),
                       ('later', ['acrobot_01', 'pendubot_01'])):
        # The later runs of the two tasks were sampled at different rates.
        np.savez(tmp_path / 'dfki_double_pendulum' / f'{name}.npz', **{
            key: values for one in runs for key, values in run(
                one, 280, 0.0025 if one == 'pendubot_01' else 0.002).items()})
    (tmp_path / 'multiarm_pendulum').mkdir()
    np.savez(tmp_path / 'multiarm_pendulum' / 'double.npz', **{
        key: values for one in ('train_00', 'val_00', 'val_01', 'val_02', 'val_03')
        for key, values in run(one, 2100, 0.001).items() if key[-2:] != '/t'})
    out = tmp_path / 'docs'
    (out / 'learning').mkdir(parents=True)
    (out / 'learning' / 'published_tables.csv').write_text(
        'table,system,seed,measure,value,commit,machine\n')
    assert published_tables.main(['--machines', '--quick', '--data', str(tmp_path),
                                  '--out', str(out)]) == 0
    rows = json.loads((out / 'learning' / 'machines.json').read_text())
    assert [(row['case'], row['model'], row['measure']) for row in rows] == [
        (name, model, measure) for name, case in cases.items()
        for model in case.goals for measure in case.references]
    page = (out / 'learning.md').read_text()
    # A case stands in the first of its rows alone.
    table = [[cell.strip() for cell in line.split('|')] for line in page.splitlines()]
    starts = {row['case']: ['', row['case'], row['measure']] for row in reversed(rows)}
    assert all(start in [line[:3] for line in table] for start in starts.values())
    assert all(row['measure'] in [line[2] for line in table if len(line) > 2] for row in rows)
