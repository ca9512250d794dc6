# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles: resampled data, their training, calibrated spread, and what their card tells."""

from pathlib import Path
import re

from belt import BELT, motions_by_a_belt
from ensembles import OSCILLATOR
from hnn_vi_ros import load_scene, simulate_spread
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.learning import evaluate, EvenMotion
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.judging import ensemble as module
from hnn_vi_ros.learning.judging.ensemble import (
    bootstrapped, bootstrapped_blocks, conformal_factors, kept_and_held)
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.models.ensemble import EnsembleHamiltonian
from machines import machine_config
from messages import refused
import numpy as np
import pytest
from studies.uncertainty import auroc, detection, gradient_spread
from trainings import trained

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
    found = bootstrapped(data, 1)
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
    assert bootstrapped(data, 1).q.tobytes() == found.q.tobytes()
    assert bootstrapped(data, 2).q.tobytes() != found.q.tobytes()


def test_conformal_factors_are_the_ranks_that_cover():
    # ceil(20 x 0.9) = 18 of 19.
    scores = np.arange(19.0, 0.0, -1.0)[:, None] * [1.0, 10.0]
    assert conformal_factors(scores, 0.9) == [18.0, 180.0]
    with refused(DataError):
        conformal_factors(np.array([[1.0], [2.0]]), 0.9)
    with refused(DataError):
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


@pytest.mark.parametrize('words', [
    ['--ensemble', '1'], ['--ensemble', '65'], ['--ensemble', '2', '--resume']])
def test_ensemble_that_cannot_be_trained_is_refused(tmp_path: Path, words: list):
    (tmp_path / 'tiny.yaml').write_text(TINY)
    with refused(ParameterError):
        main(['--config', str(tmp_path / 'tiny.yaml'), '--out', str(tmp_path / 'm.safetensors'),
              *words])


def swing(seconds: float, name: str = 'run') -> EvenMotion:
    t = 0.01 * np.arange(round(seconds / 0.01))
    q = np.sin(3.0 * t)[:, None]
    return smoothed(name, t, q, 3.0 * np.cos(3.0 * t)[:, None], 0.0 * q, 40.0)


def test_blocks_are_whole_parts_of_motions_a_fifth_of_which_is_held_out():
    motions = [swing(4.0, 'one'), swing(7.5, 'two')]
    kept, held = kept_and_held(motions, machine_config())
    # Of at least a second: four, and seven.
    assert len(kept) == 9 and len(held) == 2
    rows = [(motion.name, round(t / 0.01)) for motion in (*kept, *held) for t in motion.t]
    assert len(rows) == len(set(rows)) == 400 + 750
    assert min(len(motion.t) for motion in (*kept, *held)) >= 100
    # Twice the longest window.
    windows = {'kind': 'trajectory', 'windows': [{'duration': 0.75, 'steps': 1}]}
    kept, held = kept_and_held(motions, machine_config(more={'loss': windows}))
    assert len(kept) + len(held) == 2 + 5


def test_bootstrap_of_blocks_draws_as_many_with_replacement():
    blocks = kept_and_held([swing(20.0)], machine_config())[0]
    drawn = bootstrapped_blocks(blocks, 1)
    assert len(drawn) == len(blocks) == 16
    begins = [motion.t[0] for motion in drawn]
    assert 1 < len(set(begins)) < 16 and set(begins) <= {motion.t[0] for motion in blocks}
    assert begins == [motion.t[0] for motion in bootstrapped_blocks(blocks, 1)]
    assert begins != [motion.t[0] for motion in bootstrapped_blocks(blocks, 2)]


def test_motions_of_few_blocks_are_refused():
    with refused(DataError):
        kept_and_held([swing(4.9)], machine_config())


@pytest.mark.long
def test_ensemble_of_a_machine_is_trained_calibrated_and_runs(
        tmp_path: Path, pytestconfig: pytest.Config, capsys: pytest.CaptureFixture):
    made = trained(pytestconfig, 'belts', BELT | {
        'data': {'kind': 'arrays', 'test_runs': ['6']}, 'loss': {
            'kind': 'trajectory', 'forward_steps': 150, 'forward_lbfgs_steps': 0,
            'windows': [{'duration': 0.1, 'steps': 5}]}}, motions_by_a_belt, ['--ensemble', '3'])
    out, said = made.model, made.said
    card = load_checkpoint(out, ensembles=True).card
    members = card.ensemble.members
    assert [member.seed for member in members] == [0, 1, 2]
    assert len({member.losses['forward'] for member in members}) == 3
    maps = [member.mechanical.input_map for member in members]
    np.testing.assert_allclose(card.mechanical.input_map, np.mean(maps, axis=0), rtol=1e-14)
    assert len(card.ensemble.factors) == 4 and card.prediction_error.failed == 0
    # 25 to 50 starts that overlap, of some three blocks: the share varies by tenths.
    assert 0.5 < card.ensemble.coverage <= 1.0
    assert 'Mean of 3 members; bands of 90 %' in said
    # Degrees or milliseconds would be seen here.
    assert re.search(r'^data: m.npz.*; every 0.01 s, \w+ -?[0-9.]+ to [0-9.]+ rad, ', said)
    assert 'bands of 90 %' in out.with_suffix('.report.md').read_text()
    evaluate.main([str(out), '--data', f'{made.data}:6', '--horizons', '0.1'])
    assert 'The model follows the machine for' in capsys.readouterr().out
    (tmp_path / 'scene.yaml').write_text(dump_yaml({
        'hamiltonian': {'kind': 'learned', 'model': str(out)},
        'integrator': {'kind': 'implicit_midpoint'}, 'step_size': 0.01,
        'initial_state': {'q': [0.1, 0.0], 'p': [0.0, 0.0]},
        'effects': [{'kind': 'learned_friction', 'model': str(out)},
                    {'kind': 'external_force', 'model': str(out)}],
        'uncertainty': {'limit': 0.1}}))
    found = simulate_spread(load_scene(tmp_path / 'scene.yaml'), 0.5, every=10)
    assert found.level == 0.9 and (found.spread_q[-1] > 0.0).all()
