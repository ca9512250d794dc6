# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""From arrays to a verdict: the executables train and evaluate, on a machine that is known."""

from dataclasses import replace
import json
from pathlib import Path

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import ArraysData, evaluate, EvenMotion, train
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.fit.windows import ModelParts
from hnn_vi_ros.learning.judging.evaluation import score, TrajectoryBundle, whole_records
from hnn_vi_ros.learning.judging.predictors import constant_velocity, linear_model, simulated
from hnn_vi_ros.learning.judging.report import shown
from hnn_vi_ros.models import load_checkpoint, save_checkpoint
from hnn_vi_ros.simulation import Simulation
from machines import driven, from_file
from messages import assert_message, refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from trainings import trained, Training

# Not the installed file, whose folder depends on the machine.
PENDULUM = Path(__file__).parents[2] / 'config' / 'training' / 'pendulum.yaml'
SCENE = {
    'hamiltonian': {'kind': 'pendulum'}, 'integrator': {'kind': 'implicit_midpoint'},
    'step_size': 0.01, 'initial_state': {'q': [0.5], 'p': [0.0]},
    'effects': [{'kind': 'external_force', 'coordinates': ['angle']}]}
CONFIG = {
    'description': 'A simulated pendulum (Apache-2.0).',
    'coordinates': [{'name': 'angle', 'kind': 'continuous'}], 'hidden': [8],
    'data': {'kind': 'arrays', 'test_runs': ['c']},
    'family': {'kind': 'mechanical', 'prior': 'none', 'mass': 'constant'},
    'loss': {'kind': 'trajectory', 'forward_steps': 100, 'forward_lbfgs_steps': 0,
             'windows': [{'duration': 0.1, 'steps': 5}]}}


def swings() -> dict[str, np.ndarray]:
    """Return runs of a pendulum under forces, every 10 ms, by the rule that will judge them."""
    simulation = Simulation(
        HAMILTONIANS['pendulum'](), INTEGRATORS['implicit_midpoint'](), 0.01, [0.5], [0.0],
        [EFFECTS['external_force'](['angle'], timeout=100.0)])
    arrays, t = {}, 0.01 * np.arange(400)
    for name, start, rate in (('a', 0.5, 2.0), ('b', -1.0, 3.0), ('c', 1.5, 2.5)):
        simulation.restart([start], [0.0])
        tau = 2.0 * np.sin(rate * t)[:, None]
        q, v = driven(simulation, tau)
        arrays |= {f'{name}/t': t, f'{name}/q': q, f'{name}/dq': v, f'{name}/tau': tau}
    return arrays


