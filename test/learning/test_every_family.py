# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Options of train and evaluate that hold for every family, or are refused by its own row."""

from pathlib import Path

from hnn_vi_ros.errors import DataError, Interrupted, ParameterError
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.learning import evaluate, train
from hnn_vi_ros.learning.fit.config import load_config
from hnn_vi_ros.learning.fit.keeping import Keeper
from hnn_vi_ros.learning.fit.loop import Fit
from hnn_vi_ros.models.checkpoint import load_checkpoint
import numpy as np
import pytest

T = 0.05 * np.arange(200)
# A swing, and a body that turns about one axis with a speed that changes.
SWING = {'t': T, 'q': np.sin(2.0 * T)[:, None], 'dq': 2.0 * np.cos(2.0 * T)[:, None]}
ANGLE = T + 0.3 * np.sin(2.0 * T)
BODY = {'t': T, 'q': np.stack([0 * T, 0 * T, np.sin(ANGLE / 2), np.cos(ANGLE / 2)], axis=1),
        'dq': np.stack([0 * T, 0 * T, 1.0 + 0.6 * np.cos(2.0 * T)], axis=1)}
LOG = {
    'coordinates': [{'name': 'x'}], 'hidden': [8], 'adam_steps': 40, 'lbfgs_steps': 40,
    'data': {'kind': 'measured', 'delimiter': 'comma', 'columns': ['t', 'x', 'v'], 'time': 't',
             'q': ['x'], 'p': ['v'], 'derivatives': {'kind': 'savitzky_golay', 'window': 0.45}}}
MACHINE = {
    'coordinates': [{'name': 'x'}], 'hidden': [4], 'family': {'kind': 'mechanical'},
    'data': {'kind': 'arrays', 'tau': None}, 'loss': {
        'kind': 'trajectory', 'forward_steps': 30, 'forward_lbfgs_steps': 40, 'batch': 8,
        'step_size': 0.05, 'windows': [{'duration': 0.1, 'steps': 25}]}}
