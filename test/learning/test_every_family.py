# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Options of train and evaluate that hold for every family, or are refused by its own row."""

from functools import partial
from pathlib import Path

from helpers import long
from hnn_vi_ros.errors import DataError, Interrupted, ParameterError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.learning import evaluate, train
from hnn_vi_ros.learning.fit import config as schemas
from hnn_vi_ros.learning.fit.config import find_config, load_config
from hnn_vi_ros.learning.fit.loop import Fitted, INTERVAL, trained, TrainingCheckpoint, TrainingRun
from hnn_vi_ros.learning.tasks.field import FIELD
from hnn_vi_ros.models import load_checkpoint
from messages import refused
import numpy as np
import pytest
import torch

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
    'coordinates': [{'name': 'x'}], 'hidden': [4],
    'family': {'kind': 'mechanical', 'prior': 'none'},
    'data': {'kind': 'arrays', 'tau': None}, 'loss': {
        'kind': 'trajectory', 'forward_steps': 30, 'forward_lbfgs_steps': 40, 'batch': 8,
        'step_size': 0.05, 'windows': [{'duration': 0.1, 'steps': 25}]}}
TURNING = {
    'coordinates': [{'name': 'attitude', 'kind': 'rotation'}], 'hidden': [4], 'batch': 8,
    'family': {'kind': 'lie_group'}, 'data': {'kind': 'arrays', 'tau': None},
    'windows': [{'intervals': 1, 'adam_steps': 25, 'lbfgs_steps': 40, 'lbfgs_windows': 16}]}
EXACT = {'kind': 'exact', 'hamiltonian': {'kind': 'harmonic_oscillator'}, 'samples': 30,
         'box': {'q': [[-1.0, 1.0]], 'p': [[-1.0, 1.0]]},
         'trajectory': {'duration': 0.2, 'spacing': 0.1}}
# What the families of fields need beside that.
FIELDS = {
    'hnn': {}, 'separable_hnn': {}, 'dissipative_hnn': {}, 'symplectic_form': {},
    'dgnet': {'loss': {'kind': 'discrete_gradient', 'step_size': 0.1}},
    'vin': {'loss': {'kind': 'discrete_lagrangian', 'step_size': 0.1}},
    'lagrangian': {'loss': {'kind': 'euler_lagrange'}},
    'control_affine': {'data': EXACT | {'commands': {'input_map': [[0.5]], 'largest': 2.0}}}}
# A shipped configuration of each family, and the options that it takes.
TAKEN = {
    'pendulum': 'device ensemble resume', 'separable_pendulum': 'device ensemble resume',
    'damped_pendulum': 'device resume', 'discrete_gradient_pendulum': 'device resume',
    'variational_pendulum': 'device resume', 'lagrangian_double_pendulum': 'device resume',
    'driven_double_pendulum': 'device resume', 'double_pendulum_velocity': 'device resume',
    'dfki_double_pendulum': 'ensemble resume', 'two_joint_arm': 'resume',
    'turning_pendulum': 'resume'}


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
    long('log', 60), long('machine', 50), ('machine', 90), ('body', 45)])
def test_every_family_resumes_to_the_same_bits(files: Path, monkeypatch, name: str, stop: int):
    train.main(words(files, name, 'whole'))
    save = TrainingCheckpoint.__call__

    def pause(keeper: TrainingCheckpoint, run: TrainingRun) -> None:
        keeper._stopping = run.step >= stop
        save(keeper, run)
    with monkeypatch.context() as context:
        context.setattr(TrainingCheckpoint, '__call__', pause)
        with pytest.raises(Interrupted):
            train.main(words(files, name, 'm'))
    train.main(words(files, name, 'm', '--resume'))
    one, other = (load_checkpoint(files / f'{model}.safetensors') for model in ('whole', 'm'))
    assert one.card.losses == other.card.losses
    for network, layers in one.networks.items():
        for mine, theirs in zip(layers, other.networks[network], strict=True):
            assert all(map(np.array_equal, mine, theirs))


