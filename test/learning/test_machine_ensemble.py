# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of machines: their data, their training, and what their card tells."""

from pathlib import Path
import re

from belt import BELT, motion_by_a_belt
from hnn_vi_ros import load_scene, simulate_spread
from hnn_vi_ros.errors import DataError, ParameterError
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.learning import evaluate
from hnn_vi_ros.learning.data.runs import Run, smoothed
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.judging.ensemble import kept_and_held, resampled_blocks
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models.checkpoint import load_checkpoint
import numpy as np
import pytest


def swing(seconds: float, name: str = 'run') -> Run:
    t = 0.01 * np.arange(round(seconds / 0.01))
    q = np.sin(3.0 * t)[:, None]
    return smoothed(name, t, q, 3.0 * np.cos(3.0 * t)[:, None], 0.0 * q, 40.0)


def config(**changes) -> MachineConfig:
    return MachineConfig.model_validate({
        'coordinates': [{'name': 'a'}], 'data': {'kind': 'arrays'},
        'family': {'kind': 'mechanical', 'prior': 'none'}, **changes})


def test_blocks_are_whole_parts_of_motions_a_fifth_of_which_is_held_out():
    motions = [swing(4.0, 'one'), swing(7.5, 'two')]
    kept, held = kept_and_held(motions, config())
    # Of at least a second: four, and seven.
    assert len(kept) == 9 and len(held) == 2
    rows = [(motion.name, round(t / 0.01)) for motion in (*kept, *held) for t in motion.t]
    assert len(rows) == len(set(rows)) == 400 + 750
    assert min(len(motion.t) for motion in (*kept, *held)) >= 100
    # Twice the longest window.
    windows = {'kind': 'trajectory', 'windows': [{'duration': 0.75, 'steps': 1}]}
    kept, held = kept_and_held(motions, config(loss=windows))
    assert len(kept) + len(held) == 2 + 5


def test_bootstrap_of_blocks_draws_as_many_with_replacement():
    blocks = kept_and_held([swing(20.0)], config())[0]
    drawn = resampled_blocks(blocks, 1)
    assert len(drawn) == len(blocks) == 16
    begins = [motion.t[0] for motion in drawn]
    assert 1 < len(set(begins)) < 16 and set(begins) <= {motion.t[0] for motion in blocks}
    assert begins == [motion.t[0] for motion in resampled_blocks(blocks, 1)]
    assert begins != [motion.t[0] for motion in resampled_blocks(blocks, 2)]


def test_motions_of_few_blocks_are_refused():
    with pytest.raises(DataError, match='make 4 blocks of 1 s, expected at least 5'):
        kept_and_held([swing(4.9)], config())


def test_ensemble_of_a_machine_is_trained_calibrated_and_runs(
        tmp_path: Path, capsys: pytest.CaptureFixture):
    arrays = {}
    for seed in range(1, 7):
        motion = motion_by_a_belt(seed, 3.0)
        arrays |= {f'{seed}/t': motion.t, f'{seed}/q': motion.q, f'{seed}/dq': motion.v,
                   f'{seed}/tau': motion.tau}
    data, out = str(tmp_path / 'belt.npz'), tmp_path / 'belt.safetensors'
    np.savez(data, **arrays)
    (tmp_path / 'belt.yaml').write_text(dump_yaml(BELT | {
        'data': {'kind': 'arrays', 'test_runs': ['6']}, 'loss': {
            'kind': 'trajectory', 'forward_steps': 150, 'forward_lbfgs_steps': 0,
            'windows': [{'duration': 0.1, 'steps': 5}]}}))
    main(['--config', str(tmp_path / 'belt.yaml'), '--data', data, '--ensemble', '3',
          '--out', str(out)])
    said = capsys.readouterr().out
    card = load_checkpoint(out, ensembles=True).card
    members = card.ensemble.members
    assert [member.seed for member in members] == [0, 1, 2]
    assert len({member.losses['forward'] for member in members}) == 3
    maps = [member.mechanical.input_map for member in members]
    np.testing.assert_allclose(card.mechanical.input_map, np.mean(maps, axis=0), rtol=1e-14)
    assert len(card.ensemble.factors) == 4 and card.prediction_error.failed == 0
    # 25 to 50 starts that overlap, of some three blocks: the share varies by tenths.
    assert 0.5 < card.ensemble.coverage <= 1.0
    assert '3 members, whose mean is judged; bands of 90 %' in said
    # Degrees or milliseconds would be seen here.
    assert re.search(r'^data: belt.npz.*; every 0.01 s, \w+ -?[0-9.]+ to [0-9.]+ rad, ', said)
    assert 'bands of 90 %' in out.with_suffix('.report.md').read_text()
    evaluate.main([str(out), '--data', f'{data}:6', '--horizons', '0.1'])
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


@pytest.mark.parametrize(('words', 'message'), [
    (['two_joint_arm', '--ensemble', '3'], 'a rigid_body has the uncertainty of each parameter'),
    (['dfki_double_pendulum', '--ensemble', '1'], 'expected 2 to 64 members')])
def test_ensemble_that_cannot_be_is_refused(tmp_path: Path, words: list, message: str):
    with pytest.raises(ParameterError, match=message):
        main(['--config', *words, '--out', str(tmp_path / 'm.safetensors')])