TURNING = {
    'coordinates': [{'name': 'attitude', 'kind': 'rotation'}], 'hidden': [4], 'batch': 8,
    'family': {'kind': 'lie_group'}, 'data': {'kind': 'arrays', 'tau': None},
    'windows': [{'intervals': 1, 'adam_steps': 25, 'lbfgs_steps': 40, 'lbfgs_windows': 16}]}


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Write a configuration and data of each kind, and return their folder."""
    for name, config in (('log', LOG), ('machine', MACHINE), ('body', TURNING)):
        (tmp_path / f'{name}.yaml').write_text(dump_yaml(config))
    np.savetxt(tmp_path / 'log.csv', np.column_stack([T, SWING['q'], SWING['dq']]), delimiter=',')
    np.savez(tmp_path / 'machine.npz', **SWING)
    np.savez(tmp_path / 'body.npz', **BODY)
    return tmp_path


def words(files: Path, name: str, model: str, *more: str) -> list[str]:
    data = files / f'{name}{".csv" if name == "log" else ".npz"}'
    return ['--config', str(files / f'{name}.yaml'), '--data', str(data), '--out',
            str(files / f'{model}.safetensors'), *more]


# In each stage: Adam and L-BFGS on samples, then windows, whose batches a generator draws.
@pytest.mark.parametrize(('name', 'stop'), [
    ('log', 20), ('log', 60), ('machine', 20), ('machine', 50), ('machine', 90),
    ('body', 20), ('body', 45)])
def test_every_family_resumes_to_the_same_bits(files: Path, monkeypatch, name: str, stop: int):
    train.main(words(files, name, 'whole'))
    save = Keeper.__call__

    def pause(keeper: Keeper, fit: Fit) -> None:
        keeper._stopping = fit.step >= stop
        save(keeper, fit)
    with monkeypatch.context() as context:
        context.setattr(Keeper, '__call__', pause)
        with pytest.raises(Interrupted, match=f'stopped at step {stop}, .*--resume'):
            train.main(words(files, name, 'm'))
    train.main(words(files, name, 'm', '--resume'))
    one, other = (load_checkpoint(files / f'{model}.safetensors') for model in ('whole', 'm'))
    assert one.card.losses == other.card.losses
    for network, layers in one.networks.items():
        for mine, theirs in zip(layers, other.networks[network], strict=True):
            assert all(map(np.array_equal, mine, theirs))


@pytest.mark.parametrize(('config', 'option', 'message'), [
    ('turning_pendulum', ['--ensemble', '3'],
     'turning_pendulum.yaml: --ensemble: a lie_group has momenta or forces of its own'),
    ('vin', ['--ensemble', '3'], '--ensemble: a vin has momenta .*; families: hnn, '),
    ('two_joint_arm', ['--ensemble', '3'], '--ensemble: a rigid_body has the uncertainty of each'),
    ('turning_pendulum', ['--device', 'cuda'], '--device: a lie_group is trained on the CPU'),
    ('two_joint_arm', ['--device', 'cuda'], '--device: a rigid_body is trained on the CPU'),
    ('dfki_double_pendulum', ['--device', 'cuda'], '--device: a mechanical is trained on the')])
def test_option_that_a_family_does_not_take_is_refused_by_its_row(
        tmp_path: Path, config: str, option: list[str], message: str):
    name = 'variational_pendulum' if config == 'vin' else config
    with pytest.raises(ParameterError, match=f'{message}.*; leave it out$') as problem:
        train.main(['--config', name, '--out', str(tmp_path / 'm.safetensors'), *option])
    assert '\n' not in str(problem.value) and not any(tmp_path.iterdir())


def test_model_is_evaluated_by_the_log_and_the_configuration_it_was_trained_with(
        files: Path, capsys):
    train.main(words(files, 'log', 'm'))
    capsys.readouterr()
    model = str(files / 'm.safetensors')
    evaluate.main([model, '--config', str(files / 'log.yaml'), '--data', str(files / 'log.csv'),
                   '--json', str(files / 'm.json')])
    said = capsys.readouterr().out
    assert 'log.csv (200 rows' in said and '| constant velocity |' in said
    # The file may be that of the configuration.
    named = LOG | {'data': LOG['data'] | {'path': 'log.csv'}}
    (files / 'named.yaml').write_text(dump_yaml(named))
    evaluate.main([model, '--config', str(files / 'named.yaml')])
    assert capsys.readouterr().out == said.replace('log.yaml', 'named.yaml')


def test_model_is_evaluated_by_motions_that_a_configuration_computes(files: Path, capsys):
    exact = {'coordinates': [{'name': 'x'}], 'data': {
        'kind': 'exact', 'hamiltonian': {'kind': 'harmonic_oscillator'}, 'samples': 10,
        'box': {'q': [[-1.0, 1.0]], 'p': [[-1.0, 1.0]]},
        'trajectory': {'duration': 2.0, 'spacing': 0.05}}}
    (files / 'exact.yaml').write_text(dump_yaml(exact))
    evaluate.main(['harmonic_oscillator', '--config', str(files / 'exact.yaml')])
    # The shipped model knows this oscillator.
    assert 'follows the machine for at least' in capsys.readouterr().out
    del exact['data']['trajectory']
    (files / 'exact.yaml').write_text(dump_yaml(exact))
    with pytest.raises(DataError, match='no motions, but single states; give data with times'):
        evaluate.main(['harmonic_oscillator', '--config', str(files / 'exact.yaml')])
    with pytest.raises(ParameterError, match='--data: expected measured motions, or'):
        evaluate.main(['harmonic_oscillator'])
    with pytest.raises(DataError, match='are motions of a body that turns'):
        evaluate.main(['harmonic_oscillator', '--config', 'turning_pendulum'])


def test_unknown_family_is_answered_with_all_there_are(tmp_path: Path):
    path = tmp_path / 'm.yaml'
    path.write_text('family: {kind: mechanicl}\n')
    with pytest.raises(DataError, match=(
            r"m.yaml:1: family.kind: unknown kind 'mechanicl'; did you mean mechanical\?; valid "
            'kinds: control_affine, .*, lie_group, mechanical, rigid_body, ')):
        load_config(path)