# In the first steps of L-BFGS, before any step, in those of Adam, and when L-BFGS has a history.
@pytest.mark.parametrize('kind, stop, more', [
    ('hnn', 60, {}), ('hnn', 60 + 2 * INTERVAL, {'patience': 3}), ('vin', 60 + INTERVAL, {}),
    *(long('hnn', stop, more) for stop in (0, INTERVAL, 60, 60 + 2 * INTERVAL)
      for more in ({}, {'patience': 3})),
    *(long(kind, 60 + INTERVAL, {}) for kind in FIELDS if kind not in ('hnn', 'vin'))])
def test_each_family_of_fields_resumes_to_the_same_bits(
        tmp_path: Path, monkeypatch, kind: str, stop: int, more: dict):
    torch.set_num_threads(1)  # as train does
    path = tmp_path / 'm.yaml'
    path.write_text(dump_yaml({
        'coordinates': [{'name': 'x'}], 'hidden': [8], 'adam_steps': 60, 'lbfgs_steps': 80,
        'data': EXACT, 'family': {'kind': kind}} | FIELDS[kind] | more))
    config = load_config(path)
    data = FIELD.read(path, config, [], False)
    whole = FIELD.fit(data, config, 'cpu')
    save, steps = TrainingCheckpoint.__call__, []

    def pause(keeper: TrainingCheckpoint, run: TrainingRun) -> None:
        keeper._stopping = run.step == stop and not keeper.resumes
        steps.append(run.step)
        save(keeper, run)
    monkeypatch.setattr(TrainingCheckpoint, '__call__', pause)

    def fit(resumes: bool) -> Fitted:
        keeper = TrainingCheckpoint(tmp_path / 'm.training', config, data.arrays, 'cpu', resumes)
        return FIELD.fit(data, config, 'cpu', partial(trained, keeper=keeper))
    with pytest.raises(Interrupted):
        fit(False)
    steps.clear()
    resumed = fit(True)
    assert steps[0] == stop
    assert resumed.history == whole.history
    for one, other in zip(whole.module.parameters(), resumed.module.parameters(), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize('config', TAKEN)
def test_each_option_is_taken_or_refused_by_the_row_of_the_family(
        tmp_path: Path, monkeypatch, config: str):
    class Begun(Exception):
        """Training has begun: every option was taken."""

    def begin(*arguments: object) -> None:
        raise Begun
    monkeypatch.setattr(train, '_TASKS', {
        schema: task._replace(read=begin) for schema, task in train._TASKS.items()})
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: True)
    # Not the installed file, whose folder depends on the machine.
    path = Path(__file__).parents[2] / 'config' / 'training' / f'{config}.yaml'
    for option, more in (('device', ['cuda']), ('ensemble', ['3']), ('resume', [])):
        asked = ['--config', str(path), '--out', str(tmp_path / 'm.safetensors'), f'--{option}',
                 *more]
        if option in TAKEN[config]:
            with pytest.raises(Begun):
                train.main(asked)
        else:
            with refused(ParameterError):
                train.main(asked)
    assert not any(tmp_path.iterdir())


def test_options_are_tried_with_every_family():
    families = {load_config(find_config(name)).family.kind for name in TAKEN}
    assert families == schemas._SCHEMAS.keys()
    fields = {kind for kind, schema in schemas._SCHEMAS.items() if schema is schemas.FieldConfig}
    assert fields == FIELDS.keys()


def test_model_is_evaluated_by_the_log_and_the_configuration_it_was_trained_with(
        files: Path, capsys):
    train.main(words(files, 'log', 'm'))
    capsys.readouterr()
    model = str(files / 'm.safetensors')
    evaluate.main([model, '--config', str(files / 'log.yaml'), '--data', str(files / 'log.csv'),
                   '--json', str(files / 'm.json')])
    said = capsys.readouterr().out
    assert 'log.csv (192 samples' in said and '| constant velocity |' in said
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
    with refused(DataError):
        evaluate.main(['harmonic_oscillator', '--config', str(files / 'exact.yaml')])
    with refused(ParameterError):
        evaluate.main(['harmonic_oscillator'])
    with pytest.raises(DataError, match='are motions of a rotating body'):
        evaluate.main(['harmonic_oscillator', '--config', 'turning_pendulum'])