def test_measured_forces_replace_the_drive_of_a_scene(tmp_path, capsys):
    np.savez(tmp_path / 'm.npz', **swings())
    drive = {'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.5}
    tables = []
    for name, effects in (('bare', SCENE['effects']), ('driven', [*SCENE['effects'], drive])):
        (tmp_path / f'{name}.yaml').write_text(dump_yaml(SCENE | {'effects': effects}))
        evaluate.main([str(tmp_path / f'{name}.yaml'), '--data', str(tmp_path / 'm.npz')])
        said, *table = capsys.readouterr().out.splitlines()
        assert ('replace the periodic_drive of angle' in said) == (name == 'driven')
        tables.append(table)
    assert tables[0] == tables[1]


@pytest.fixture(scope='module')
def made(pytestconfig) -> Training:
    """Return a machine that is hardly trained, and its motions."""
    return trained(pytestconfig, 'pendulum', CONFIG, swings)


def test_arrays_become_a_model_and_a_report_in_one_command(made):
    assert 'The model follows the machine for' in made.said and '| linear model |' in made.said
    assert '| rigid body |' in made.said
    card = load_checkpoint(made.model).card
    assert card.family == 'mechanical' and card.mechanical.kinds == ['continuous']
    # Where the data come from goes with the model.
    assert card.dataset.startswith('A simulated pendulum (Apache-2.0). m.npz: a, b, c (')
    page = made.model.with_suffix('.report.md').read_text()
    assert '| model |' in page and '(m.predictions.png)' in page
    error = card.energy_error
    assert error.against == 'work of forces and friction' and error.states == 400
    assert f'the RMS error of H is {error.rms:.3g} J' in page
    # So does how far it can be trusted: the numbers of the table.
    cells = [f'{rms:.4g}' for horizon in ('0.1', '0.5')
             for rms in card.prediction_error.horizons[horizon]]
    assert f'| model | angle [1] | {" | ".join(cells)} |' in page
    assert (made.folder / 'm.predictions.png').exists()
    assert '| range of the data | ' in page and '\nforce on ' in page
    # The scene beside it runs.
    assert np.isfinite(simulate(made.folder / 'm.scene.yaml', duration=0.1).q).all()
    with refused(ParameterError):
        train.main(['--config', made.config, '--data', made.data, '--out', str(made.model)])


def test_model_is_judged_in_a_second_command(made, tmp_path, capsys):
    found, data, out = load_checkpoint(made.model).card.prediction_error, made.data, made.model
    evaluate.main([str(out), '--data', f'{data}:c', '--json', str(tmp_path / 'machine.json'),
                   '--horizons', '0.1', '0.5', '--baselines', f'{data}:a,b'])
    said = capsys.readouterr().out
    assert '| linear model |' in said and '| rigid body |' not in said
    written = json.loads((tmp_path / 'machine.json').read_text())
    outside = written.pop('outside')
    assert 0.0 < outside['share'] < 1.0 and outside['errors'].keys() == {'inside', 'outside'}
    assert f'outside the training domain of the model: {outside["beyond"][0]}' in said
    assert written | {'baselines': None} == found.model_dump() | {'baselines': None}
    (motion,), _ = from_file(f'{Path(data)}:c', ArraysData(), 1)
    still = score(constant_velocity, [motion], [0.1, 0.5], 0.05, 2.0)
    assert set(written['energy_mismatch']) == {'0.1', '0.5'}
    # Hardly trained, it is far better than no model.
    assert set(written['baselines']) == {'constant velocity', 'linear model'}
    expected = evaluate.as_json({'model': still})
    assert not expected.pop('baselines') and expected['energy_mismatch'] is None
    assert written['baselines']['constant velocity'] == expected
    for horizon in ('0.1', '0.5'):
        assert 0.0 < written['horizons'][horizon][0] < 0.5 * still.horizons[float(horizon)][0]
    evaluate.main([str(out), '--data', data, '--config', made.config, '--held-out', '--whole',
                   '--baselines', f'{data}:a,b', '--json', str(tmp_path / 'whole.json')])
    whole = json.loads((tmp_path / 'whole.json').read_text())
    # Judged by what a training holds out, alone; baselines learn from what they are given.
    assert whole['horizons'] == found.model_dump()['horizons']
    assert whole['baselines'] == written['baselines']
    (one,) = whole['whole']
    assert one['run'] == 'c' and f'| c | 3.99 | {one["rms"][0]:.4g} |' in capsys.readouterr().out
    with refused(DataError):
        evaluate.main([str(out), '--data', f'{data}:a,b', '--config', made.config, '--held-out'])
    # Velocities are judged run by run: those of a are differences of the positions.
    runs = dict(np.load(data))
    runs['a/dq'] = np.vstack([[[0.0]], np.diff(runs['a/q'], axis=0) / 0.01])
    np.savez(tmp_path / 'mixed.npz', **runs)
    evaluate.main([str(out), '--data', str(tmp_path / 'mixed.npz')])
    assert 'velocities of a are differences of the positions' in capsys.readouterr().out
    # Positions alone tell their noise.
    evaluate.main([str(out), '--data', f'{data}:c', '--keys', 't,q,,tau'])
    said = capsys.readouterr().out
    assert 'On these motions its residuals' in said and 'is part of the errors above.' in said


def test_evaluate_takes_forces_between_samples_as_the_model_does(made, tmp_path, capsys):
    checkpoint = load_checkpoint(made.model)
    mechanical = checkpoint.card.mechanical.model_copy(update={'inputs': 'spline'})
    smooth = tmp_path / 'smooth.safetensors'
    save_checkpoint(smooth, replace(checkpoint, card=checkpoint.card.model_copy(
        update={'mechanical': mechanical})))
    config = {name: dict(CONFIG['data'], **data) for name, data in (
        ('none', {}), ('spline', {'inputs': 'spline'}), ('linear', {'inputs': 'linear'}))}
    log, errors = str(sparse(made, tmp_path)), {}
    for model, data in ((made.model, 'none'), (made.model, 'spline'), (smooth, 'none'),
                        (smooth, 'linear')):
        path = tmp_path / f'{data}.yaml'
        path.write_text(dump_yaml(CONFIG | {'data': config[data]}))
        found = tmp_path / f'{model.stem}_{data}.json'
        evaluate.main([str(model), '--data', log, '--config', str(path), '--json', str(found)])
        errors[model == smooth, data] = json.loads(
            found.read_text())['horizons']['0.5'][0]
        said = 'as spline, as in the data of the model' in capsys.readouterr().out
        assert said is (model == smooth and data == 'none')
    assert errors[True, 'none'] == pytest.approx(errors[False, 'spline'], rel=1e-9)
    assert abs(errors[True, 'none'] / errors[False, 'none'] - 1.0) > 1e-6
    # What the user states holds.
    assert errors[True, 'linear'] == pytest.approx(errors[False, 'none'], rel=1e-9)


def sparse(made: Training, folder: Path) -> Path:
    """Return a file of every fourth sample of a run, between which the courses differ."""
    with np.load(made.data) as arrays:
        np.savez(folder / 'sparse.npz', **{
            key.partition('/')[2]: part[::4] for key, part in arrays.items() if key[0] == 'c'})
    return folder / 'sparse.npz'


def test_samples_further_apart_than_the_shortest_horizon_are_judged(tmp_path, capsys):
    simulation = Simulation(
        HAMILTONIANS['pendulum'](), INTEGRATORS['implicit_midpoint'](), 0.01, [0.5], [0.0],
        [EFFECTS['external_force'](['angle'], timeout=100.0)])
    q, v = driven(simulation, np.zeros((4000, 1)))
    np.savez(tmp_path / 'rare.npz', t=0.2 * np.arange(200), q=q[::20], dq=v[::20])
    config = tmp_path / 'rare.yaml'
    config.write_text(dump_yaml(CONFIG | {
        'data': {'kind': 'arrays', 'tau': None},
        'loss': CONFIG['loss'] | {'windows': [{'duration': 0.4, 'steps': 5}]}}))
    model = tmp_path / 'rare.safetensors'
    train.main(['--config', str(config), '--data', str(tmp_path / 'rare.npz'), '--out',
                str(model)])
    assert '| prediction | RMS error of | after 0.2 s | after 1 s |' in capsys.readouterr().out
    assert [*load_checkpoint(model).card.prediction_error.horizons] == ['0.2', '1']
    evaluate.main([str(model), '--data', str(tmp_path / 'rare.npz'), '--keys', 't,q,dq'])
    assert '| prediction | RMS error of | after 0.2 s | after 1 s |' in capsys.readouterr().out


@pytest.mark.long
def test_report_names_the_force_that_is_missing_although_it_is_small_in_the_test(tmp_path, capsys):
    """Quadratic drag: at the end, where the test is, hardly a tenth of that at the start."""
    t = 0.01 * np.arange(3000)
    q = solve_ivp(lambda t, z: [z[1], -14.0 * np.sin(z[0]) - 0.08 * z[1] * abs(z[1])], (0.0, 30.0),
                  [2.5, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[0]
    q += 3e-3 * np.random.default_rng(0).normal(size=len(t))
    np.savez(tmp_path / 'drag.npz', t=t, q=q[:, None])
    config = tmp_path / 'drag.yaml'
    config.write_text(dump_yaml(CONFIG | {
        'data': {'kind': 'arrays', 'v': None, 'tau': None}, 'loss': {'kind': 'trajectory'},
        'family': {'kind': 'mechanical', 'prior': 'pendulum', 'residual': False}}))
    train.main(['--config', str(config), '--data', str(tmp_path / 'drag.npz'), '--out',
                str(tmp_path / 'drag.safetensors')])
    assert 'is missing, which goes with velocity' in capsys.readouterr().out


def check_report(folder: Path) -> None:
    """Check the files of an evaluation."""
    page = (folder / 'report.md').read_text()
    for words in ('| model |', 'The model follows the machine for at least 2 s',
                  '(predictions.png)'):
        assert words in page
    assert (folder / 'predictions.png').read_bytes().startswith(b'\x89PNG')


def test_shown_predictions_end_where_a_simulation_failed():
    motion = linear_motion(1)
    starts = np.arange(0, 300, 5)
    q = constant_velocity(motion, starts, 100)
    q[0, 10:], q[30:, 40:] = np.nan, np.inf
    (run,) = shown([TrajectoryBundle(motion, starts, q)], 0.5)
    assert [len(t) for t, _ in run.predicted[:2]] == [10, 51]
    assert len(run.predicted[-1][0]) == 40
    assert all(np.isfinite(q).all() for _, q in run.predicted)
    # Every 0.125 s, taken from the starts, which are every 0.05 s.
    begins = np.array([t[0] for t, _ in run.predicted])
    assert np.diff(begins).min() >= 0.1 - 1e-9 and np.diff(begins).max() <= 0.15 + 1e-9


def test_scene_that_made_the_motions_follows_them_to_their_end(made, drawn, tmp_path, capsys):
    data = made.data
    (tmp_path / 'scene.yaml').write_text(dump_yaml(SCENE))
    report = tmp_path / 'new' / 'report'
    evaluate.main([str(tmp_path / 'scene.yaml'), '--data', data, '--json',
                   str(tmp_path / 'scene.json'), '--out', str(report)])
    check_report(report)
    written = json.loads((tmp_path / 'scene.json').read_text())
    # What is left is what the filter at 40 Hz does to the first states, near the ends of runs.
    assert max(written['horizons']['0.1']) < 1e-2 and max(written['horizons']['0.5']) < 3e-2
    assert written['failed'] == 0 and written['censored'] > 0.9
    # The trapezoidal rule's h^2 / 12 of the power's second derivative, and what the filter does.
    assert 0.0 < max(written['energy_mismatch'].values()) < 2e-3
    for option, path in (('--json', tmp_path / 'scene.json'), ('--out', report)):
        with refused(ParameterError):
            evaluate.main([str(tmp_path / 'scene.yaml'), '--data', data, option, str(path)])
    (tmp_path / 'free.yaml').write_text(dump_yaml(SCENE | {'effects': []}))
    with pytest.raises(DataError, match='no effect external_force'):
        evaluate.main([str(tmp_path / 'free.yaml'), '--data', data])


@pytest.mark.parametrize('words', [
    ['--data', __file__], ['--data', 'arm.txt'], ['--data', 'nothing.npz'],
    ['--data', 'arm.npz', '--horizons', '-1'], ['--data', 'arm.npz', '--keys', 'q'],
    ['--data', 'arm.npz', '--from', '20'], ['--data', 'arm.npz', '--held-out'],
    ['--config', str(PENDULUM), '--held-out'],
    ['--config', 'two_joint_arm', '--data', 'arm.npz'], ['--data', 'mathieu.npz']], ids=range(10))
def test_evaluate_refuses_in_one_line(words):
    with refused(DataError, ParameterError):
        evaluate.main(['mathieu' if words[-1] == 'mathieu.npz' else 'pendulum', *words])


@pytest.mark.parametrize('words', [
    ['--horizons', '1e308'], ['--horizons', '0.5', '0.001'], ['--smoothing', '1e-9'],
    ['--baselines', 'nothing.npz'], ['--out', 'same', '--json', 'same'],
    ['--json', 'scene.yaml/file.json'], ['--keys', 't,q,velocity'], ['--keys', 't,q,q'],
    ['--whole', '--from', '59']], ids=' '.join)
def test_evaluate_refuses_what_motions_do_not_hold_in_one_line(
        made, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    with np.load(made.data) as motions:
        moves = 't,q,q' not in words
        np.savez('pendulum.npz', **{
            key: (moves or not key.endswith('/q')) * values[:60]
            for key, values in motions.items()})
    (tmp_path / 'scene.yaml').write_text(dump_yaml(SCENE))
    with refused(DataError, ParameterError):
        evaluate.main(['scene.yaml', '--data', 'pendulum.npz', *words])
    assert not (tmp_path / 'same').exists()


def test_numbers_of_any_size_are_taken_as_far_as_the_motions_go(
        made, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'scene.yaml').write_text(dump_yaml(SCENE))
    evaluate.main(['scene.yaml', '--data', f'{made.data}:c', '--every', '1e300', '--longest',
                   '1e308', '--out', 'report', '--json', 'report/numbers.json'])
    written = json.loads((tmp_path / 'report' / 'numbers.json').read_text())
    # One prediction, from the first of the 400 samples to the last.
    assert written['valid_prediction_time'] == pytest.approx(3.99)
    assert '(predictions.png)' in (tmp_path / 'report' / 'report.md').read_text()
    capsys.readouterr()


def test_state_that_a_scene_does_not_allow_is_named(made, tmp_path):
    scene = SCENE | {'effects': [*SCENE['effects'], {'kind': 'impact', 'coordinate': 'angle'}]}
    (tmp_path / 'wall.yaml').write_text(dump_yaml(scene))
    with refused(DataError):
        evaluate.main([str(tmp_path / 'wall.yaml'), '--data', f'{made.data}:a'])


def test_drive_of_a_scene_has_the_phase_of_the_measured_time(tmp_path):
    """Every start: a drive that began anew with each prediction would have another phase."""
    scene = SCENE | {'effects': [{
        'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 3.0, 'frequency': 0.7}]}
    (tmp_path / 'scene.yaml').write_text(dump_yaml(scene))
    made = simulate(load_scene(tmp_path / 'scene.yaml'), 4.0)
    np.savez(tmp_path / 'driven.npz', t=made.t, q=made.q, dq=made.p)
    evaluate.main([str(tmp_path / 'scene.yaml'), '--data', str(tmp_path / 'driven.npz'), '--keys',
                   't,q,dq', '--json', str(tmp_path / 'found.json')])
    # What is left is what the filter at 40 Hz does to the first states.
    assert json.loads((tmp_path / 'found.json').read_text())['horizons']['0.5'][0] < 1e-2


def test_forces_act_on_all_coordinates_and_models_bring_their_own_friction(tmp_path):
    scene = {'hamiltonian': {'kind': 'double_pendulum'}, 'step_size': 0.01,
             'integrator': {'kind': 'implicit_midpoint'},
             'initial_state': {'q': [0.5, 0.0], 'p': [0.0, 0.0]},
             'effects': [{'kind': 'external_force', 'coordinates': ['angle2']}]}
    (tmp_path / 'scene.yaml').write_text(dump_yaml(scene))
    (force,) = evaluate.parts_of(str(tmp_path / 'scene.yaml')).effects
    assert force.names == ('angle1', 'angle2')
    models = Path(__file__).parents[2] / 'resource' / 'models'
    for name, kinds in (('discrete_gradient_pendulum', ['ExternalForce', 'Damping']),
                        ('damped_pendulum', ['ExternalForce', 'LearnedDissipation']),
                        ('double_pendulum_velocity', [])):
        parts = evaluate.parts_of(str(models / f'{name}.safetensors'))
        assert [type(effect).__name__ for effect in parts.effects] == kinds
        assert parts.hamiltonian.canonical == bool(kinds)


def test_coordinate_that_never_moves_does_not_count_in_the_valid_prediction_time():
    motion = linear_motion(1)
    still = replace(motion, **{name: np.hstack([values, np.zeros_like(values)])
                               for name, values in vars(motion).items() if np.ndim(values) == 2})

    def off(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        at = np.minimum(starts[:, None] + np.arange(count + 1), len(motion.t) - 1)
        return motion.q[at] + [0.0, 1e-9]
    with np.errstate(all='raise'):
        assert score(off, [still], [0.5], 0.1, 1.0).censored == 1.0


def test_noise_ends_no_valid_prediction_of_a_small_motion():
    exact, rng = linear_motion(1), np.random.default_rng(0)
    noise = 0.05 * np.sqrt(exact.q.var(axis=0))
    measured = replace(exact, q=exact.q + noise * rng.normal(size=exact.q.shape))

    def right(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        return exact.q[np.minimum(starts[:, None] + np.arange(count + 1), len(exact.t) - 1)]
    assert score(right, [measured], [0.5], 0.1, 1.0).valid_prediction_time < 0.5
    # Five sigma: of 400 samples, one exceeds them with a probability of 2e-4.
    assert score(right, [measured], [0.5], 0.1, 1.0, noise).censored == 1.0


def linear_motion(seed: int) -> EvenMotion:
    """Return q'' = -4 q + tau by its exact solution for tau = sin(t)."""
    t = 0.01 * np.arange(400)
    a, b = np.random.default_rng(seed).normal(size=2)
    q = a * np.cos(2.0 * t) + b * np.sin(2.0 * t) + np.sin(t) / 3.0
    v = -2.0 * a * np.sin(2.0 * t) + 2.0 * b * np.cos(2.0 * t) + np.cos(t) / 3.0
    return smoothed('linear', t, q[:, None], v[:, None], np.sin(t)[:, None], 40.0)


def test_linear_model_is_right_for_a_linear_system_and_errors_are_counted_at_the_horizon():
    train_motions, test_motions = [linear_motion(1), linear_motion(2)], [linear_motion(3)]
    linear = score(linear_model(train_motions), test_motions, [0.5], 0.1, 1.0)
    still = score(constant_velocity, test_motions, [0.5], 0.1, 1.0)
    assert linear.horizons[0.5] < 0.02 * still.horizons[0.5]
    assert still.starts[0.5] == 35  # every 0.1 s of 3.99 s, with 0.5 s to come

    def off_by_one_percent(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        at = np.minimum(starts[:, None] + np.arange(count + 1), len(motion.t) - 1)
        return motion.q[at] + 0.01 * (np.arange(count + 1) >= 30)[:, None]
    found = score(off_by_one_percent, test_motions, [0.2, 0.5], 0.1, 1.0)
    assert found.horizons[0.2] == pytest.approx(0.0, abs=1e-15)
    assert found.horizons[0.5] == pytest.approx(0.01, rel=1e-9)
    assert found.censored == 1.0  # 0.01^2 is far below a hundredth of the variance


def test_whole_runs_are_simulated_once_from_the_sample_that_is_named():
    motion, calls = linear_motion(1), []

    def off(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        calls.append((starts.tolist(), count))
        return motion.q[starts[0]:][None] + 0.01
    # Two bags may have one name.
    assert whole_records(off, [motion, motion], 20) == [pytest.approx([0.01], rel=1e-9)] * 2
    assert calls == [([20], 379)] * 2
    assert np.isinf(whole_records(lambda *_: np.full((1, 400, 1), np.nan), [motion], 0)[0])


def test_failure_names_its_cause_and_joints_without_rotors(caplog):
    chain = HAMILTONIANS['double_pendulum'](mass1=3.0, mass2=1e-4)
    parts = ModelParts(chain, INTEGRATORS['implicit_midpoint'](), [], 0.1)
    one = np.ones((50, 1))
    motion = smoothed('run', 0.1 * np.arange(50), one * [2.0, 0.0], one * [0.0, 1e3],
                      one * [0.0, 0.0], 40.0)
    q = simulated(parts)(motion, np.array([0, 5]), 30)
    assert np.isnan(q).any() and len(caplog.records) == 1
    assert_message(caplog.records[0].getMessage())


def test_failed_simulations_are_counted_and_no_number_is_made_up_for_them():
    def fails(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        q = constant_velocity(motion, starts, count)
        q[0, 10:] = np.nan
        return q
    found = score(fails, [linear_motion(1)], [0.05, 0.5], 0.1, 1.0)
    assert found.failed == 1
    assert np.isfinite(found.horizons[0.05]).all() and np.isinf(found.horizons[0.5]).all()
    assert evaluate.as_json({'model': found})['horizons']['0.5'] == [None]
