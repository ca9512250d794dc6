# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Exported models in nodes: without torch, replayed bit by bit, and safe from topics."""

from pathlib import Path
import sys

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.models import Box, Builder, Checkpoint, CoordinateCard, ModelCard, save_checkpoint
from hnn_vi_ros.run import scene_report
from hnn_vi_ros.scene import described_scene
from hnn_vi_ros.simulation import build
from messages import refused
import numpy as np
from processes import simulator_words
import pytest
from scene_files import write_scene
from sources import run_without


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    """Return a scene of an exported model, H = p^2 / 2 - cos q + tanh(q p) / 10."""
    b = Builder()
    x = b.input(2)
    q, p = (b.take(x, np.array([k])) for k in (0, 1))
    energy = b.sub(b.mul(b.full(p, 0.5), b.mul(p, p)), b.unary('cos', q))
    energy = b.add(energy, b.mul(b.full(p, 0.1), b.unary('tanh', b.mul(q, p))))
    save_checkpoint(tmp_path / 'm.safetensors', Checkpoint(ModelCard(
        name='m', family='graph', coordinates=[CoordinateCard(name='theta')], seed=0, losses={},
        box=Box(q=[[-3.0, 3.0]], p=[[-3.0, 3.0]]), dataset='', training_command='',
        package_version='0'), {}, graph=(b, b.reshape(energy, ()))))
    return write_scene(tmp_path / 'scene.yaml', 'hnn, model: m.safetensors', '',
                       'variational_euler')


def test_node_runs_an_exported_model_and_replay_verifies_it_without_torch(tmp_path, scene_file):
    bag = tmp_path / 'bag'
    words = simulator_words(scene=scene_file, duration=0.5, real_time_factor=0.0, record_path=bag)
    for executable, arguments in (('simulator', words), ('replay', [bag, '--verify'])):
        done = run_without({'torch'}, f'from hnn_vi_ros import cli; sys.argv[0] = {executable!r}; '
                           f'cli.{executable}()', *map(str, arguments))
        assert done.returncode == 0, done.stderr
    assert 'bit' in done.stdout


def test_exported_model_that_a_topic_names_is_the_recorded_one_or_refused(tmp_path, scene_file):
    scene = load_scene(scene_file)
    told, imported = dump_yaml(scene_report(scene, build(scene))), set(sys.modules)
    again, _ = described_scene(told, 'a topic')
    assert again.create_hamiltonian().dimension == 1
    assert all(name.startswith('hnn_vi_ros') for name in set(sys.modules) - imported)
    with (tmp_path / 'm.safetensors').open('r+b') as file:
        file.seek(-8, 2)
        file.write(np.array(2.0).tobytes())
    with refused(ModelError):
        described_scene(told, 'a topic')[0].create_hamiltonian()
