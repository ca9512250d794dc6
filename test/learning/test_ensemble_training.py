# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles are trained on resampled data, and their spread is calibrated."""

from pathlib import Path

from ensembles import OSCILLATOR
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.judging import ensemble as module
from hnn_vi_ros.learning.judging.ensemble import conformal_factors, resampled
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.ensemble import EnsembleHamiltonian
import numpy as np
import pytest
from studies.uncertainty import auroc, detection, gradient_spread

TINY = OSCILLATOR + """\
hidden: [8]
adam_steps: 60
lbfgs_steps: 40
"""


def motions(blocks: int, rows: int) -> Dataset:
    """Return rows of several motions, whose q tells row and motion."""
    block = np.repeat(np.arange(blocks), rows)
    t = np.tile(0.1 * np.arange(rows), blocks)
    q = (block + t)[:, None]
    return Dataset(q, -q, 2.0 * q, 3.0 * q, block, 'rows', t, block)


def test_block_bootstrap_keeps_blocks_whole_and_copies_apart():
    data = motions(12, 5)
    found = resampled(data, 1)
    assert len(found.q) == len(data.q)
    drawn = np.unique(found.block)
    assert 1 < len(drawn) < 12  # some came twice
    for number in np.unique(found.trajectory):
        rows = found.rows(found.trajectory == number)
        (block,) = np.unique(rows.block)
        assert rows.q.tolist() == data.rows(data.block == block).q.tolist()
    assert len(np.unique(found.trajectory)) == 12
    # Every window is one of a motion as it was.
    windows = found.windows(0.1, 5)
    assert len(windows) == 12
    assert resampled(data, 1).q.tobytes() == found.q.tobytes()
    assert resampled(data, 2).q.tobytes() != found.q.tobytes()


def test_conformal_factors_are_the_ranks_that_cover():
    # ceil(20 x 0.9) = 18 of 19.
    scores = np.arange(19.0, 0.0, -1.0)[:, None] * [1.0, 10.0]
    assert conformal_factors(scores, 0.9) == [18.0, 180.0]
    with pytest.raises(DataError, match='cannot be calibrated'):
        conformal_factors(np.array([[1.0], [2.0]]), 0.9)
    with pytest.raises(DataError, match='cannot be calibrated'):
        conformal_factors(scores * [1.0, np.inf], 0.9)


def test_auroc_is_the_probability_that_one_outside_scores_higher():
    assert auroc(np.array([1.0, 2.0, 3.0]), np.array([2.5, 4.0])) == 5.0 / 6.0
    assert auroc(np.array([1.0, 2.0]), np.array([1.0, 2.0])) == 0.5


def test_ensemble_is_trained_calibrated_and_described(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    monkeypatch.setattr(module, '_MOTIONS', 60)
    (tmp_path / 'tiny.yaml').write_text(TINY)
    out = tmp_path / 'm.safetensors'
    main(['--config', str(tmp_path / 'tiny.yaml'), '--ensemble', '3', '--out', str(out)])
    card = load_checkpoint(out, ensembles=True).card
    members = card.ensemble.members
    assert [member.seed for member in members] == [0, 1, 2]
    assert len({member.losses['train_loss'] for member in members}) == 3
    assert card.losses['train_loss'] == pytest.approx(
        np.mean([member.losses['train_loss'] for member in members]))
    assert len(card.ensemble.factors) == 2 and '60 motions' in card.ensemble.calibration
    # 60 motions of 20 instants, which depend on one another, on either side: five deviations.
    assert abs(card.ensemble.coverage - 0.9) < 0.2
    assert '3 members' in capsys.readouterr().out
    checkpoint = load_checkpoint(out, ensembles=True)
    mean = EnsembleHamiltonian(checkpoint)
    assert detection(checkpoint, lambda q, p: gradient_spread(mean, q, p)) > 0.7


@pytest.mark.parametrize(('words', 'message'), [
    (['--ensemble', '1'], 'expected 2 to 64'), (['--ensemble', '65'], 'expected 2 to 64'),
    (['--ensemble', '2', '--resume'], 'trained anew')])
def test_ensemble_that_cannot_be_trained_is_refused(tmp_path: Path, words: list, message: str):
    (tmp_path / 'tiny.yaml').write_text(TINY)
    with pytest.raises(ParameterError, match=message):
        main(['--config', str(tmp_path / 'tiny.yaml'), '--out', str(tmp_path / 'm.safetensors'),
              *words])


@pytest.mark.parametrize('config', ['damped_pendulum', 'turning_pendulum'])
def test_ensemble_of_momenta_of_its_own_is_refused(tmp_path: Path, config: str):
    with pytest.raises(ParameterError, match='whose mean means nothing'):
        main(['--config', config, '--ensemble', '3', '--out', str(tmp_path / 'm.safetensors')])
