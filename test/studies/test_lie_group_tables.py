# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The table of learned bodies that turn: that all of it is written, of a short run."""

import json
from pathlib import Path
from shutil import copy

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.models import load_checkpoint
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studies import lie_group_tables

MODEL = Path('resource/models/turning_pendulum.safetensors')


@pytest.fixture
def data(tmp_path) -> Path:
    """Write windows of a pendulum that turns evenly, as the published ones are laid out."""
    t, speed = 0.05 * np.arange(6), 0.3
    R = Rotation.from_rotvec(np.outer(speed * t, [0.0, 0.0, 1.0])).as_matrix().reshape(-1, 9)
    rows = np.hstack([R, np.tile([0.0, 0.0, speed], (6, 1)), np.zeros((6, 1))])
    np.savez(tmp_path / 'so3_pendulum.npz', train=rows[None], test=rows[None])
    return tmp_path


def test_table_of_learned_bodies_is_written_of_a_short_run(data: Path):
    seeds = data / 'seeds'
    seeds.mkdir()
    copy(MODEL, seeds / 'turning_pendulum-1.safetensors')
    lie_group_tables.main([
        '--data', str(data), '--models', str(MODEL), '--end', '1.0', '--seeds', str(seeds),
        '--json', str(data / 'table.json'), '--picture', str(data / 'picture.png')])
    table = json.loads((data / 'table.json').read_text())
    losses = table['test_loss']['turning_pendulum']
    # Without its weight the pendulum would turn evenly: what it does in 0.2 s beside that.
    assert 0.0 < losses['ours'] < 10.0 and losses['published'] == 2.0e-7 and not losses['met']
    assert table['seeds'] == {'turning_pendulum': {'1': losses['ours']}}
    run = table['long_run']
    assert (run['end'], run['angle']) == (1.0, 2.0)
    assert run['lie_leapfrog']['distance'] < 1e-13 < run['RK4 on matrices']['distance']
    assert (data / 'picture.png').stat().st_size > 1000


def test_rates_on_matrices_keep_the_energy_and_turn_as_the_group_does():
    rates, energy = lie_group_tables.matrix_field(load_checkpoint(MODEL))
    R = Rotation.from_rotvec([0.2, -0.4, 1.1]).as_matrix()
    z = np.concatenate([R.ravel(), [0.1, -0.2, 0.3]])
    change, spacing = rates(z), 1e-6
    slope = (energy(z + spacing * change) - energy(z - spacing * change)) / (2.0 * spacing)
    # Central differences: 1e-12 of truncation, 1e-10 of round-off.
    assert abs(slope) < 1e-8
    turned = R.T @ change[:9].reshape(3, 3)
    assert abs(turned + turned.T).max() < 1e-14


def test_folder_without_models_of_seeds_is_refused(data: Path):
    with pytest.raises(DataError, match='no model NAME-SEED.safetensors; valid names: turning'):
        lie_group_tables.seed_losses(data, data)
