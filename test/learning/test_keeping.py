# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A model that was trained is never lost, whatever fails behind its training."""

from dataclasses import replace
import errno
from pathlib import Path
import re

from belt import BELT, motion_by_a_belt
from ensembles import OSCILLATOR
from helpers import random_checkpoint
from hnn_vi_ros.errors import DataError, HnnViRosError, ModelError, RecordingError, StepFailure
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.learning import train as training
from hnn_vi_ros.learning.fit import loop
from hnn_vi_ros.learning.fit.loop import kept, TrainingRun
from hnn_vi_ros.learning.judging import ensemble as ensembles
from hnn_vi_ros.learning.judging.evaluation import numbers, Scores
from hnn_vi_ros.learning.tasks import field, machine
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import (
    Box, complete_checkpoint, load_checkpoint, PredictionError, save_checkpoint)
from messages import refused
import numpy as np
import pytest

TINY = OSCILLATOR + """\
hidden: [4]
adam_steps: 2
lbfgs_steps: 0
"""


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    (tmp_path / 'tiny.yaml').write_text(TINY)
    return ['--config', str(tmp_path / 'tiny.yaml'), '--out', str(tmp_path / 'm.safetensors')]


def failing(problem: Exception):
    def fail(*arguments: object, **more: object) -> None:
        raise problem
    return fail


@pytest.mark.parametrize(('name', 'replacement'), [
    ('scores_of', lambda checkpoint, held: np.full((20, *held.q.shape[1:-1], 2), np.inf)),
    ('simulate_held', failing(StepFailure('no convergence', 0.1, 0.01, 1.0, 20)))])
def test_ensemble_that_cannot_be_calibrated_is_kept_and_says_so(
        tmp_path: Path, words: list, monkeypatch, capsys, name: str, replacement):
    monkeypatch.setattr(ensembles, '_MOTIONS', 30)
    monkeypatch.setattr(ensembles, name, replacement)
    main([*words, '--ensemble', '2'])
    card = load_checkpoint(tmp_path / 'm.safetensors', ensembles=True).card.ensemble
    assert card.factors is None and card.coverage is None
    assert re.match('none: (the spread .* cannot be calibrated|step failed)', card.calibration)
    assert 'the spread was not calibrated (none: ' in capsys.readouterr().out


@pytest.mark.parametrize(('module', 'name', 'problem', 'kind'), [
    (field, 'judge_energy', ModelError('no energy'), DataError),
    (training, 'write_report', OSError(errno.ENOSPC, 'No space left on device', 'm.loss.png'),
     RecordingError)])
def test_model_whose_evaluation_fails_is_kept(
        tmp_path: Path, words: list, monkeypatch, module, name: str, problem, kind):
    monkeypatch.setattr(module, name, failing(problem))
    with refused(kind):
        main(words)
    assert load_checkpoint(tmp_path / 'm.safetensors').card.losses


@pytest.mark.parametrize('more', [[], ['--ensemble', '2']])
def test_machine_whose_evaluation_fails_is_kept(tmp_path: Path, monkeypatch, more: list):
    motion = motion_by_a_belt(1, 8.0)
    np.savez(tmp_path / 'belt.npz', t=motion.t, q=motion.q, v=motion.v, tau=motion.tau)
    (tmp_path / 'belt.yaml').write_text(dump_yaml(BELT | {
        'data': {'kind': 'arrays', 'q': 'q', 'v': 'v'},
        'loss': {'kind': 'forward', 'steps': 1, 'lbfgs_steps': 0}}))
    monkeypatch.setattr(machine, 'with_energy_error', failing(
        StepFailure('not finite', 0.1, 0.01, 1.0, 20)))
    out = tmp_path / 'm.safetensors'
    with refused(DataError):
        main(['--config', str(tmp_path / 'belt.yaml'), '--data', str(tmp_path / 'belt.npz'),
              '--out', str(out), *more])
    assert len(load_checkpoint(out, ensembles=True).members) == 2 * bool(more)


@pytest.mark.parametrize('problem', [DataError('training diverged'), KeyboardInterrupt()])
def test_members_trained_before_one_that_fails_are_kept(
        tmp_path: Path, words: list, monkeypatch, capsys, problem):
    real, calls = TrainingRun.to_end, []

    def second_fails(*arguments, **more):
        calls.append(arguments)
        if len(calls) == 2:
            raise problem
        return real(*arguments, **more)
    monkeypatch.setattr(TrainingRun, 'to_end', second_fails)
    with pytest.raises(type(problem)):
        main([*words, '--ensemble', '3'])
    file = tmp_path / 'm.member1.safetensors'
    assert load_checkpoint(file).card.name == 'm, member 1'
    assert f'members trained so far: {file}\n' in capsys.readouterr().out
    # Not found out after the next training.
    with refused(HnnViRosError):
        main([*words, '--ensemble', '3'])


def test_model_that_cannot_be_written_where_it_should_be_is_kept_elsewhere(
        tmp_path: Path, monkeypatch):
    monkeypatch.setattr(loop, 'mkdtemp', lambda prefix: str(tmp_path))
    model = tmp_path / 'file' / 'm.safetensors'
    (tmp_path / 'file').touch()  # no folder, by now
    with refused(ModelError), \
            kept(model, random_checkpoint([2, 4, 1], 0)):
        pytest.fail('it goes on')
    assert load_checkpoint(tmp_path / 'm.safetensors')


def test_completing_a_file_leaves_it_whole_where_that_fails(tmp_path: Path):
    model, checkpoint = tmp_path / 'm.safetensors', random_checkpoint([2, 4, 1], 0)
    save_checkpoint(model, checkpoint)
    before = model.read_bytes()
    card = checkpoint.card.model_copy(update={'name': 'other'})
    complete_checkpoint(model, replace(checkpoint, card=card))
    assert load_checkpoint(model).card.name == 'other' and before != model.read_bytes()
    assert [file.name for file in tmp_path.iterdir()] == ['m.safetensors']
    with refused(ModelError):
        complete_checkpoint(tmp_path / 'none' / 'm.safetensors', checkpoint)


def test_card_that_is_refused_is_told_in_one_line(tmp_path: Path):
    with refused(DataError), \
            kept(tmp_path / 'm.safetensors', random_checkpoint([2, 4, 1], 0)):
        Box(q=[[0.0, 0.0]], p=[[0.0, 1.0]])


def test_scores_that_are_not_finite_make_a_card_that_can_be_read(tmp_path: Path):
    scores = Scores({0.1: np.array([np.inf])}, {0.1: 3}, 0.05, 0.0, 3, {0.1: np.inf, 0.5: np.nan})
    checkpoint = random_checkpoint([2, 4, 1], 0)
    card = checkpoint.card.model_copy(update={
        'prediction_error': PredictionError.model_validate(numbers(scores))})
    save_checkpoint(tmp_path / 'm.safetensors', replace(checkpoint, card=card))
    found = load_checkpoint(tmp_path / 'm.safetensors').card.prediction_error
    assert found.horizons == {'0.1': [None]}
    assert found.energy_mismatch == {'0.1': None, '0.5': None}
